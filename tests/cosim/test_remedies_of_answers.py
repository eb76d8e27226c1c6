"""Commands, options and lines that answers print are executed: what they promise happens."""

import os
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import click
import numpy as np
import pytest
from documents import ROOT
from printed_lines import write_line
from remedy_places import Place, read_quoted, refuse
from rotor import signals
from small_fmus import LAGS
from small_study import Answer

from cosim.report.tables.table import ResultTable
from cosim.study.run import _command
from cosim.study.study import Study
from fmu_src.check.external import JAR
from hesr.cli import app
from hesr.extras.adaptive.monitor import Alarm
from hesr.extras.adaptive.page import Monitoring
from hesr.extras.excite.planner import Guard, MotionSettings, Planner
from hesr.extras.observer.observation import read_calibration_logs
from hesr.extras.paper.job import replay_command as replay_paper
from hesr.extras.sweep.tables import replay_command as replay_sweep
from hesr_model.equations import rows
from hesr_model.friction.model import FrictionModel
from hesr_model.motions.limits import MotionLimits
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import files
from hesr_model.support.extras import install_command

URDF = """<robot name="arm"><link name="base"/>
<joint name="j1" type="{kind}"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>{limit}
</joint><link name="a"><inertial><origin xyz="0 0 0.2"/><mass value="{mass}"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>{limit}
</joint><link name="b"><inertial><origin xyz="0 0 0.2"/><mass value="{mass}"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
LIMIT = '<limit lower="-2" upper="2" effort="50" velocity="3"/>'


def parse(command_line: str) -> None:
    """Parse a command as the command line does; an unknown option or argument is an error."""
    program, name, *arguments = shlex.split(command_line)
    assert program == "hesr"
    context = click.Context(app, info_name="hesr")
    command = app.get_command(context, name)
    assert command, name
    command.make_context(name, arguments, parent=context)


def quiet_and_verbose(place: Place) -> Iterator[str]:
    law = place.bench / "law.json"
    yield (sentence := place.run("test", law, "--quiet", "--verbose").err)
    options = re.findall(r"--\w+", sentence)
    assert options == ["--quiet", "--verbose"]
    yield "".join(place.run("test", law, option).err for option in options)


def hidden_lines(place: Place) -> Iterator[str]:
    """An answer of more than 25 lines."""
    fmus = []
    for number in range(14):
        fmus.append(place.folder / f"{number}.fmu")
        shutil.copy(place.bench / "Friction.fmu", fmus[-1])
    yield (text := place.run("check", *fmus).out)
    (option,) = re.findall(r"more lines: (--\w+)", text)
    yield place.run("check", *fmus, option).out


def hidden_findings(place: Place) -> Iterator[str]:
    """An FMU of another tool with more findings than an answer of one file has."""
    fmu = place.folder / "other.fmu"
    with ZipFile(place.bench / "Friction.fmu") as source, ZipFile(fmu, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b' description="', b' descripton="')
            target.writestr(name, content)
    yield (text := place.run("check", fmu).out)
    (option,) = re.findall(r"more: (--\w+)", text)
    yield place.run("check", fmu, option).out


ONE_SPEED = """name = "bench"
robot = "robot.toml"
laws = ["coulomb_viscous"]
[logs]
identification = ["strokes.csv"]
"""


def write_strokes(place: Place) -> Path:
    """Write a study of a log at one speed, which has a finding."""
    values = signals(seconds=20.0)
    speed = np.where(values["t"] // 5 % 2 < 1, 0.4, -0.4)
    angle = np.cumsum(speed) / 200.0 + 1e-5 * np.random.default_rng(0).standard_normal(speed.size)
    torque = 0.34 * np.sign(speed) + 0.02 * np.random.default_rng(1).standard_normal(speed.size)
    table = np.column_stack([values["t"], angle, speed, torque])
    log = place.bench / "strokes.csv"
    np.savetxt(log, table, "%.9g", ",", header="t,q1,dq1,tau1", comments="")
    study = place.bench / "study.toml"
    study.write_text(ONE_SPEED, encoding="utf-8")
    return study


def run_study(place: Place, study: Path, *options: object) -> Answer:
    answer = place.run("run", study, "-o", place.folder / "results", "--quick", *options)
    assert answer.code == 0, answer.err
    return answer


def findings_of_a_run(place: Place) -> Iterator[str]:
    study = write_strokes(place)
    yield (text := run_study(place, study).out)
    (option,) = re.findall(r"checks: (--\w+)", text)
    yield run_study(place, study, option).out


def refinement_of_a_run(place: Place) -> Iterator[str]:
    """A quick run never refines, so that it does not advise to."""
    study = write_strokes(place)
    study.write_text(ONE_SPEED.replace("strokes", "run"), encoding="utf-8")
    command = ("run", study, "-o", place.folder / "results", "--platform", "linux64")
    answer = place.run(*command)
    assert answer.code == 0, answer.err
    yield answer.out
    ((key, value),) = re.findall(r"add (\w+) = \"(\w+)\"", answer.out)
    assert f"{key} = " not in run_study(place, study).out
    changed = write_line(study.read_text(encoding="utf-8"), "", key, f"'{value}'")
    study.write_text(changed, encoding="utf-8")
    yield place.run(*command).out


def gears_of_a_run(place: Place) -> Iterator[str]:
    study = write_strokes(place)
    study.write_text(ONE_SPEED.replace("strokes", "run"), encoding="utf-8")
    yield (text := run_study(place, study).out)
    (key,) = re.findall(r"Add (\w+) to the robot file", text)
    robot = place.bench / "robot.toml"
    changed = write_line(robot.read_text(encoding="utf-8"), "", key, "[50.0]")
    robot.write_text(changed, encoding="utf-8")
    yield run_study(place, study).out


def windows_of_an_fmu(place: Place) -> Iterator[str]:
    command = ("export", place.bench / "law.json", "-o", place.folder / "F.fmu")
    answer = place.run(*command, "--platform", "linux64")
    yield answer.out
    ((option, value),) = re.findall(r"need (--\w+) (\w+)", answer.out)
    yield place.run(*command, "--platform", "linux64", option, value).out


def inertia_of_the_checks(place: Place) -> Iterator[str]:
    command = ("test", place.bench / "law.json", "--kind", "properties", "--verbose")
    yield (text := " ".join(place.run(*command).out.split()))
    (name,) = set(re.findall(r"give (?:'|--)(\w+)", text))
    yield " ".join(place.run(*command, f"--{name}", "0.01").out.split())


def stop_of_an_ssp(place: Place) -> Iterator[str]:
    (place.folder / "lags.toml").write_text(LAGS.replace("FMU", str(place.lag_fmu)), "utf-8")
    ssp, endless = place.folder / "lags.ssp", place.folder / "endless.ssp"
    assert place.run("export", place.folder / "lags.toml", "-o", ssp).code == 0
    with ZipFile(ssp) as source, ZipFile(endless, "w") as target:
        for name in source.namelist():
            text = source.read(name)
            if name.endswith(".ssd"):
                text = re.sub(rb' stopTime="[^"]*"', b"", text)
            target.writestr(name, text)
    command = ("simulate", endless, "-o", place.folder / "y.csv", "--trust")
    yield (sentence := place.run(*command).err)
    (option,) = re.findall(r"give (--\w+)", sentence)
    answer = place.run(*command, option, "0.4")
    assert answer.code == 0, answer.err
    yield answer.err


def next_of_a_bench(place: Place) -> Iterator[str]:
    """A new bench prints the command for its log; that prints the one that runs the study."""
    text = place.run("new", place.folder / "m", "--bench", "rotary").out
    (inspection,) = re.findall(r"Next: (hesr inspect .*)", text)
    command = inspection.replace("LOG", str(place.bench / "run.csv"))
    answer = place.run(*shlex.split(command)[1:])
    assert answer.code == 0, answer.err
    yield f"hesr inspect LOG --robot\n{answer.out}"
    (run,) = re.findall(r"Next: (hesr run .*)", answer.out)
    results = place.folder / "results"
    answer = place.run(*shlex.split(run)[1:], "-o", results, "--quick")
    assert answer.code == 0, answer.err
    assert (results / "report.html").is_file()
    yield answer.out


def next_of_errors(place: Place) -> Iterator[str]:
    """A wrong inertia of the model; the robot file is corrected, and the command repeated."""
    robot = place.folder / "p.toml"
    log = place.bench / "run.csv"
    model = place.bench / "bench.urdf"
    answer = place.run("inspect", log, "--robot", model, "--write", robot)
    yield answer.out
    ((name, option),) = re.findall(r"repeat hesr (\w+) with (--\w+ \S+)", answer.out)
    changed = write_line(robot.read_text(encoding="utf-8"), "", "known", "[]")
    robot.write_text(changed, encoding="utf-8")
    answer = place.run(name, log, *option.split())
    assert answer.code == 0, answer
    yield answer.out


def robot_of_a_project(place: Place) -> Iterator[str]:
    yield (text := place.run("new", place.folder / "first").out)
    model = place.folder / "arm.urdf"
    model.write_text(URDF.format(kind="revolute", limit=LIMIT, mass=1), encoding="utf-8")
    (option,) = re.findall(r"UF850; (--\w+) takes", text)
    answer = place.run("new", place.folder / "second", option, model)
    assert answer.code == 0, answer.err
    yield answer.out


def joints_of_a_project(place: Place) -> Iterator[str]:
    """The last joint has no limits, so that samples of its motion are not drawn."""
    model = place.folder / "arm.urdf"
    text = URDF.format(kind="revolute", limit=LIMIT, mass=1)
    model.write_text(text, encoding="utf-8")
    command = ("new", "--robot", model)
    answer = place.run(*command, place.folder / "first", "--joints", "j1")
    yield answer.out
    (option,) = re.findall(r"(--\w+) selects other joints", answer.out)
    answer = place.run(*command, place.folder / "second", option, "j1,j2")
    assert answer.code == 0, answer.err
    yield answer.out


def laws_to_compare(place: Place) -> Iterator[str]:
    command = ("report", place.results, "-o", place.folder / "arm.mp4", "--scheme", "none")
    yield (sentence := place.run(*command, place.results).err)
    (option,) = re.findall(r"use (--\w+) to compare", sentence)
    yield place.run(*command, option, "stribeck", option, "parfam_h").err


def folder_of_vdmcheck(place: Place) -> Iterator[str]:
    fmu = place.bench / "Friction.fmu"
    yield (text := place.run("check", fmu, "--verbose").out)
    (option,) = re.findall(r"--vdm\w+", text)
    (place.folder / JAR).write_bytes(b"")
    yield place.run("check", fmu, "--verbose", option, place.folder).out


def lines_of_a_proposed_study(place: Place) -> Iterator[str]:
    """Commented lines of a proposed study are lines of a study."""
    study = place.folder / "study.toml"
    robot = place.bench / "robot.toml"
    command = ("inspect", place.bench / "run.csv", "--robot", robot)
    assert place.run(*command, "--write", place.folder / "p.toml", "--study", study).code == 0
    text = study.read_text(encoding="utf-8")
    yield text
    shutil.copy(place.bench / "second.csv", place.folder / "other.csv")
    changed = re.sub(r"(?m)^# (\w+ = |\[)", r"\1", text)
    assert changed.count("# ") < text.count("# ")
    study.write_text(changed, encoding="utf-8")
    assert Study.read(study).refinement
    assert Study.read(study).logs.test
    yield refuse(lambda: Study.read(study))


def start_of_a_motion(place: Place) -> Iterator[str]:
    """A floor and a ceiling that leave few poses free, next to others that are not."""
    limits = MotionLimits.model_validate({"position": ((-2.0, 2.0),) * 3, "velocity": (2.0,) * 3})
    floor, ceiling = (0.0, 0.0, 1.0, 0.4), (0.0, 0.0, -1.0, -0.62)
    settings = MotionSettings(limits=limits, planes=[floor, ceiling])
    yield (sentence := refuse(lambda: Planner(Guard(place.arm, settings), settings)))
    (key,) = read_quoted(sentence, "state")
    changed = settings.model_copy(update={key: (1.02679623, 0.13288449, 0.33117513)})
    yield refuse(lambda: Planner(Guard(place.arm, changed), changed))


def logs_left_out(place: Place) -> Iterator[str]:
    """Results all of whose logs the laws were fitted to."""
    robot = Robot(place.results_robot)
    only_training = shutil.copytree(place.results, place.folder / "results")
    path = only_training / "run.json"
    changed = path.read_text("utf-8").replace('"trial & error"', '"training"')
    path.write_text(changed, encoding="utf-8")
    yield (sentence := refuse(lambda: read_calibration_logs([only_training], robot)))
    assert read_quoted(sentence, "give") == ["calibration"]
    log = next(iter(sorted((place.results / "logs").glob("*.csv"))))
    yield refuse(lambda: read_calibration_logs([log], robot))


def log_elsewhere(place: Place) -> Iterator[str]:
    robot = Robot(place.results_robot)
    moved = shutil.copytree(place.results, place.folder / "results")
    shutil.rmtree(moved / "logs")
    yield (sentence := refuse(lambda: read_calibration_logs([moved], robot)))
    assert read_quoted(sentence, "give") == ["calibration"]
    (name,) = re.findall(r"its log 'logs/([\w. &-]+)'|its log '([\w./ &-]+)'", sentence)
    log = place.results / "logs" / Path("".join(name)).name
    yield refuse(lambda: read_calibration_logs([log], robot))


def springs_of_a_robot(place: Place) -> Iterator[str]:
    model = place.folder / "arm.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="j1" axis="0 1 0" range="-1 1" stiffness="3"/>'
        '<geom size="0.1" mass="1" pos="0 0 0.3"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    description = RobotDescription(name="arm", model=model, joints=("j1",), springs=())
    yield (text := " ".join(doubt.sentence for doubt in Robot(description).doubts))
    (key,) = read_quoted(text, "list it in")
    changed = description.model_copy(update={key: ("j1",)})
    yield " ".join(doubt.sentence for doubt in Robot(changed).doubts)


def limits_of_a_robot(place: Place) -> Iterator[str]:
    """A continuous joint: `excite` refuses the model, and accepts it with limits."""
    model = place.folder / "arm.urdf"
    robot = place.folder / "robot.toml"
    robot.write_text('name = "arm"\nmodel = "arm.urdf"\njoints = ["j1", "j2"]\n', encoding="utf-8")
    model.write_text(URDF.format(kind="continuous", limit="", mass=1), encoding="utf-8")
    yield (text := " ".join(doubt.sentence for doubt in Robot(robot).doubts))
    ((tag, command),) = set(re.findall(r"<(\w+)>; hesr (\w+) needs", text))
    motion = ("-o", place.folder / "motion.csv")
    assert place.run(command, robot, *motion).code == 2
    limited = URDF.format(kind="revolute", limit=LIMIT, mass=1)
    assert f"<{tag} " in limited
    model.write_text(limited, encoding="utf-8")
    answer = place.run(command, robot, *motion)
    assert answer.code == 0, answer.err
    yield " ".join(doubt.sentence for doubt in Robot(robot).doubts)


def body_of_a_model_without_masses(place: Place) -> Iterator[str]:
    text = (place.bench / "bench.urdf").read_text(encoding="utf-8")
    bare = re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL)
    (place.bench / "bench.urdf").write_text(bare, encoding="utf-8")
    command = ("identify", place.bench / "run.csv", "--robot", place.bench / "robot.toml")
    yield (sentence := place.run(*command, "--body", "nominal").err)
    (name,) = read_quoted(sentence, "choose another")
    answer = place.run(*command, f"--{name}", "free")
    assert answer.code == 0, answer.err
    yield answer.err


def place_of_temporary_files(place: Place) -> Iterator[str]:
    """No candidate can be written, until the variable names one that can."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tempfile.tempdir", None)
        patch.setattr("tempfile._candidate_tempdir_list", list_places)
        yield (sentence := refuse(files.find_temporary_folder))
        (variable,) = re.findall(r"set ([A-Z]+)", sentence)
        patch.setenv(variable, str(place.folder))
        yield refuse(files.find_temporary_folder)


def list_places() -> list[str]:
    return [os.environ["TMPDIR"]] if os.environ.get("TMPDIR", "").endswith("written") else []


def place_of_compiled_laws(place: Place) -> Iterator[str]:
    """A temporary folder whose files cannot be executed, by a loader that refuses them."""
    with pytest.MonkeyPatch.context() as patch:
        load = rows.ctypes.CDLL
        allowed = place.folder / "executable"
        allowed.mkdir()

        def load_allowed(path: str) -> object:
            if not Path(path).is_relative_to(allowed):
                raise OSError("failed to map segment from shared object")
            return load(path)

        patch.setattr(rows.ctypes, "CDLL", load_allowed)
        rows.library.cache_clear()
        yield (sentence := refuse(rows.library))
        (variable,) = re.findall(r"set ([A-Z]+)", sentence)
        patch.setenv(variable, str(allowed))
        patch.setattr("tempfile.tempdir", None)
        yield refuse(rows.library)
    rows.library.cache_clear()


def extras_to_install(_: Place) -> Iterator[str]:
    """The extras that commands name exist; packages are not installed by tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    sources = [
        path.read_text(encoding="utf-8")
        for package in ("hesr", "hesr_model", "cosim", "fmu_src")
        for path in (ROOT / package).rglob("*.py")
    ]
    extras = set(re.findall(r"install_command\(\"(\w+)\"\)", "".join(sources)))
    extras |= set(re.findall(r"install_command\('(\w+)'\)", "".join(sources)))
    assert len(extras) > 3
    yield " ".join(map(install_command, sorted(extras)))
    assert extras <= project["optional-dependencies"].keys()
    yield ""


def alarms_of_a_monitor(place: Place) -> Iterator[str]:
    """More changes of friction than a summary has."""
    model = FrictionModel.read(place.bench / "law.json")
    alarm = Alarm(log="one", joint="motor", time=2.0, kind="shift", sign=1)
    alarms = tuple(replace(alarm, time=float(k)) for k in range(20))
    answer = Monitoring(model=model, followed=(), states=(), alarms=alarms)
    yield answer.summary()
    (alarm_rows, *_) = [table.rows for table in answer.tables() if isinstance(table, ResultTable)]
    assert len(alarm_rows) == 20
    yield answer.full_summary()


def commands_of_results(_: Place) -> Iterator[str]:
    """Commands that repeat results, as their pages print them, are commands."""
    study = Path("folder/study.toml")
    commands = [
        _command(study, ["linux64", "darwin64"], quick=True),
        replay_paper(Path("paper.toml"), [Path("a.toml"), Path("b.toml")]),
        replay_sweep(Path("a folder/sweep.toml"), 7),
    ]
    yield " ".join(commands)
    for command in commands:
        parse(command)
    yield ""


EXECUTED: dict[str, Callable[[Place], Iterator[str]]] = {
    "--quiet and --verbose are contradictory": quiet_and_verbose,
    "more lines: --verbose": hidden_lines,
    " more: --verbose": hidden_findings,
    " of the checks: --verbose": findings_of_a_run,
    "more alarms: --verbose": alarms_of_a_monitor,
    "add refinement = ": refinement_of_a_run,
    "Add gear_ratio to the robot file": gears_of_a_run,
    "need --platform win64": windows_of_an_fmu,
    "the joints is unknown; give": inertia_of_the_checks,
    "no stopTime; give": stop_of_an_ssp,
    "hesr inspect LOG --robot": next_of_a_bench,
    "then repeat hesr inspect with": next_of_errors,
    "takes the URDF or MJCF": robot_of_a_project,
    "selects other joints": joints_of_a_project,
    "give one result; use": laws_to_compare,
    "VDMCheck2 was not run": folder_of_vdmcheck,
    "# test = ": lines_of_a_proposed_study,
    "# refinement = ": lines_of_a_proposed_study,
    "no start pose is free": start_of_a_motion,
    "log was left out of the": logs_left_out,
    "not in a folder above": log_elsewhere,
    "list it in 'springs' of the": springs_of_a_robot,
    "hesr excite needs them": limits_of_a_robot,
    "choose another 'body'": body_of_a_model_without_masses,
    "no folder for temporary files": place_of_temporary_files,
    "the compiled laws cannot be loaded": place_of_compiled_laws,
    "pip install": extras_to_install,
    "hesr run ": commands_of_results,
}
"""Words of what answers print, and what provokes and executes each."""


SLOW = ("add refinement = ",)
"""Of which CI runs the whole study."""


@pytest.mark.parametrize(
    "words",
    [pytest.param(words, marks=pytest.mark.ci if words in SLOW else ()) for words in EXECUTED],
)
def test_what_an_answer_prints_is_executed(words: str, place: Place) -> None:
    before, after = EXECUTED[words](place)
    assert words in before, before
    assert words not in after, after
