"""The command that exports a friction model to other tools, and its refusals."""

import re
import subprocess
import sys
from zipfile import ZipFile

import pytest
from containing import Containing
from small_study import Hesr, hesr_here, uf850

from fmu_src import model_file
from fmu_src.run.fmu import FmuInstance
from hesr.extras.properties.battery import Subject, measure
from hesr.extras.properties.sheet import properties_section
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre

TABLE_1 = "uf850-table1"


@pytest.fixture
def hesr(capsys, monkeypatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_a_drive_is_exported(hesr, tmp_path):
    fmu = tmp_path / "Drive.fmu"
    answer = hesr(
        "export",
        TABLE_1,
        "--format",
        "drive",
        "--inertia",
        "3,3,0.6",
        "--stiffness",
        "1e4",
        "-o",
        fmu,
    )
    assert answer.code == 0, answer.err
    assert "every tool that imports FMI" in answer.out
    assert answer.out.endswith(f" KiB.\nPlatforms: linux64, win64.\nWritten: {fmu}\n")
    with FmuInstance(fmu) as drive:
        drive.initialise()
        drive.set({"tau_motor[3]": 30.0})
        drive.step(0.0, 0.01)
        assert list(drive.get(["inertia[1]", "inertia[3]", "stiffness[2]"])) == [3.0, 0.6, 1e4]
        assert drive.get(["dq[3]"])[0] > 0.0


def test_a_plant_is_exported_with_the_identified_body(hesr, study_run, tmp_path):
    body = tmp_path / "body.json"
    excitation = study_run.results / "logs" / "excitation.csv"
    robot = ("--robot", uf850("robot.toml"))
    identified = hesr("identify", excitation, *robot, "--body", "free", "-o", body)
    assert identified.code == 0, identified.err
    moved = []
    for more in ((), ("--rigid-body", body)):
        fmu = tmp_path / f"Arm{len(more)}.fmu"
        given = ("--format", "plant", *robot, *more)
        answer = hesr("export", TABLE_1, *given, "-o", fmu)
        assert answer.code == 0, answer.err
        assert answer.out.endswith(f" KiB.\nPlatforms: linux64, win64.\nWritten: {fmu}\n")
        with FmuInstance(fmu) as arm:
            arm.initialise(start={"tau[1]": 60.0})
            arm.step(0.0, 0.01)
            moved.append(float(arm.get(["dq[1]"])[0]))
    assert min(moved) > 0.0
    assert 1e-6 < abs(moved[1] / moved[0] - 1.0) < 0.2  # not the parameters of the model file


def test_modelica_is_exported(hesr, tmp_path):
    path = tmp_path / "Friction.mo"
    answer = hesr("export", TABLE_1, "--format", "modelica", "-o", path)
    assert answer.code == 0, answer.err
    assert '\npackage Friction "' in path.read_text()


def test_a_c_header_is_exported_with_its_data(hesr, tmp_path):
    path = tmp_path / "friction.h"
    answer = hesr("export", TABLE_1, "--format", "c", "-o", path)
    assert answer.code == 0, answer.err
    assert re.fullmatch(rf"C header without dependencies, \d+ KiB\.\nWritten: {path}\n", answer.out)
    assert "static inline bool friction_step(friction_state *state, " in path.read_text()
    assert path.with_suffix(".csv").read_text().startswith("t,dq[1],dq[2],dq[3],q[1],")


def test_fmi_3_is_exported(hesr, tmp_path):
    fmu = tmp_path / "Friction.fmu"
    answer = hesr("export", TABLE_1, "--fmi", "3", "-o", fmu)
    assert answer.code == 0, answer.err
    assert answer.out.endswith(f" KiB.\nPlatforms: x86_64-linux, x86_64-windows.\nWritten: {fmu}\n")
    with ZipFile(fmu) as archive:
        assert b'fmiVersion="3.0"' in archive.read("modelDescription.xml")


@pytest.mark.parametrize("library", ["torch", "jax"])
def test_tensor_code_is_exported_with_its_data(hesr, tmp_path, library):
    path = tmp_path / "friction.py"
    answer = hesr("export", TABLE_1, "--format", library, "-o", path)
    assert answer.code == 0, answer.err
    assert answer.out.endswith(f" KiB.\nWritten: {path}\n")
    assert f"\nimport {library}\n" in path.read_text()
    assert len(path.with_suffix(".csv").read_text().splitlines()) == 1001


def test_mjcf_export_states_the_projection_error(hesr, tmp_path):
    path = tmp_path / "friction.xml"
    answer = hesr("export", TABLE_1, "--format", "mjcf", "-o", path)
    assert answer.code == 2
    assert "is not expressible in MJCF" in answer.err
    assert not path.exists()
    answer = hesr("export", TABLE_1, "--format", "mjcf", "--project", "-o", path)
    assert answer.code == 0, answer.err
    assert "hesr: joint1: projected, since its state 'h'" in answer.err
    assert path.exists()


def test_properties_are_in_the_pages_of_the_fmu(hesr, tmp_path):
    fmu = tmp_path / "Friction.fmu"
    answer = hesr("export", TABLE_1, "--properties", "-o", fmu)
    assert answer.code == 0, answer.err
    with ZipFile(fmu) as archive:
        page = archive.read("documentation/index.html").decode()
    found = measure(Subject(name=TABLE_1, model=FrictionModel.read(model_file(TABLE_1))))
    assert properties_section(found) in page


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--format", "drive", "-o", "D.fmu"],
            "--format drive needs --inertia, the inertia",
        ),
        (
            ["--format", "drive", "--inertia", "3,3", "-o", "D.fmu"],
            "--inertia: found 2 values",
        ),
        (
            ["--format", "drive", "--inertia", "heavy", "-o", "D.fmu"],
            "--inertia is 'heavy'; expected numbers such as 3,3,0.6.",
        ),
        (["--fmi", "4", "-o", "F.fmu"], "Invalid value for '--fmi': '4' is not one of '2', '3'."),
        (
            ["--fmi", "3", "--format", "modelica", "-o", "F.mo"],
            "--fmi needs --format adaptive, drive, fmu, observer or plant, but the format is "
            "'modelica'.",
        ),
        (
            ["--inertia", "3", "-o", "F.fmu"],
            "--inertia needs --format drive, but the format is 'fmu'.",
        ),
        (["--project", "-o", "F.fmu"], "--project needs --format mjcf, but the format is 'fmu'."),
        (
            ["--format", "mjcf", "--platform", "win64", "-o", "f.xml"],
            "--platform needs --format adaptive, drive, fmu, observer or plant, but the "
            "format is 'mjcf'.",
        ),
        (
            ["--format", "modelica", "--properties", "-o", "F.mo"],
            "--properties needs --format fmu, but the format is 'modelica'.",
        ),
        (
            ["--format", "plant", "-o", "A.fmu"],
            "--format plant needs --robot, the robot of the law.",
        ),
        (
            ["--format", "plant", "--rigid-body", "body.json", "-o", "A.fmu"],
            "--robot and --rigid-body must be given together.",
        ),
        (
            ["--robot", "robot.toml", "-o", "F.fmu"],
            "--robot needs --format isaaclab, mjcf-joint, newton, observer",
        ),
        (
            ["--format", "plant", "--robot", "robot.toml", "-o", "F.fmu"],
            "robot.toml: no such file.",
        ),
    ],
)
def test_unsupported_exports_are_refused(hesr, tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    answer = hesr("export", TABLE_1, *arguments)
    assert answer.code == 2
    assert sentence in answer.err
    assert not list(tmp_path.iterdir())


def test_only_formats_of_a_robot_take_a_robot(hesr, study_run, tmp_path, monkeypatch):
    body = ("--robot", uf850("robot.toml"), "--rigid-body", study_run.rigid_body)
    monkeypatch.chdir(tmp_path)
    for format_ in ("fmu", "drive", "adaptive"):
        answer = hesr("export", TABLE_1, *body, "--format", format_, "-o", "F.fmu")
        assert answer.code == 2
        assert "--robot needs --format isaaclab, mjcf-joint, newton, observer" in answer.err
        assert f"the format is '{format_}'." in answer.err
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--format", "drive"],
            "drive, which is for friction laws",
        ),
        (["--properties"], "--properties is for friction laws, not for a robot."),
    ],
)
def test_options_unsupported_by_the_robot_are_refused(
    hesr, tmp_path, monkeypatch, arguments, sentence
):
    monkeypatch.chdir(tmp_path)
    answer = hesr("export", "robot.xml", *arguments, "-o", "A.fmu")
    assert answer.code == 2
    assert sentence in answer.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["-o", "F.fmu"],
        ["--format", "drive", "--inertia", "1", "-o", "D.fmu"],
        ["--format", "modelica", "-o", "F.mo"],
        ["--format", "mjcf", "-o", "f.xml"],
        ["--format", "mjcf", "--project", "-o", "f.xml"],
    ],
)
def test_a_law_that_divides_by_zero_is_refused(hesr, tmp_path, monkeypatch, arguments):
    values = {"sigma_0": 1e4, "sigma_1": 10.0, "sigma_2": 5.0, "F_c": 0.0, "F_s": 8.0, "v_s": 0.1,
              "tau_0": 0.0}  # fmt: skip
    law = FrictionLaw(name="lugre", form=LuGre.core({}), values=values)
    model = FrictionModel(
        law="lugre", robot="bench", joints=("hip",), laws=(law,), sample_time=0.005
    )
    monkeypatch.chdir(tmp_path)
    model.write(tmp_path / "law.json")
    answer = hesr("export", "law.json", *arguments)
    assert answer.code == 2
    assert answer.err == Containing("law 'lugre' of joint 'hip'", "F_c = 0.\n")
    assert [path.name for path in tmp_path.iterdir()] == ["law.json"]


def test_an_identical_export_is_copied_without_slow_imports(tmp_path):
    code = (
        "import sys, hesr; hesr.export('uf850-table1', sys.argv[1], no_documentation=True); "
        "print(sorted({'sympy', 'scipy'} & set(sys.modules)))"
    )

    def run(name: str) -> tuple[str, bytes]:
        command = [sys.executable, "-c", code, str(tmp_path / name)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.strip(), (tmp_path / name).read_bytes()

    _, first = run("A.fmu")
    assert run("B.fmu") == ("[]", first)
