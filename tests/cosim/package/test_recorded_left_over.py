"""What readers leave over in the robots, logs, systems and FMUs of the project, as data.

`left_over.toml` has the names by file and how each is judged: an error, a warning where it could
change a number, advice else, or irrelevant. A file that is refused has the code of its refusal.
Files next to the repository are recorded by their names alone.
"""

import re
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from small_fmus import lag
from small_study import Hesr

from cosim.systems.system import SystemSpec
from fmu_src.run.vocabulary import find_left_over
from hesr.extras.ssp.contents import Version, read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr.extras.ssp.vocabulary import IRRELEVANT as IRRELEVANT_IN_SSP
from hesr_model.errors import LogError
from hesr_model.friction.model_file import ModelFile
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.left_over import IRRELEVANT, report_left_over
from hesr_model.logs.robot_log import Log
from hesr_model.robots import urdf
from hesr_model.robots.robot import Robot

ROOT = Path(__file__).parents[3]
SHARED = ROOT.parent / "shared"
RECORD = tomllib.loads((ROOT / "tests" / "left_over.toml").read_text("utf-8"))
ROBOT_SUFFIXES = (".urdf", ".xml")
LOG_SUFFIXES = (".csv", ".gz", ".npz", ".txt")
# Robot files of logs in other folders.
ROBOT_FILES = {
    "panda": "tests/real/panda.toml",
    "tiago_arm": "tests/real/tiago.toml",
    "tx40": "tests/real/tx40.toml",
    "ur10e": "tests/real/ur10e.toml",
}
_FORCE = re.compile(r"(?:leaves out |N\.m, )([^,]+), worth")
Judgements = dict[str, str]  # by name in a file


def judge_robot(path: Path) -> Judgements:
    judgements: Judgements = {}
    for finding in Robot(path).doubts:
        if finding.check == "left-over":
            assert " more (" not in finding.found  # otherwise the log has the others
            names = _FORCE.findall(finding.found) or finding.found.split(": ", 1)[1].split(", ")
            judgements |= dict.fromkeys(names, finding.severity)
    return judgements


def judge_log(path: Path) -> Judgements:
    robot_file = path.with_name("robot.toml")
    if path.parent.name in ROBOT_FILES and path.suffix == ".csv":
        robot_file = ROOT / ROBOT_FILES[path.parent.name]
    try:
        if robot_file.exists():
            logs = [Log.read(path, robot_file)]
        else:
            logs = list(inspect_logs([path]).logs)
    except LogError as error:
        return {error.code: "refused"}
    judgements: Judgements = {}
    for name in logs[0].left_over:
        findings = list(report_left_over(replace(logs[0], left_over=(name,))))
        judgements[name] = findings[0].severity if findings else "irrelevant"
    return judgements


def judge(path: Path) -> Judgements:
    return judge_robot(path) if path.suffix in ROBOT_SUFFIXES else judge_log(path)


def list_files(folder: Path) -> Iterator[Path]:
    """Yield robots and logs, but no other files, such as licences of robots."""
    for path in sorted(folder.rglob("*")):
        is_text = path.suffix == ".txt" and path.parent.name != "cases"
        is_licence = path.stem.startswith("LICENSE")
        if path.suffix in (*ROBOT_SUFFIXES, *LOG_SUFFIXES) and not is_text and not is_licence:
            yield path


def name_files(root: Path, *folders: str) -> set[str]:
    paths = [path for folder in folders for path in list_files(root / folder)]
    return {path.relative_to(root).as_posix() for path in paths}


def test_all_robots_and_logs_of_the_project_are_recorded() -> None:
    assert set(RECORD["project"]) == name_files(ROOT, "models", "tests/real")


@pytest.mark.ci
@pytest.mark.parametrize("name", RECORD["project"])
def test_what_a_file_leaves_over_is_as_recorded(name: str) -> None:
    assert judge(ROOT / name) == RECORD["project"][name]


@pytest.mark.ci
@pytest.mark.parametrize("name", RECORD["shared"])
def test_what_a_file_of_others_leaves_over_is_as_recorded(name: str) -> None:
    if not (SHARED / name).is_file():
        pytest.skip(f"{name} is not next to the repository")
    assert judge(SHARED / name) == RECORD["shared"][name]


def test_all_robots_and_logs_of_others_are_recorded() -> None:
    if not SHARED.is_dir():
        pytest.skip("robots and logs of others are not next to the repository")
    found = name_files(SHARED, "examples", "robots", "data", "raw", "cases")
    assert found == set(RECORD["shared"])


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_systems_of_the_tests_leave_nothing_over(
    version: Version, lags: Callable[..., Path], tmp_path: Path, hesr: Hesr
) -> None:
    path = lags()
    ssp = tmp_path / "lags.ssp"
    write_ssp(read_contents(SystemSpec.read(path), path), ssp, version=version)
    answer = hesr("simulate", ssp, "-o", tmp_path / "x.csv")
    assert (answer.code, answer.err) == (0, "")


@pytest.mark.parametrize("version", [2, 3])
def test_fmus_of_the_tests_leave_nothing_over(version: int, tmp_path: Path) -> None:
    lag(tmp_path, 3 if version == 3 else 2)
    with zipfile.ZipFile(tmp_path / "Lag.fmu") as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    assert find_left_over(root, "Lag.fmu") == []


def test_tables_of_irrelevant_items_name_each_item_and_its_reason() -> None:
    tables = {
        "URDF": urdf._IRRELEVANT_NAMES,
        "SSP": IRRELEVANT_IN_SSP,
        "log": {"": IRRELEVANT},
        "law": {"": ModelFile.IRRELEVANT_KEYS},
    }
    for table in tables.values():
        for names in table.values():
            for name, reason in names.items():
                assert not set("*?[]") & set(name)
                assert reason.strip()


MANY = 40


@pytest.fixture
def crowded(tmp_path: Path) -> Path:
    """A robot and a log with many long names that nothing uses."""
    names = [f"x{k}{'yz' * 40}" for k in range(MANY)]
    model = (ROOT / "models" / "fretting" / "bench.urdf").read_text("utf-8")
    extra = "".join(f'<{name} a="1"/>' for name in names)
    (tmp_path / "bench.urdf").write_text(model.replace("</robot>", f"{extra}</robot>"), "utf-8")
    lines = (ROOT / "models" / "fretting" / "fretting.csv").read_text("utf-8").splitlines()[:4000]
    cells = ",".join(map(str, range(MANY)))
    rows = [",".join([lines[0], *names]), *(f"{line},{cells}" for line in lines[1:])]
    (tmp_path / "run.csv").write_text("\n".join(rows) + "\n", "utf-8")
    robot = (ROOT / "models" / "fretting" / "robot.toml").read_text("utf-8")
    (tmp_path / "robot.toml").write_text(robot, "utf-8")
    return tmp_path


@pytest.mark.ci
def test_many_names_take_a_line_per_file_and_verbose_lists_them(crowded: Path, hesr: Hesr) -> None:
    command = ("inspect", crowded / "run.csv", "--robot", crowded / "robot.toml")
    answer = hesr(*command)
    lines = [line for line in (answer.out + answer.err).splitlines() if "[left-over]" in line]
    assert len(lines) == 2
    assert all(f" and {MANY - 5} more (--verbose lists all)" in line for line in lines)
    assert max(map(len, lines)) < 600
    last_name = f"x{MANY - 1}yz"
    assert last_name not in answer.out + answer.err
    listed = hesr(*command, "--verbose").err
    assert f"'{last_name}" in listed
    for name in ("robot.toml", "bench.urdf"):
        path = crowded / name
        answer = hesr("inspect", "--robot", path)
        assert (answer.out + answer.err).count("[left-over]") == 1


@pytest.mark.ci
def test_a_system_with_many_names_takes_a_line_per_file(
    lags: Callable[..., Path], tmp_path: Path, hesr: Hesr
) -> None:
    ssp = tmp_path / "lags.ssp"
    path = lags()
    write_ssp(read_contents(SystemSpec.read(path), path), ssp)
    with zipfile.ZipFile(ssp) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    extra = "".join(f"<q{k}{'wj' * 40}/>" for k in range(MANY)).encode()
    crowded_ssp = tmp_path / "crowded.ssp"
    with zipfile.ZipFile(crowded_ssp, "w") as archive:
        for name, data in members.items():
            if name.endswith((".ssd", ".ssv")):
                start, _, _ = data.rpartition(b"</")
                data = start + extra + data[len(start) :]
            archive.writestr(name, data)
    answer = hesr("simulate", crowded_ssp, "-o", tmp_path / "x.csv")
    assert answer.code == 0
    files = [name for name in members if name.endswith((".ssd", ".ssv"))]
    lines = answer.err.splitlines()
    assert len(lines) == len(files) > 1
    assert all(f" and {MANY - 5} more" in line and len(line) < 700 for line in lines)


@pytest.mark.ci
def test_a_robot_with_all_forces_takes_two_lines(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><option density="1000" viscosity="0.5"/><worldbody><body name="upper" '
        'gravcomp="0.8"><joint name="a" axis="0 1 0" damping="2" stiffness="0 3 1"/>'
        '<inertial pos="0.2 0 0" mass="2" diaginertia="0.02 0.03 0.04"/><site name="tip"/>'
        '</body></worldbody><tendon><fixed name="t" stiffness="9" damping="2" armature="0.1" '
        'springlength="0.1"><joint joint="a" coef="1"/></fixed></tendon><actuator>'
        '<motor joint="a" damping="2"/><motor tendon="t" armature="0.2"/></actuator></mujoco>',
        "utf-8",
    )
    findings = [finding for finding in Robot(path).doubts if finding.check == "left-over"]
    assert [finding.severity for finding in findings] == ["error", "advice"]
    forces = [len(re.findall(r"worth up to", finding.found)) for finding in findings]
    assert forces == [5, 2]
    assert " and 2 more (--verbose lists all)" in findings[0].found
    answer = hesr("inspect", "--robot", path)
    assert (answer.out + answer.err).count("[left-over]") == 2
