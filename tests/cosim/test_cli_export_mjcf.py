"""The command that converts an MJCF model to an FMU, and its refusals."""

import pytest
from containing import Containing
from small_study import Hesr, hesr_here, uf850

from fmu_src.run.fmu import FmuInstance

MJCF = """\
<mujoco>
  <worldbody><body><joint name="j"/><geom size="0.1" pos="0 0 -0.5"/></body></worldbody>
  <actuator><motor name="u" joint="j"/></actuator>
  <sensor><jointpos name="y" joint="j"/></sensor>
</mujoco>
"""

IMPOSSIBLE = """
<robot name="swing">
  <link name="base"/>
  <link name="bob">
    <inertial>
      <mass value="1"/><inertia ixx="1" iyy="-1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="pivot" type="continuous"><parent link="base"/><child link="bob"/></joint>
</robot>
"""


@pytest.fixture
def hesr(capsys, monkeypatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def mjcf(tmp_path):
    path = tmp_path / "swing.xml"
    path.write_text(MJCF)
    return path


def test_an_mjcf_becomes_an_fmu(hesr, mjcf, tmp_path):
    fmu = tmp_path / "Swing.fmu"
    answer = hesr("export", mjcf, "-o", fmu)
    assert answer.code == 0, answer.err
    remedy = "--platform win64 as well"
    assert answer.out == Containing(" KiB.\nPlatforms: linux64; ", remedy, f".\nWritten: {fmu}\n")
    with FmuInstance(fmu) as swing:
        assert swing.description.modelName == "swing"
        swing.initialise()
        swing.set({"u": 0.1})
        swing.step(0.0, 0.1)
        assert swing.get(["y"])[0] > 0.0


def test_the_twin_is_exported_with_its_table(hesr, tmp_path):
    fmu = tmp_path / "Arm.fmu"
    answer = hesr("export", uf850("uf850.xml"), "-o", fmu, "--signals", uf850("arm.toml"))
    assert answer.code == 0, answer.err
    with FmuInstance(fmu) as arm:
        arm.initialise(start={"payload": 1.0})
        arm.step(0.0, 0.005)
    answer = hesr("check", fmu)
    assert answer.code == 0, answer.out


def test_python_hosts_get_the_same_arm(hesr, mjcf, tmp_path):
    native, python = tmp_path / "Swing.fmu", tmp_path / "PythonSwing.fmu"
    assert hesr("export", mjcf, "-o", native).code == 0
    answer = hesr("export", mjcf, "-o", python, "--format", "python-arm")
    assert answer.code == 0, answer.err
    found = []
    for fmu in (native, python):
        with FmuInstance(fmu) as swing:
            swing.initialise()
            swing.set({"u": 0.1})
            swing.step(0.0, 0.1)
            found.append(swing.get(["y"])[0])
    assert found[0] == found[1] > 0.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none.xml", "-o", "A.fmu"], "none.xml: no such model file."),
        (["swing.xml", "-o", "A.zip"], "A.zip: the name of an FMU"),
        (["broken.xml", "-o", "A.fmu"], "cannot be parsed as an MJCF"),
        (
            ["blind.xml", "-o", "A.fmu"],
            "neither a sensor nor a hinge",
        ),
        (["swing.xml", "-o", "A.fmu", "--signals", "none.toml"], "none.toml: no such file."),
        (["swing.xml", "-o", "A.fmu", "--signals", "table.toml"], "the model has no sensor 'z'."),
        (["swing.xml", "-o", "A.fmu", "--signals", "other.toml"], "the model has no actuator 'v'."),
        (
            ["swing.xml", "-o", "A.fmu", "--platform", "win64"],
            "platform 'win64': pip could not download",
        ),
        (["swing.xml", "-o", "A.fmu", "--platform", "all"], "pip could not download MuJoCo's"),
        (
            ["swing.xml", "-o", "A.fmu", "--format", "python-arm", "--platform", "win64"],
            "--platform is for native FMUs, not python-arm.",
        ),
        (
            ["swing.urdf", "-o", "A.fmu", "--format", "python-arm"],
            "--format is python-arm, which needs",
        ),
        (["swing.urdf", "-o", "A.fmu"], "swing.urdf: cannot be compiled as a URDF ("),
        (
            ["uf850-table1", "-o", "A.fmu", "--format", "python-arm"],
            "--format is python-arm; allowed are adaptive, c, drive,",
        ),
        (["swing.xml", "-o", "A.fmu", "--platform", "vms"], "platform 'vms' is unknown"),
        (
            ["uf850-table1", "-o", "A.fmu", "--signals", "table.toml"],
            "--signals is for an MJCF (.xml).",
        ),
    ],
)
def test_refusals_are_one_sentence(arguments, sentence, hesr, mjcf, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "blind.xml").write_text("<mujoco><worldbody/></mujoco>")
    (tmp_path / "swing.urdf").write_text(IMPOSSIBLE)
    output = '[outputs.y]\nunit = "rad"\nsensors = [{ NAME = 1 }]\n'
    (tmp_path / "table.toml").write_text(output.replace("NAME", "z"))
    drive = '[inputs.u]\nunit = "N"\nactuators = [["v"]]\n'
    (tmp_path / "other.toml").write_text(drive + output.replace("NAME", "y"))
    before = set(tmp_path.iterdir())
    answer = hesr("export", *arguments)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert sentence in answer.err
    assert set(tmp_path.iterdir()) == before
