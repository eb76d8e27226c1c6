"""Hostile archives in place of each FMU, SSP and packed log: one sentence, in bounded time."""

import re
import resource
import shutil
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet
from archive_attacks import ATTACKS, DAMAGE, ODD, Members, pack
from small_study import Answer, Hesr, Run, hesr_here

from cosim.systems.system import SystemSpec
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp

pytestmark = pytest.mark.ci

MOST_MORE = 500 << 20  # bytes of memory that reading an archive may take

GATE = ("a bomb", "entries that share data", "a link", "the name '../evil'", "too small a size")
"""Attacks that are tried in every gate where archives are read by shared code."""

KINDS = (
    *GATE,
    "the name 'C:evil'",
    "the name 'a\\x1b[2J'",
    "two descriptions",
    "second name 'RESOURCES/A'",
    "a pipe",
    "a file as a folder",
    "many entries",
    "a size of 2^62",
    "an encrypted entry",
    "bzip2",
)
"""One attack of each kind, tried on FMUs in every gate."""


def select(attacks: Iterable[str], gate: Collection[str] = GATE) -> list[ParameterSet]:
    """Return attacks as parameters of a test, most of them for the night."""
    nightly = pytest.mark.nightly("hostile")
    return [pytest.param(name, marks=() if name in gate else nightly) for name in attacks]


SYSTEM = """
name = "friction"
step = 0.01
stop = 0.05
observe = ["a.tau"]
open_inputs = true

[[components]]
name = "a"
fmu = "FMU"
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def read_members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def fmu_members(friction_fmu: Path) -> dict[str, bytes]:
    """Members of a friction FMU, the description first."""
    members = read_members(friction_fmu)
    return {"modelDescription.xml": members.pop("modelDescription.xml"), **members}


@pytest.fixture(scope="module")
def ssp_members(friction_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("ssp")
    path = write_system(folder, friction_fmu)
    members = read_members(write_ssp(read_contents(SystemSpec.read(path), path), folder / "a.ssp"))
    return {"SystemStructure.ssd": members.pop("SystemStructure.ssd"), **members}


def write_system(folder: Path, fmu: Path) -> Path:
    path = folder / "system.toml"
    path.write_text(SYSTEM.replace("FMU", str(fmu)), encoding="utf-8")
    return path


def commands_of_fmu(fmu: Path) -> list[tuple[object, ...]]:
    out = fmu.parent / "out"
    system = write_system(fmu.parent, fmu)
    return [
        ("check", fmu, "--junit", out / "check.xml"),
        ("check", fmu, "--kind", "references"),
        ("check", fmu, "--kind", "hostile"),
        ("check", fmu, "--kind", "convention"),
        ("simulate", fmu, "--stop", "0.05", "-o", out / "a.csv"),
        ("simulate", system, "-o", out / "a.csv"),
        ("simulate", system, "--isolate", "-o", out / "a.csv"),
        ("export", system, "-o", out / "a.ssp"),
        ("test", fmu, "--kind", "passivity"),
    ]


def commands_of_ssp(ssp: Path) -> list[tuple[object, ...]]:
    out = ssp.parent / "out"
    return [
        ("check", ssp),
        ("check", ssp, "--kind", "references"),
        ("simulate", ssp, "-o", out / "a.csv"),
        ("export", ssp, "-o", out / "b.ssp"),
    ]


COMMANDS = {".fmu": commands_of_fmu, ".ssp": commands_of_ssp}


def call(hesr: Hesr, line: tuple[object, ...]) -> Answer:
    """Run a command, which takes little memory and no longer than pytest's limit."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    answer = hesr(*line)
    assert "Traceback" not in answer.err, (line, answer.err)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 < before + MOST_MORE, line
    return answer


def list_files(folder: Path) -> dict[Path, int]:
    return {path: path.lstat().st_size for path in folder.rglob("*")}


def refuse(hesr: Hesr, path: Path, content: bytes, *, unread: Sequence[str] = ()) -> None:
    """Check that all commands refuse an archive, `check` by findings, and write nothing.

    Commands of `unread` verbs do not read the damaged entry.
    """
    (path.parent / "out").mkdir(parents=True)
    path.write_bytes(content)
    lines = COMMANDS[path.suffix](path)
    before = list_files(path.parent)
    for line in lines:
        answer = call(hesr, line)
        if line[0] == "check" and answer.code < 2:
            assert re.search("error|warning", answer.out), (line, answer)
        elif line[0] not in unread:
            assert answer.code == 2, (line, answer)
            assert len(answer.err.splitlines()) == 1, (line, answer)
        if answer.code < 2:
            for output in (path.parent / "out").iterdir():
                output.unlink()
        assert list_files(path.parent) == before, line


@pytest.mark.parametrize("suffix", COMMANDS)
def test_commands_work_on_valid_archives(
    suffix: str,
    fmu_members: Members,
    ssp_members: Members,
    hesr: Hesr,
    tmp_path: Path,
) -> None:
    """Guards the tests below against passing for another reason."""
    path = tmp_path / f"Friction{suffix}"
    (tmp_path / "out").mkdir()
    path.write_bytes(pack(fmu_members if suffix == ".fmu" else ssp_members))
    for line in COMMANDS[suffix](path):
        answer = call(hesr, line)
        expected = {0, 1} if line[0] in ("check", "test") else {0}
        assert answer.code in expected, (line, answer)


@pytest.mark.timeout(180)
@pytest.mark.parametrize("attack", select(ATTACKS, KINDS))
def test_hostile_fmus_are_refused(
    attack: str, fmu_members: Members, hesr: Hesr, tmp_path: Path
) -> None:
    refuse(hesr, tmp_path / "Evil.fmu", ATTACKS[attack](fmu_members))


@pytest.mark.timeout(180)
@pytest.mark.parametrize("attack", select(DAMAGE))
def test_damaged_entries_are_refused(
    attack: str, fmu_members: Members, ssp_members: Members, hesr: Hesr, tmp_path: Path
) -> None:
    """A test of the law reads no more than the law, and an export copies the FMU."""
    content = DAMAGE[attack](fmu_members)
    refuse(hesr, tmp_path / "fmu" / "Evil.fmu", content, unread=("test", "export"))
    unread = ("simulate", "export") if "bomb" in attack else ()  # of a file without use
    refuse(hesr, tmp_path / "ssp" / "Evil.ssp", DAMAGE[attack](ssp_members), unread=unread)


@pytest.mark.timeout(180)
@pytest.mark.parametrize("attack", select(ATTACKS))
def test_hostile_ssps_are_refused(
    attack: str, ssp_members: Members, hesr: Hesr, tmp_path: Path
) -> None:
    refuse(hesr, tmp_path / "Evil.ssp", ATTACKS[attack](ssp_members))


@pytest.mark.timeout(180)
@pytest.mark.parametrize("attack", select([*ATTACKS, *DAMAGE]))
def test_hostile_fmus_within_ssps_are_refused(
    attack: str, fmu_members: Members, ssp_members: Members, hesr: Hesr, tmp_path: Path
) -> None:
    """Only commands that open the FMUs refuse them."""
    path = tmp_path / "Evil.ssp"
    (name,) = [name for name in ssp_members if name.endswith(".fmu")]
    path.write_bytes(pack({**ssp_members, name: (ATTACKS | DAMAGE)[attack](fmu_members)}))
    (tmp_path / "out").mkdir()
    before = list_files(tmp_path)
    answer = call(hesr, ("simulate", path, "-o", tmp_path / "out" / "a.csv"))
    assert answer.code == 2, answer
    assert len(answer.err.splitlines()) == 1, answer
    assert list_files(tmp_path) == before


@pytest.mark.timeout(180)
@pytest.mark.parametrize("suffix", COMMANDS)
@pytest.mark.parametrize("attack", select(ODD, ["a count too large", "a name of a device"]))
def test_odd_archives_are_read_or_refused(
    attack: str,
    suffix: str,
    fmu_members: Members,
    ssp_members: Members,
    hesr: Hesr,
    tmp_path: Path,
) -> None:
    path = tmp_path / "inner" / f"Odd{suffix}"
    (path.parent / "out").mkdir(parents=True)
    path.write_bytes(ODD[attack](fmu_members if suffix == ".fmu" else ssp_members))
    for line in COMMANDS[suffix](path):
        if "hostile" not in line and "convention" not in line:  # both run the FMU for long
            assert call(hesr, line).code in (0, 1, 2), line
    assert [entry.name for entry in tmp_path.iterdir()] == ["inner"]


def write_npz(path: Path) -> None:
    rng = np.random.default_rng(3)
    names = ("q1", "dq1", "tau1")
    np.savez(path, t=0.01 * np.arange(60), **{name: rng.normal(size=60) for name in names})


def write_excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("log")
    for row in (["t", "q1", "dq1", "tau1"], *([0.01 * k, k % 7, k % 3, 1.0] for k in range(60))):
        sheet.append(row)
    book.save(path)


LOGS: dict[str, Callable[[Path], None]] = {".npz": write_npz, ".xlsx": write_excel}


@pytest.mark.timeout(180)
@pytest.mark.parametrize("suffix", LOGS)
@pytest.mark.parametrize("attack", select([*ATTACKS, *DAMAGE, *ODD]))
def test_hostile_logs_are_read_or_refused(
    attack: str, suffix: str, hesr: Hesr, tmp_path: Path
) -> None:
    """Nothing of a log is unpacked to a disk, so that names do not matter."""
    LOGS[suffix](tmp_path / f"valid{suffix}")
    attacks: Mapping[str, Callable[[Members], bytes]] = {**ATTACKS, **DAMAGE, **ODD}
    path = tmp_path / "inner" / f"log{suffix}"
    path.parent.mkdir()
    path.write_bytes(attacks[attack](read_members(tmp_path / f"valid{suffix}")))
    before = list_files(tmp_path)
    answer = call(hesr, ("inspect", path))
    assert answer.code in (0, 1, 2), answer
    assert list_files(tmp_path) == before


@pytest.mark.timeout(300)
@pytest.mark.parametrize("attack", select(["a bomb", "two descriptions", "a link"], ["a link"]))
def test_hostile_fmus_in_results_are_left_out(
    attack: str, fmu_members: Members, study_run: Run, hesr: Hesr, tmp_path: Path
) -> None:
    """The report of received results shows no live plot of such FMUs."""
    results = tmp_path / "results"
    shutil.copytree(study_run.results, results)
    for fmu in (results / "fmus").iterdir():
        fmu.write_bytes(ATTACKS[attack](fmu_members))
    answer = call(hesr, ("report", results, "-o", tmp_path / "page.html"))
    assert answer.code == 0, answer
    assert {path.name for path in tmp_path.iterdir()} == {"results", "page.html"}
