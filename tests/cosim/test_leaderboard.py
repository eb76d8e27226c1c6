"""Leaderboards: FMUs on the twin's logs, ranked by class, with intervals."""

import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile import archived
from pythonfmu import FmuBuilder
from small_study import Hesr, hesr_here
from small_twin import MOTIONS

from cosim.loop.excite import excite
from cosim.loop.motions import Motions
from cosim.study.scores import by_joint, compare
from cosim.workflow.test import test as test_laws
from fmu_src import export_fmu
from fmu_src.arm.plant import Plant
from fmu_src.friction.embedded_model import embedded_model
from fmu_src.friction.predictions import predict_model
from hesr.extras.leaderboard.board_file import BoardFile, Judge, read_grounds
from hesr.extras.leaderboard.leaderboard import Entry, Leaderboard, run_leaderboard, tried
from hesr.extras.leaderboard.tables import write_page
from hesr_model.errors import ConfigError, HesrError, SimulationError
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder, sha256

Shared = Callable[[str, Callable[[Path], object]], Path]
TWIN = models_folder() / "uf850"

BOARD = """
name = "twin"
warm_up = 0.5
block = 1.0
scores = ["all", "moving", "reversals", "rests", "time"]

[[robots]]
name = "uf850"
file = "{robot}"
rigid_body = "body.json"
rigid_body_sha256 = "{body}"

[[logs]]
file = "trial.csv"
sha256 = "{log}"
source = "the digital twin, motion 'trial'"
licence = "MIT"
"""


def lay(folder: Path) -> None:
    """Write a leaderboard file with a log of the twin, a fitted law, Table I and a foreign FMU."""
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    motions = Motions.read(folder / "motions.toml")
    kept = tuple(m for m in motions.motions if m.name in ("excitation", "trial"))
    logs = excite(
        motions.model_copy(update={"motions": kept}), Plant.read(TWIN / "plant.toml"), folder
    )
    model = Robot(RobotDescription.read(TWIN / "robot.toml"))
    training = Log.read(logs["excitation"], model.description)
    body = identify([training], model)
    body.write(folder / "body.json")
    law = fit("stribeck", friction_records(training, model, body), robot="uf850")
    export_fmu(law, folder / "stribeck.fmu")
    FmuBuilder.build_FMU(Path(__file__).with_name("coulomb_slave.py"), dest=folder)
    text = BOARD.format(
        robot=TWIN / "robot.toml", body=sha256(folder / "body.json"), log=sha256(logs["trial"])
    )
    (folder / "board.toml").write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def laid(shared: Shared, table1_fmu: Path) -> Path:
    return shared("leaderboard", lay)


@pytest.fixture(scope="module")
def entries(laid: Path, table1_fmu: Path) -> list[Path]:
    return [table1_fmu, laid / "stribeck.fmu", laid / "Coulomb.fmu"]


@pytest.fixture(scope="module")
def board(laid: Path, entries: list[Path]) -> Leaderboard:
    rules = BoardFile.read(laid / "board.toml")
    named = [Entry(name=fmu.stem, fmu=fmu, robot="uf850") for fmu in entries]
    return run_leaderboard(rules, named, workers=1)


def called(file: Path, fmus: object, page: Path | None = None) -> Any:
    """Return the leaderboard of a file."""
    return test_laws(fmus, on=[file], output=page).others["leaderboard"]  # type: ignore[arg-type]


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def changed(laid: Path, to: Path, *changes: tuple[str, str]) -> Path:
    """Write the leaderboard file with some text replaced, next to its FMUs."""
    for name in ("body.json", "trial.csv"):
        shutil.copy(laid / name, to / name)
    text = (laid / "board.toml").read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    (to / "board.toml").write_text(text, encoding="utf-8")
    return to / "board.toml"


def test_entries_are_classed_by_their_inputs(board: Leaderboard) -> None:
    found = {s.name: (s.group, s.inputs, s.law, s.foreign) for s in board.standings}
    assert found == {
        "stribeck": ("v", ("dq",), "stribeck", False),
        "Friction": ("v", ("dq",), "parfam_h", False),
        "Coulomb": ("v, load", ("dq", "tau_load"), "", True),
    }
    assert [s.name for s in board.standings][:2] == ["stribeck", "Friction"]
    assert all(s.step and s.step > 0.0 for s in board.standings)


def test_errors_are_those_of_an_evaluation(board: Leaderboard, laid: Path) -> None:
    (ground,) = read_grounds(BoardFile.read(laid / "board.toml")).values()
    columns = ("t", "dq", "q", "tau_load", "tau")
    late = [
        [replace(r, **{n: getattr(r, n)[r.t - r.t[0] >= 0.5] for n in columns}) for r in part]
        for part in ground.records
    ]
    model = embedded_model(
        laid / "stribeck.fmu"
    )  # no memory, so the start of a log does not matter
    assert model is not None
    records = by_joint(late)
    expected = compare(records, {"stribeck": predict_model(model, records)})
    found = next(s for s in board.standings if s.name == "stribeck")
    rows = expected.laws["stribeck"]
    np.testing.assert_allclose(found.joints["all"], rows.rmse, rtol=1e-9)
    np.testing.assert_allclose(found.joints["moving"], rows.rmse_moving, rtol=1e-9)
    np.testing.assert_allclose(found.joints["reversals"], rows.rmse_reversal, rtol=1e-9)
    np.testing.assert_allclose(board.robots[0].tau_std, expected.tau_std, rtol=1e-12)
    relative = np.sqrt(np.mean(np.square(np.divide(rows.rmse, expected.tau_std))))
    assert found.relative["all"] is not None
    np.testing.assert_allclose(found.relative["all"].value, relative, rtol=1e-9)


def test_intervals_contain_their_values(board: Leaderboard) -> None:
    first, second, alone = board.standings
    assert first.ratio is None
    assert alone.ratio is None
    assert second.ratio is not None
    assert 1.0 < second.ratio.low < second.ratio.value < second.ratio.high
    assert (first.leads, second.leads, alone.leads) == (True, False, True)
    for standing in board.standings:
        for kind in ("all", "moving", "reversals", "rests"):
            interval = standing.relative[kind]
            assert interval is not None
            assert interval.low < interval.value < interval.high


def test_an_interval_covers_the_truth(laid: Path) -> None:
    """The relative error of white errors of known size is known."""
    (ground,) = read_grounds(BoardFile.read(laid / "board.toml")).values()
    judge = Judge(ground, warm_up=0.5, block=0.05)
    rows, n = len(ground.records[0][0].t), ground.model.n
    covered = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = 0.3 * judge.tau_std * rng.normal(size=(rows, n))
        measured = np.column_stack([r.tau for r in ground.records[0]])
        found = judge.relative(judge.errors([measured + noise]), "all")
        assert found is not None
        covered += found.low <= 0.3 <= found.high
    assert covered >= 34


def test_a_command_writes_page_and_json(
    laid: Path, entries: list[Path], tmp_path: Path, hesr: Hesr
) -> None:
    page, answer = tmp_path / "board.html", tmp_path / "board.json"
    said = hesr(
        "test", *entries[1:], "--on", laid / "board.toml", "--verbose", "-o", page, "--json", answer
    )
    assert said.code == 0, said.err
    assert "Coulomb (foreign)" in said.out
    envelope = json.loads(answer.read_text(encoding="utf-8"))
    assert envelope["format"] == "hesr-law-report-1"
    data = envelope["result"]["leaderboard"]
    text = page.read_text(encoding="utf-8")
    for standing in data["standings"]:
        assert standing["sha256"] in text
        assert str(standing["relative"]["all"]["value"]) in text  # before rounding
    assert "the digital twin, motion" in text
    again = called(laid / "board.toml", entries[1], tmp_path / "again.html")
    (own,) = again.standings
    assert own.relative["all"] is not None
    assert own.relative["all"].value == data["standings"][0]["relative"]["all"]["value"]


def test_properties_are_those_of_the_physics_checks(
    laid: Path, table1_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (ground,) = read_grounds(BoardFile.read(laid / "board.toml")).values()
    asked = []
    monkeypatch.setattr("hesr.extras.leaderboard.leaderboard.measure", asked.append)
    entry = Entry(name="Friction", fmu=table1_fmu, robot="uf850")
    tried(entry, ground, properties=True)
    tried(replace(entry, fmu=laid / "Coulomb.fmu"), ground, properties=True)
    ours, foreign = asked
    assert (ours.model.law, ours.inertia) == ("parfam_h", (3.0, 3.0, 0.6))
    assert foreign.model is None


@pytest.mark.soak
def test_the_physics_checks_are_on_the_page(laid: Path, table1_fmu: Path, tmp_path: Path) -> None:
    path = changed(laid, tmp_path, ('"time"]', '"properties"]'))
    board = called(path, table1_fmu, tmp_path / "board.html")
    (standing,) = board.standings
    assert standing.properties is not None
    assert standing.step is None
    assert "Physics checks by law" in (tmp_path / "board.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        (
            'file = "trial.csv"',
            'file = "gone.csv"',
            r"gone\.csv: cannot be read \(No such file or directory\)\. Its source is the digital "
            r"twin, motion 'trial' \(MIT\)\.",
        ),
        ("warm_up = 0.5", "warm_up = 9.0", "warm-up of 9 s"),
        ('"all", ', "", "'scores' must contain 'all', which ranks"),
        ("[[logs]]", '[[logs]]\nrobot = "ur5"', "robot 'ur5'; known are uf850"),
        (
            "block = 1.0",
            'block = 1.0\nclasses = { v = ["dq"] }',
            "dq, tau_load, which no class allows",
        ),
    ],
)
def test_unusable_leaderboard_files_are_refused(
    laid: Path, tmp_path: Path, before: str, after: str, sentence: str
) -> None:
    path = changed(laid, tmp_path, (before, after))
    with pytest.raises(ConfigError, match=sentence):
        called(path, laid / "Coulomb.fmu")


def test_robots_are_distinguished(laid: Path, tmp_path: Path, table1_fmu: Path) -> None:
    text = (laid / "board.toml").read_text(encoding="utf-8")
    robot = text[text.index("[[robots]]") : text.index("[[logs]]")]
    log = text[text.index("[[logs]]") :]
    other = robot.replace('"uf850"', '"other"', 1)
    named = log.replace("[[logs]]", '[[logs]]\nrobot = "uf850"')
    path = changed(laid, tmp_path, (log, f"{other}{named}{named.replace('uf850', 'other', 1)}"))
    with pytest.raises(ConfigError, match="leaderboard has 2 robots"):
        called(path, table1_fmu)
    board = called(path, [f"uf850={table1_fmu}", f"other={table1_fmu}"])
    assert [s.robot for s in board.standings] == ["uf850", "other"]
    path = changed(laid, tmp_path, (log, f"{robot}{log}"))
    with pytest.raises(ConfigError, match="two robots have the name 'uf850'"):
        called(path, table1_fmu)
    path = changed(laid, tmp_path, (log, f"{other}{named}"))
    with pytest.raises(ConfigError, match="robot 'other' has no log"):
        called(path, table1_fmu)


def test_a_changed_log_is_refused(laid: Path, tmp_path: Path, table1_fmu: Path) -> None:
    path = changed(laid, tmp_path)
    with (tmp_path / "trial.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    with pytest.raises(ConfigError, match=r"its SHA-256 is [0-9a-f]{64}, not [0-9a-f]{64}"):
        called(path, table1_fmu)


def test_unsuitable_entries_are_refused(
    laid: Path, lag_fmu: Path, table1: FrictionModel, tmp_path: Path
) -> None:
    path = laid / "board.toml"
    one = export_fmu(replace(table1, joints=("j",), laws=table1.laws[:1]), tmp_path / "One.fmu")
    for given, error, sentence in [
        ([], ConfigError, "give at least one FMU"),
        ([lag_fmu], SimulationError, r"not a friction FMU: 'tau\[1\]' is missing"),
        ([one], SimulationError, r"One\.fmu: is for 1 joints; the robot 'uf850' has 3\."),
        ([one, one], ConfigError, r"'uf850=.*One\.fmu' is entered twice\."),
    ]:
        with pytest.raises(error, match=sentence):
            called(path, given)


def test_an_entry_with_non_finite_output_is_refused(laid: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(laid / "Coulomb.fmu") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    script = "resources/coulomb_slave.py"
    members[script] = members[script].replace(b"level += ", b"level += math.nan + ")
    bad = archived(members, tmp_path / "Bad.fmu")
    with pytest.raises(HesrError, match=r"s tau\[1\] is not a finite"):
        called(laid / "board.toml", bad)
    assert not (tmp_path / "board.html").exists()


def test_the_page_is_reproducible(board: Leaderboard, tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        write_page(board, tmp_path / name)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
