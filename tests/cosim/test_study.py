"""Studies: the file schema, and variants, refinement and time bands in a run."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from small_study import uf850
from small_twin import MOTIONS

from cosim.study.run import Outcome, _provenance, run_study
from cosim.study.scores import ORACLE
from cosim.study.steps import Job
from cosim.study.study import Part, Study
from fmu_src.check.run import check
from hesr_model.errors import ConfigError
from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder
from hesr_model.support.owner import Owner
from hesr_model.support.progress import silent
from hesr_model.support.typed_files import to_json

BASELINES = select_laws("baseline")

LOGS = """
[logs]
identification = ["one.csv"]
[logs.test]
unseen = ["two.csv"]
"""

WHOLE = """
name = "whole-1"
robot = "robots/arm.toml"
seed = 4
laws = ["stribeck", "lugre"]
bands = [{ test = "unseen", name = "early", stop = 2.5 }, { test = "unseen", name = "late", start = 2.5 }]
refinement = { law = "lugre", rounds = 2 }

[options.lugre]
depth = 3

[variants.plain_hx]
law = "parfam_hx"
options = { ripple = false, functions = ["tanh"] }

[twin]
plant = "plant.toml"
motions = "../motions.toml"

[logs]
identification = ["one", "three"]
reversed = ["one_reversed", "three_reversed"]
friction = ["sweep"]

[logs.test]
unseen = ["two"]
other = ["four", "five"]
"""  # noqa: E501


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        file = tmp_path / "study.toml"
        file.write_text(text, encoding="utf-8")
        return file

    return write


# --- the schema -------------------------------------------------------------------------------


def test_all_keys_of_a_study_are_read(write: Callable[[str], Path]) -> None:
    path = write(WHOLE)
    study = Study.read(path)
    assert study.name == "whole-1"
    assert study.robot == path.parent / "robots" / "arm.toml"
    assert study.seed == 4
    assert study.laws == ("stribeck", "lugre")
    assert study.options == {"lugre": {"depth": 3}}
    assert study.variants["plain_hx"].law == "parfam_hx"
    assert study.variants["plain_hx"].options == {"ripple": False, "functions": ["tanh"]}
    assert study.refinement is not None
    assert (study.refinement.law, study.refinement.rounds) == ("lugre", 2)
    assert [(b.test, b.name, b.start, b.stop) for b in study.bands] == [
        ("unseen", "early", 0.0, 2.5),
        ("unseen", "late", 2.5, 1e9),
    ]
    assert study.twin is not None
    assert study.twin.plant == path.parent / "plant.toml"
    assert study.twin.motions == path.parent.parent / "motions.toml"
    assert study.logs.identification == ("one", "three")
    assert study.logs.reversed == ("one_reversed", "three_reversed")
    assert study.logs.training == ("sweep",)
    assert dict(study.logs.test) == {"unseen": ("two",), "other": ("four", "five")}


def test_parts_begin_anywhere_in_a_log() -> None:
    assert Part(log="a.csv", start=0.5).start == 0.5
    with pytest.raises(ValidationError):
        Part(log="a.csv", start=-0.5)


def test_optional_keys_have_defaults(write: Callable[[str], Path]) -> None:
    study = Study.read(write(f'name = "x"\nrobot = "r.toml"\n{LOGS}'))
    assert (study.seed, study.laws, study.options, study.variants) == (0, (), {}, {})
    assert (study.refinement, study.bands, study.twin) == (None, (), None)
    assert study.logs.training == study.logs.identification == ("one.csv",)
    assert study.logs.reversed == ()


def test_output_error_refines_every_law_with_any_body(write: Callable[[str], Path]) -> None:
    text = f'name = "x"\nrobot = "r.toml"\nphysical = true\nrefinement = "output_error"\n{LOGS}'
    study = Study.read(write(text))
    assert study.refinement is not None
    assert (study.refinement.kind, study.refinement.law) == ("output_error", "")


HEAD = 'name = "x"\nrobot = "r.toml"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'robot = "r.toml"\n{LOGS}', "key 'name' is missing"),
        (f'name = "x"\n{LOGS}', "key 'robot' is missing"),
        (HEAD, "key 'logs' is missing"),
        (f'name = "../x"\nrobot = "r.toml"\n{LOGS}', "key 'name' is '../x'"),
        (f'name = ""\nrobot = "r.toml"\n{LOGS}', "key 'name' is ''"),
        (f"{HEAD}seed = -1\n{LOGS}", "key 'seed' is -1"),
        (f"{HEAD}sead = 1\n{LOGS}", "unknown key 'sead'; did you mean 'seed'"),
        (f'{HEAD}laws = "lugre"\n{LOGS}', "key 'laws' is 'lugre'"),
        (f"{HEAD}options = 3\n{LOGS}", "key 'options' is 3"),
        (f"{HEAD}{LOGS}[variants.a]\noptions = {{}}", "key 'variants.a.law' is missing"),
        (f'{HEAD}{LOGS}[variants.a]\nlaw = "x"\nextra = 1', "unknown key 'variants.a.extra'"),
        (f'{HEAD}{LOGS}[variants."a b"]\nlaw = "x"', "a b"),
        (f"{HEAD}refinement = {{ rounds = 1 }}\n{LOGS}", "table 'refinement': 'law' is missing"),
        (f'{HEAD}refinement = "output"\n{LOGS}', "key 'refinement.kind' is 'output'"),
        (
            f'{HEAD}refinement = {{ law = "x", rounds = 0 }}\n{LOGS}',
            "key 'refinement.rounds' is 0",
        ),
        (
            f'{HEAD}bands = [{{ test = "seen", name = "b" }}]\n{LOGS}',
            "band 'b': test set 'seen' is unknown",
        ),
        (
            f'{HEAD}bands = [{{ test = "unseen", name = "unseen" }}]\n{LOGS}',
            "more than one test set or band is named 'unseen'",
        ),
        (
            f'{HEAD}laws = ["lugre", "lugre"]\n{LOGS}',
            "more than one law is named 'lugre'",
        ),
        (
            f'{HEAD}laws = ["lugre"]\n{LOGS}[variants.lugre]\nlaw = "stribeck"',
            "more than one law is named 'lugre'",
        ),
        (
            f'{HEAD}bands = [{{ test = "unseen", name = "b", start = -1.0 }}]\n{LOGS}',
            "key 'bands.0.start' is -1.0",
        ),
        (
            f'{HEAD}bands = [{{ test = "unseen", name = "b", stop = inf }}]\n{LOGS}',
            "key 'bands.0.stop' is inf",
        ),
        (f'{HEAD}bands = [{{ test = "unseen" }}]\n{LOGS}', "key 'bands.0.name' is missing"),
        (f'{HEAD}{LOGS}[twin]\nplant = "p.toml"', "key 'twin.motions' is missing"),
        (
            f'{HEAD}[logs]\nidentification = []\n[logs.test]\nunseen = ["two.csv"]',
            "key 'logs.identification' is []",
        ),
        (f"{HEAD}folds = 2\n{LOGS}", "key 'folds' is 2"),
        (
            f'{HEAD}bands = [{{ test = "unseen", name = "b" }}]\n[logs]\nidentification = ["a"]',
            "band 'b': test set 'unseen' is unknown",
        ),
        (
            f'{HEAD}[logs]\nidentification = ["a"]\n[logs.test]\nunseen = []',
            "test set 'unseen' has no log",
        ),
        *(
            (
                f'{HEAD}[logs]\nidentification = ["a"]\nreversed = ["b"]\nfriction = ["c"]\n'
                f'[logs.test]\nunseen = ["d", "{log}"]',
                f"log '{log}' of test set 'unseen'",
            )
            for log in ("a", "b", "c")
        ),
        (f"{HEAD}[logs", "not valid TOML"),
    ],
)
def test_invalid_studies_are_refused(write: Callable[[str], Path], text: str, said: str) -> None:
    path = write(text)
    with pytest.raises(ConfigError) as caught:
        Study.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_study_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.toml: no such file\.$"):
        Study.read(tmp_path / "nowhere.toml")


# --- a run ------------------------------------------------------------------------------------

TINY = """
name = "tiny"
robot = "{robot}"
seed = 3
laws = ["stribeck", "lugre"]
bands = [
  {{ test = "unseen", name = "early", stop = 2.0 }},
  {{ test = "unseen", name = "late", start = 2.0 }},
]
body = "free"
refinement = {{ law = "{refining}", rounds = 1 }}

[variants.hx]
law = "parfam_hx"
options = {{ functions = [], ripple = {ripple}, initial_state = true }}

[variants.hx_bare]
law = "parfam_hx"
options = {{ functions = [], ripple = false, load = false, bump = false, initial_state = false }}

[twin]
plant = "{plant}"
motions = "motions.toml"

[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
friction = ["sweep"]

[logs.test]
unseen = ["trial"]
"""


def tiny(folder: Path, *, refining: str = "dahl", ripple: str = "true") -> Path:
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    study = folder / "study.toml"
    text = TINY.format(
        robot=uf850("robot.toml"), plant=uf850("plant.toml"), refining=refining, ripple=ripple
    )
    study.write_text(text, encoding="utf-8")
    return study


@pytest.mark.parametrize(
    ("of_study", "of_robot", "expected"),
    [
        (Owner(author="A"), Owner(author="B"), "A"),
        (Owner(author="A"), Owner(), "A"),
        (Owner(), Owner(author="B"), "B"),
        (Owner(), Owner(), None),
    ],
)
def test_results_have_the_owner_of_the_study_or_else_of_the_robot(
    of_study: Owner, of_robot: Owner, expected: str | None, tmp_path: Path
) -> None:
    path = tiny(tmp_path)
    study = Study.read(path).model_copy(update={"owner": of_study})
    job = Job(study=study, path=path, progress=silent)
    job.__dict__["robot"] = job.robot.model_copy(update={"owner": of_robot})
    found = _provenance(job, dict.fromkeys(job.trained_on, path))
    assert found.get("owner") == (expected and {"author": expected})


@pytest.fixture(scope="module")
def told() -> list[tuple[str, int, int]]:
    return []


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory, told: list[tuple[str, int, int]]) -> Outcome:
    folder = tmp_path_factory.mktemp("tiny")
    return run_study(tiny(folder), folder / "results", progress=lambda *step: told.append(step))


def test_variants_are_rows_like_laws(outcome: Outcome) -> None:
    rows = [*BASELINES, "stribeck", "lugre", "hx", "hx_bare"]
    assert list(outcome.models) == rows
    for compared in outcome.comparisons.values():
        # A law whose start was measured also has a row with that start.
        with_start = ["stribeck", "lugre", "hx", "hx + start", "hx_bare", ORACLE]
        assert list(compared.laws) == [*BASELINES, *with_start]
        assert compared.ratios.reference == "lugre"
        assert set(compared.ratios.laws) == set(compared.laws) - {"lugre"}
    folder = outcome.fmus["hx"].parents[1]
    for row, fmu in outcome.fmus.items():
        assert fmu.is_file()
        assert FrictionModel.read(folder / "laws" / f"{row}.json") == outcome.models[row]


def test_variants_use_their_options(outcome: Outcome) -> None:
    for one in outcome.models["hx"].laws:
        assert one.name == "parfam_hx"
        assert one.start_samples == 5
    for one in outcome.models["hx_bare"].laws:
        assert one.name == "parfam_hx"
        assert one.start_samples == 0
        assert [u.name for u in one.form.inputs] == ["dq"]
    assert outcome.models["hx"].law == "hx"


def test_bands_are_scored_in_addition_to_the_whole(outcome: Outcome) -> None:
    assert list(outcome.comparisons) == ["unseen", "early", "late"]
    for row in outcome.models:
        for joint in range(3):
            whole, early, late = (
                outcome.comparisons[name].laws[row].rmse[joint]
                for name in ("unseen", "early", "late")
            )
            assert min(early, late) < whole < max(early, late)
    # 2 s of 5 s: the squares of the parts, weighted by their rows, give those of the whole.
    squares = {
        name: np.square(compared.laws["lugre"].rmse)
        for name, compared in outcome.comparisons.items()
    }
    share = (squares["unseen"] - squares["late"]) / (squares["early"] - squares["late"])
    np.testing.assert_allclose(share, 0.4, atol=0.005)


def test_the_rigid_body_is_the_refined_one(outcome: Outcome, tmp_path: Path) -> None:
    """Its residual is hardly more than the noise of the arm."""
    folder = outcome.fmus["hx"].parents[1]
    written = RigidBody.read(folder / "rigid_body.json")
    np.testing.assert_array_equal(written.parameters, outcome.rigid_body.parameters)
    path = tiny(tmp_path)
    study = Study.read(path).model_copy(update={"refinement": None})
    job = Job(study=study, path=path, progress=lambda *_: None)
    logs = {name: Log.read(folder / "logs" / f"{name}.csv", job.robot) for name in job.trained_on}
    once, _ = job.rigid_body(logs, Robot(job.robot))
    assert np.all(outcome.rigid_body.rmse < once.rmse)
    assert np.any(outcome.rigid_body.parameters != once.parameters)


def test_laws_with_a_state_pay_on_the_twin(outcome: Outcome) -> None:
    errors = {
        row: np.array(scores.rmse) for row, scores in outcome.comparisons["unseen"].laws.items()
    }
    assert np.all(errors["lugre"] < 0.9 * errors["stribeck"])
    assert np.all(errors["hx"] < 0.9 * errors["stribeck"])


def test_scores_are_written(outcome: Outcome) -> None:
    data = json.loads((outcome.fmus["hx"].parents[1] / "evaluation.json").read_text())
    assert data == {name: to_json(c) for name, c in outcome.comparisons.items()}
    assert set(data["unseen"]["ratios"]["laws"]) == {
        *(*BASELINES, "stribeck", "hx", "hx + start", "hx_bare", ORACLE)
    }


def test_laws_are_also_scored_as_simulators(outcome: Outcome) -> None:
    folder = outcome.fmus["hx"].parents[1]
    data = json.loads((folder / "simulation.json").read_text())
    assert data
    for of_test in data.values():
        assert set(of_test["windows"]) == set(outcome.models)
        assert of_test["lengths"] == [0.2, 0.5]
        assert of_test["open_loop"] == {}  # an upright arm diverges with any friction
        for law_name, (short, long) in of_test["windows"].items():
            highest = 1.0 if law_name in BASELINES else 0.05  # arms without friction go far
            pairs = list(zip(short, long, strict=True))
            assert all(0.0 < a < b < highest for a, b in pairs), (law_name, pairs)
    assert "As simulators: torque in, position out" in (folder / "report.html").read_text()


def test_the_true_friction_is_the_floor_of_the_twin(outcome: Outcome) -> None:
    """The residual is noise and the error of the rigid body, large on so short a motion."""
    for name in ("unseen", "early", "late"):
        scores = outcome.comparisons[name].laws
        floor = np.array(scores[ORACLE].rmse)
        np.testing.assert_array_less([1.4, 1.4, 0.55], floor)  # noise of the arm: 1.5, 1.5, 0.6
        np.testing.assert_array_less(floor, [3.0, 3.0, 1.2])


def test_progress_is_reported_for_every_step(
    outcome: Outcome, told: list[tuple[str, int, int]]
) -> None:
    steps = list(dict.fromkeys(what for what, _, _ in told))
    assert steps == [
        "running the arm",
        "identifying the rigid body",
        "refining the rigid body",
        "fitting laws",
        "judging laws on left-out rows",
        "building FMUs",
        "replaying the FMUs",
        "testing the laws",
        "documenting FMUs",
        "writing the report",
    ]
    for step in steps:
        of_step = [(done, total) for what, done, total in told if what == step]
        assert of_step[0][0] == 0
        assert of_step[-1][0] == of_step[-1][1] > 0
        assert [done for done, _ in of_step] == sorted(done for done, _ in of_step)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('law = "parfam_hx"', 'law = "parfam_x"', "law 'parfam_x' is unknown"),
        ('laws = ["stribeck", "lugre"]', 'laws = ["striebeck"]', "law 'striebeck' is unknown"),
        ('law = "dahl"', 'law = "dall"', "law 'dall' is unknown"),
        ("[variants.hx]", "[options.lugra]\na = 1\n[variants.hx]", "law 'lugra' is unknown"),
    ],
)
def test_unknown_laws_are_reported_before_the_arm_runs(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    study = tiny(tmp_path)
    study.write_text(study.read_text().replace(old, new), encoding="utf-8")
    told: list[str] = []
    with pytest.raises(ConfigError, match=said):
        run_study(study, tmp_path / "results", progress=lambda what, *_: told.append(what))
    assert told == []
    assert not (tmp_path / "results").exists()


def test_a_test_log_without_motion_is_named(tmp_path: Path) -> None:
    study = tiny(tmp_path)
    study.write_text(study.read_text().replace('["trial"]', '["trail"]'), encoding="utf-8")
    with pytest.raises(ConfigError, match="'trail' is not a motion of"):
        run_study(study, tmp_path / "results")
    assert {p.name for p in tmp_path.iterdir()} == {"study.toml", "motions.toml"}


def test_the_default_laws_are_those_allowed_by_the_robot_file(tmp_path: Path) -> None:
    robot = (models_folder() / "uf850" / "robot.toml").read_text()
    lines = [line for line in robot.splitlines() if not line.startswith("gear_ratio")]
    text = "\n".join(lines).replace('"uf850.xml"', f'"{models_folder() / "uf850" / "uf850.xml"}"')
    (tmp_path / "robot.toml").write_text(text)
    path = tmp_path / "study.toml"
    for name, ripple in (("robot.toml", False), (str(models_folder() / "uf850/robot.toml"), True)):
        path.write_text(f'name = "n"\nrobot = "{name}"\n{LOGS}')
        laws = Job(study=Study.read(path), path=path, progress=lambda *_: None).laws
        assert ("lugre_load_ripple" in laws) == ripple
        assert {"stribeck", "parfam_h", "parfam_hx"} <= set(laws)


def test_a_variant_must_not_have_the_name_of_a_law(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'{HEAD}{LOGS}[variants.lugre]\nlaw = "stribeck"')
    with pytest.raises(ConfigError) as caught:
        Job(study=Study.read(path), path=path, progress=lambda *_: None)
    assert f"{path}: key 'variants.lugre' has the name" in str(caught.value)


@pytest.mark.ci
def test_a_quick_run_uses_only_the_classic_laws(tmp_path: Path) -> None:
    """For Windows; scores come from the binary of this machine, which is added."""
    found = run_study(tiny(tmp_path), tmp_path / "results", platforms=("win64",), quick=True)
    assert set(found.models) == {*BASELINES, "stribeck", "lugre", "parfam_h"}
    assert found.platforms == ("linux64", "win64")
    for law in found.models:
        assert check(found.fmus[law]).platforms == found.platforms
