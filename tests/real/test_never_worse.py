"""ParFam-S against LuGre on motions of two other robots: trained on the first part of each.

What is tested of both motions is shorter than a block of 8 s, so that nothing can be significant
there; what counts beside it is how large the ratios are.
"""

from pathlib import Path

import pytest
from significance import against

from cosim.study.run import score_study
from cosim.study.steps import Job
from cosim.study.study import Study
from hesr_model.support import parallel
from hesr_model.support.progress import silent

HERE = Path(__file__).parent
LAWS = ("parfam_s_v", "parfam_s_load", "parfam_s")


@pytest.mark.soak
@pytest.mark.parametrize(
    ("robot", "mean", "most"),
    [
        ("tx40", 0.98, 1.0),
        ("panda", 1.02, 1.08),
    ],
    ids=("tx40", "panda"),
)
def test_stops_are_never_worse_than_lugre(
    robot: str, mean: float, most: float, tmp_path: Path
) -> None:
    """Nowhere significantly, on no joint by more than `most`, in the mean by `mean` at most."""
    path = HERE / f"{robot}_study.toml"
    study = Study.read(path).model_copy(update={"laws": ("lugre", *LAWS)})
    if not all((HERE / part.log).is_file() for part in study.logs.parts.values()):
        pytest.skip(f"the measured log of the {robot} is not beside the repository")
    with parallel.one_pool():
        run = score_study(Job(study=study, path=path, progress=silent), tmp_path)
    found = against(run, "rest", LAWS)
    assert not found.worse, str(found)
    for law in LAWS:
        assert found.mean(law) <= mean, str(found)
    assert max(ratio.value for ratio in found.found.values()) <= most, str(found)
