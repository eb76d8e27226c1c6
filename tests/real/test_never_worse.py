"""ParFam-S compared with LuGre on motions of two other robots, trained on the first part of each.

The test parts of both motions are shorter than a block of 8 s, so nothing can be significant; the
size of the ratios is limited in addition.
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
def test_stops_are_not_worse_than_lugre(
    robot: str, mean: float, most: float, tmp_path: Path
) -> None:
    """Never significantly, by at most `most` on any joint and `mean` on average."""
    path = HERE / f"{robot}_study.toml"
    study = Study.read(path).model_copy(update={"laws": ("lugre", *LAWS)})
    if not all((HERE / part.log).is_file() for part in study.logs.parts.values()):
        pytest.skip(f"the measured log of the {robot} is not next to the repository")
    with parallel.one_pool():
        run = score_study(Job(study=study, path=path, progress=silent), tmp_path)
    found = against(run, "rest", LAWS)
    assert not found.worse, str(found)
    for law in LAWS:
        assert found.mean(law) <= mean, str(found)
    assert max(ratio.value for ratio in found.found.values()) <= most, str(found)
