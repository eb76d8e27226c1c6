"""Friction of joints in an MJCF: MuJoCo's own forces, and passivity as of the FMU of the law."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from joint_data import law
from small_study import Hesr, hesr_here

import hesr
from hesr_model.errors import ConfigError
from hesr_model.friction.mujoco_friction import read_mujoco_friction

STEP = 1e-3
HEAD = f"<mujoco><option timestep='{STEP}' gravity='0 0 0'><flag contact='disable'/></option>"
LINKS = """<worldbody><body><joint name="pan" {pan}/><geom size=".1"/>
<body pos="0 0 1"><joint type="slide" {lift}/><geom size=".1"/>
</body></body></worldbody>"""


def write(path: Path, actuators: str = "", *, pan: str = "", lift: str = "") -> Path:
    links = LINKS.format(pan=pan, lift=lift)
    path.write_text(f"{HEAD}{links}<actuator>{actuators}</actuator></mujoco>", encoding="utf-8")
    return path


def test_forces_are_those_of_mujoco(tmp_path: Path) -> None:
    """At steady speeds, with gears, two bristles, and damping that grows with speed."""
    motor = '<dcmotor joint="pan" input="none" resistance="1" motorconst="0 0" {}/>'
    actuators = motor.format('gear="2" lugre="90 1.5 2 3 .3" damping=".5 .1"')
    actuators += motor.format('gear="-1" lugre="40 .2 1 1.5 .2"') + '<motor joint="pan"/>'
    path = write(tmp_path / "a.xml", actuators, pan='damping="1 .2 .1"', lift='damping="4"')
    model = read_mujoco_friction(path)
    assert model.joints == ("pan", "joint1")
    assert model.slides == (False, True)
    mj_model = mujoco.MjModel.from_xml_path(str(path))
    for speed in (-1.2, 0.25, 2.0):
        data = mujoco.MjData(mj_model)
        for _ in range(2000):
            data.qvel[:] = speed
            mujoco.mj_step(mj_model, data)
        data.qvel[:] = speed
        mujoco.mj_forward(mj_model, data)
        t = STEP * np.arange(2000)
        rows = np.full((len(t), 2), speed)
        zeros = np.zeros_like(rows)
        tau = model.predict(t=t, dq=rows, q=zeros, tau_load=zeros)[-1]
        assert tau == pytest.approx(-(data.qfrc_passive + data.qfrc_actuator), rel=1e-6)


def test_what_is_no_friction_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no joint has frictionloss"):
        read_mujoco_friction(write(tmp_path / "a.xml", '<motor joint="pan"/>'))
    bristle = (
        '<dcmotor joint="pan" input="none" resistance="1" motorconst="0 0" lugre="9 1 0 0 1"/>'
    )
    with pytest.raises(ConfigError, match="levels of its bristle"):
        read_mujoco_friction(write(tmp_path / "b.xml", bristle))


def draw_lugre(generator: np.random.Generator) -> dict[str, float]:
    """Draw a law; its viscous friction is up to twice what its micro-damping needs, or drives."""
    coulomb = generator.uniform(1.0, 10.0)
    static = coulomb * generator.uniform(1.0, 2.0)
    micro_damping = generator.uniform(1.0, 40.0)
    needed = micro_damping * (static / coulomb - 1.0)
    return {
        "sigma_0": coulomb / generator.uniform(1e-3, 1e-2),
        "sigma_1": micro_damping,
        "sigma_2": needed * generator.uniform(-1.0, 2.0),
        "F_c": coulomb,
        "F_s": static,
        "v_s": generator.uniform(0.02, 0.2),
        "tau_0": 0.0,
    }


def test_passivity_of_a_dcmotor_is_that_of_the_fmu(tmp_path: Path) -> None:
    """Of 20 random LuGre laws; those of their export, and the numbers typed into an MJCF."""
    generator = np.random.default_rng(0)
    names = [f"j{number}" for number in range(20)]
    laws = [law("lugre", {}, **draw_lugre(generator)) for _ in names]
    model = hesr.FrictionModel(
        law="lugre", robot="bench", joints=tuple(names), laws=tuple(laws), sample_time=STEP
    )
    fmu = hesr.export(model, tmp_path / "lugre.fmu", no_documentation=True)
    hesr.export(model, tmp_path / "friction.xml", format="mjcf")
    links = "".join(f'<body><joint name="{name}"/><geom size=".1"/></body>' for name in names)
    scene = tmp_path / "scene.xml"
    scene.write_text(
        f'{HEAD}<include file="friction.xml"/><worldbody>{links}</worldbody></mujoco>',
        encoding="utf-8",
    )
    report = hesr.test({"fmu": fmu, "mjcf": scene}, kind="passivity")
    verdicts = {
        name: [certificate.verdict for certificate in audit.certificates]
        for name, audit in report.audits.items()
    }
    assert verdicts["mjcf"] == verdicts["fmu"]
    assert set(verdicts["fmu"]) == {"proven", "tested", "refuted"}


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_the_command_refutes_with_the_cycle(tmp_path: Path, cli: Hesr) -> None:
    bristle = 'lugre="5000 4 3 6 .05" damping="-9"'
    motor = f'<dcmotor joint="pan" input="none" resistance="1" motorconst="0 0" {bristle}/>'
    path = write(tmp_path / "arm.xml", motor, lift='frictionloss="2" damping="1"')
    said = cli("test", path, "--kind", "passivity", "--verbose")
    assert "arm: passivity" in said.out
    assert "refuted" in said.out
    assert "J per cycle" in said.out
    assert said.code == 1
