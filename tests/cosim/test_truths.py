"""Laws on alternative plants of a twin: results of a run and invalid requests."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from significance import against
from small_study import hesr_here, uf850, write_study

from cosim.loop.excite import twin_plant
from cosim.report.results import Results
from cosim.report.tables.scores import compare_truths, find_leader
from cosim.report.tables.table import markdown
from cosim.study.run import score_study
from cosim.study.scores import ORACLE
from cosim.study.steps import Job
from cosim.study.study import Study
from hesr_model.errors import ConfigError
from hesr_model.fitting.estimator import select_laws
from hesr_model.support import parallel
from hesr_model.support.files import models_folder
from hesr_model.support.progress import silent

NAMES = ("strain_wave", "rate_and_state")
SIGNALS = 'motions = "motions.toml"\n'


def study_with(folder: Path, keys: str, laws: str = '"stribeck", "lugre"') -> Path:
    """Write the small study with further twin settings."""
    path = write_study(folder)
    text = path.read_text(encoding="utf-8").replace(SIGNALS, SIGNALS + keys)
    path.write_text(text.replace('"stribeck", "parfam_h"', laws), encoding="utf-8")
    return path


def signals(keys: str) -> str:
    return f'signals = "{uf850("arm.toml")}"\n{keys}\n'


@pytest.mark.ci
def test_a_run_scores_its_laws_on_the_alternative_plants(tmp_path: Path, capsys, monkeypatch):
    path = study_with(tmp_path, signals('truths = ["strain_wave"]'))
    answer = hesr_here(capsys, monkeypatch)("run", path, "-o", tmp_path / "out", "--json", "-")
    assert answer.code == 0, answer.err
    results = Results.read(tmp_path / "out")
    found = results.truths
    assert list(found) == ["strain_wave"]
    baselines = select_laws("baseline")
    assert set(found["strain_wave"]["unseen"]) == {*baselines, "stribeck", "lugre", ORACLE}
    for of_test in found["strain_wave"].values():
        for law in ("stribeck", "lugre"):
            pairs = zip(of_test[law], of_test[ORACLE], strict=True)
            assert all(own > 0.8 * truth for own, truth in pairs)
    assert (
        found["strain_wave"]["unseen"]["lugre"] != results.comparisons["unseen"].laws["lugre"].rmse
    )
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Alternative plants of the twin" in page
    best = {"stribeck": "Stribeck", "lugre": "LuGre"}[find_leader(found["strain_wave"])]
    assert f"{best} on ‘strain_wave’" in page


@pytest.mark.ci
def test_a_run_on_an_alternative_plant_states_it(tmp_path: Path, capsys, monkeypatch):
    path = study_with(tmp_path, signals('truth = "rate_and_state"'))
    answer = hesr_here(capsys, monkeypatch)("run", path, "--quick", "-o", tmp_path / "out")
    assert answer.code == 0, answer.err
    results = Results.read(tmp_path / "out")
    assert results.run.truth == "rate_and_state"
    assert "Its friction is ‘rate_and_state’ of its plant" in (
        tmp_path / "out/report.html"
    ).read_text(encoding="utf-8")
    # Viscous friction is in the arm, and dry friction is in the written MJCF.
    text = (tmp_path / "out" / "arm.xml").read_text(encoding="utf-8")
    assert "lugre=" not in text.partition("<worldbody>")[2]
    assert 'frictionloss="6.0"' in text


def test_the_table_of_alternative_plants_is_complete():
    errors = {
        "gear": {"a": {"stribeck": [2.0, 2.0], "lugre": [1.0, 4.0], ORACLE: [0.5, 0.5]}},
        "age": {"a": {"stribeck": [1.0, 8.0], "lugre": [2.0, 2.0], ORACLE: [0.5, 0.5]}},
    }

    rmse = {"stribeck": [3.0, 3.0], "lugre": [1.0, 1.0]}
    scores = {"a": SimpleNamespace(laws={k: SimpleNamespace(rmse=v) for k, v in rmse.items()})}
    table = compare_truths(scores, errors)
    assert table.head == ("law", "MJCF", "gear", "age")
    rows = {row.head: [cell.value for cell in row.cells] for row in table.rows}
    assert rows["LuGre"] == [1.0, 1.0, 1.0]
    assert rows["Stribeck"] == pytest.approx([3.0, 1.0, 2.0**0.5])
    assert rows[ORACLE] == [None, 0.25, 0.25]
    assert [row.head for row in table.rows] == ["LuGre", "Stribeck", ORACLE]
    assert "| LuGre | **1.000** | **1.000** | **1.000** |" in markdown(table)
    assert "| Stribeck | 3.000 | **1.000** | 1.414 |" in markdown(table)
    assert find_leader(errors["age"]) == "lugre"
    assert compare_truths(scores, errors, "own").head[1] == "own"


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ('truths = ["strain_wave"]\n', "alternative plants need the key 'signals'"),
        ('truth = "strain_wave"\n', "alternative plants need the key 'signals'"),
    ],
)
def test_alternative_plants_need_an_fmu(keys, sentence, tmp_path: Path, capsys, monkeypatch):
    answer = hesr_here(capsys, monkeypatch)("run", study_with(tmp_path, keys))
    assert answer.code == 2
    assert sentence in answer.err


@pytest.mark.parametrize("keys", ['truth = "cheese"', 'truths = ["cheese"]'])
def test_the_known_plants_are_listed_for_an_unknown_one(keys, tmp_path: Path):
    path = study_with(tmp_path, signals(keys))
    study = Study.read(path)
    assert study.twin is not None
    twin = study.twin.model_copy(update={"truth": "cheese"})
    with pytest.raises(
        ConfigError, match=r"truth 'cheese' is unknown; those of .* are: strain_wave,"
    ):
        twin_plant(twin, path, tmp_path)


def test_seeds_are_refused_on_an_alternative_plant(tmp_path: Path, capsys, monkeypatch):
    path = study_with(tmp_path, signals('truth = "strain_wave"'))
    answer = hesr_here(capsys, monkeypatch)("run", path, "--seeds", "2")
    assert answer.code == 2
    assert "MJCF; remove the key 'twin.truth'" in answer.err


def test_the_default_study_has_both_plants():
    twin = Study.read(models_folder() / "studies" / "default.toml").twin
    assert twin is not None
    assert twin.truths == NAMES


@pytest.mark.soak
@pytest.mark.parametrize("truth", [None, *NAMES])
def test_stops_are_never_significantly_worse_than_lugre(truth, tmp_path: Path):
    """On the test motions of the default study, 45 s: in blocks, Holm-adjusted over laws and
    joints."""
    laws = ("parfam_s_v", "parfam_s_load", "parfam_s")
    path = models_folder() / "studies" / "default.toml"
    study = Study.read(path)
    assert study.twin is not None
    tests = {"all": ("fourier_test", "chirp", "chirp_20s")}
    study = study.model_copy(
        update={
            "laws": ("lugre", *laws),
            "bands": (),
            "tracking": None,
            "twin": study.twin.model_copy(update={"truth": truth, "truths": ()}),
            "logs": study.logs.model_copy(update={"test": tests}),
        }
    )
    with parallel.one_pool():
        run = score_study(Job(study=study, path=path, progress=silent), tmp_path)
    found = against(run, "all", laws)
    assert not found.worse, str(found)
    assert max(map(found.mean, laws)) < 1.06, str(found)
