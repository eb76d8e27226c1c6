"""Friction laws as plug-ins of MuJoCo: states, threads, rest and versions."""

import copy
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from registry_models import SAMPLES, models_of_registry

from fmu_src.pages.friction_page import holding_torque
from hesr.extras.mujoco_plugin import plugin_library
from hesr.extras.mujoco_plugin.plugin_library import export_mujoco_plugin
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import registry
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import models_folder

STEP = 0.002
FULL = mujoco.mjtState.mjSTATE_INTEGRATION
LOADED: dict[str, Path] = {}

BODY = """<body pos="0 0 {z}"><joint name="{name}" axis="0 1 0" armature="0.5"/>
<geom size=".05 .2" type="capsule" pos=".1 0 .1" mass="2"/>"""


def scene(
    plugin: Path, joints: tuple[str, ...], *, include: str = "", apart: bool = False
) -> mujoco.MjModel:
    """Return a chain of joints in gravity under a plug-in, or joints apart."""
    end = "</body>" if apart else ""
    bodies = "".join(BODY.format(z=0.3, name=name) + end for name in joints)
    bodies += "" if apart else "</body>" * len(joints)
    include = include or f'<include file="{plugin.with_suffix(".xml")}"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}"/>{include}<worldbody>{bodies}</worldbody></mujoco>'
    )


def plugin_of(model: FrictionModel, name: str, folder: Path) -> Path:
    """Load a law's plug-in, once per process, for names are unique in one."""
    if name not in LOADED:
        LOADED[name] = export_mujoco_plugin(model, folder / f"{name}.so")
        mujoco.mj_loadPluginLibrary(str(LOADED[name]))
    return LOADED[name]


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plugins")


@pytest.mark.ci
@pytest.mark.parametrize(
    "names", [SAMPLES, pytest.param((), marks=pytest.mark.nightly("laws"))], ids=["some", "all"]
)
def test_states_of_every_law_are_restored_and_equal_in_threads(
    names: tuple[str, ...], plugins: Path
) -> None:
    """Laws of one discretisation are joints of one plug-in."""
    names = names or tuple(registry())
    laws = dict(zip(names, (m.laws[0] for m in models_of_registry(names)), strict=True))
    for kind in sorted({law.discretisation for law in laws.values()}):
        own = {name: law for name, law in laws.items() if law.discretisation == kind}
        model = FrictionModel(
            law=kind, robot="bench", joints=(*own,), laws=(*own.values(),), sample_time=STEP
        )
        m = scene(plugin_of(model, f"{kind}_{len(names)}", plugins), model.joints, apart=True)
        restored(m, [1.0, -0.5, 0.3])
        in_threads(m)


def restored(m: mujoco.MjModel, speeds: list[float]) -> None:
    """Check that a saved state continues bit for bit in a copy, and after a reset."""
    d, size = mujoco.MjData(m), mujoco.mj_stateSize(m, FULL)
    state, later, again = (np.empty(size) for _ in range(3))
    d.qvel[:] = np.resize(speeds, m.nv)
    mujoco.mj_step(m, d, 300)
    mujoco.mj_getState(m, d, state, FULL)
    assert np.count_nonzero(d.plugin_state) > 0.5 * m.npluginstate
    other = copy.copy(d)
    mujoco.mj_step(m, d, 500)
    mujoco.mj_getState(m, d, later, FULL)
    mujoco.mj_step(m, other, 500)
    mujoco.mj_getState(m, other, again, FULL)
    np.testing.assert_array_equal(again, later)
    mujoco.mj_resetData(m, d)
    mujoco.mj_step(m, d, 20)
    mujoco.mj_setState(m, d, state, FULL)
    mujoco.mj_step(m, d, 500)
    mujoco.mj_getState(m, d, again, FULL)
    np.testing.assert_array_equal(again, later)


def in_threads(m: mujoco.MjModel) -> None:
    """Check that eight threads of rollouts agree with one."""
    d, rng = mujoco.MjData(m), np.random.default_rng(1)
    states = np.empty((32, mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    for row in states:
        mujoco.mj_resetData(m, d)
        d.qvel[:] = rng.normal(size=m.nv)
        mujoco.mj_step(m, d, 10)
        mujoco.mj_getState(m, d, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    one, _ = rollout.rollout(m, [d], states, nstep=400)
    many, _ = rollout.rollout(m, [mujoco.MjData(m) for _ in range(8)], states, nstep=400)
    np.testing.assert_array_equal(many, one)
    assert np.ptp(one[:, -1], axis=0).max() > 0.1


def test_the_scene_of_the_twin_moves_under_the_law(table1: FrictionModel, plugins: Path) -> None:
    """The friction elements of the scene are replaced by the plug-in, as its page says."""
    plugin = plugin_of(table1, "twin", plugins)
    tree = ElementTree.parse(models_folder() / "uf850" / "uf850.xml").getroot()
    actuators, sensors = tree.find("actuator"), tree.find("sensor")
    for element in actuators.findall("dcmotor"):
        actuators.remove(element)
        sensors.remove(sensors.find(f"*[@actuator='{element.get('name')}']"))
    tree.insert(0, ElementTree.Element("include", file=str(plugin.with_suffix(".xml"))))
    m = mujoco.MjModel.from_xml_string(ElementTree.tostring(tree, encoding="unicode"))
    d, count = mujoco.MjData(m), 4000
    d.qpos[:] = d.act[-3:] = (0.0, 0.3, -1.9)
    dq, q, load, torque = (np.empty((count, 3)) for _ in range(4))
    for k in range(count):
        d.ctrl[:] = np.tile(0.5 * np.sin(1.3 * k * m.opt.timestep) * np.array([1.0, 0.5, 0.8]), 2)
        dq[k], q[k] = d.qvel, d.qpos
        mujoco.mj_step(m, d)
        torque[k], load[k] = -d.qfrc_passive, d.qfrc_bias
    assert np.ptp(q, axis=0).min() > 0.3
    assert not d.warning.number.any()
    known = table1.predict(t=m.opt.timestep * np.arange(count), dq=dq, q=q, tau_load=load)
    np.testing.assert_allclose(torque[1:], known[1:], rtol=0.0, atol=1e-11 * np.abs(known).max())


def test_states_are_restored_bit_for_bit(table1: FrictionModel, plugins: Path) -> None:
    m = scene(plugin_of(table1, "restored", plugins), table1.joints)
    assert m.npluginstate == sum(len(law.form.memory) for law in table1.laws)
    restored(m, [1.0, -0.5, 0.3])
    d = mujoco.MjData(m)
    mujoco.mj_step(m, d, 20)
    assert d.plugin_state.any()
    mujoco.mj_resetData(m, d)
    assert not d.plugin_state.any()


def test_eight_threads_agree_with_one(table1: FrictionModel, plugins: Path) -> None:
    in_threads(scene(plugin_of(table1, "threads", plugins), table1.joints))


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICITFAST", "RK4"])
def test_friction_brings_a_joint_to_rest(
    integrator: str, registry_models: dict[str, FrictionModel], plugins: Path
) -> None:
    m = scene(plugin_of(registry_models["parfam_s"], "energy", plugins), ("j1",))
    m.opt.gravity[:], m.dof_armature[:] = 0.0, 5.0
    m.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    d = mujoco.MjData(m)
    d.qvel[:] = 3.0
    speeds = []
    for _ in range(5000):
        mujoco.mj_step(m, d)
        speeds.append(d.qvel[0])
    assert np.abs(speeds[-1000:]).max() < 1e-3
    # About 6 N.m of Coulomb friction stop 5 kg.m2 within 3 s.
    assert 1.0 < 0.002 * int(np.argmax(np.array(speeds) < 0.01)) < 3.0


def test_a_joint_at_rest_holds_small_pushes(
    registry_models: dict[str, FrictionModel], plugins: Path
) -> None:
    model = registry_models["parfam_s"]
    m = scene(plugin_of(model, "holding", plugins), ("j1",))
    m.opt.gravity[:], m.dof_armature[:] = 0.0, 1.0
    held, crept = holding_torque(model.laws[0]), []
    assert held > 1.0
    for share in (0.5, -0.5, 3.0):
        d = mujoco.MjData(m)
        d.qfrc_applied[:] = share * held
        mujoco.mj_step(m, d, 2500)
        middle = d.qpos[0]
        mujoco.mj_step(m, d, 2500)
        crept.append(abs(d.qpos[0] - middle))
    assert max(crept[:2]) < 1e-4
    assert crept[2] > 100.0 * max(crept[:2])


def loading(plugin: Path, code: str = "mujoco.mj_loadPluginLibrary(p)") -> str:
    """Return what a process prints that loads a plug-in."""
    text = f"import mujoco; p = {str(plugin)!r}; {code}"
    ended = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False
    )
    return ended.stdout + ended.stderr


def test_another_or_no_mujoco_gets_one_sentence(
    table1: FrictionModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugin_library, "version", lambda _: "9.8.7")
    other = export_mujoco_plugin(table1, tmp_path / "other.so")
    found = mujoco.mj_versionString()
    sentence = f"hesr.other: this plug-in is for MuJoCo 9.8.7, but the program has {found}; export"
    printed = loading(other)
    assert printed.startswith(sentence)
    assert len(printed.splitlines()) == 1
    text = f"import ctypes; ctypes.CDLL({str(other)!r})"
    alone = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False
    )
    assert alone.stderr.startswith(sentence.replace(found, "none"))


def test_instances_with_a_wrong_joint_or_law_are_refused(
    table1: FrictionModel, plugins: Path
) -> None:
    plugin = plugin_of(table1, "wrong", plugins)
    for joint, law, word in (("nowhere", "1", "'nowhere'"), ("joint1", "4", "from 1 to 3")):
        text = plugin.with_suffix(".xml").read_text(encoding="utf-8")
        bad = text.replace('value="joint1"', f'value="{joint}"').replace(
            'value="1"', f'value="{law}"'
        )
        file = plugins / f"bad_{law}.xml"
        file.write_text(bad, encoding="utf-8")
        bodies = "".join(BODY.format(z=0.3, name=f"joint{i}") for i in (1, 2, 3)) + "</body>" * 3
        xml = f'<mujoco><include file="{file}"/><worldbody>{bodies}</worldbody></mujoco>'
        code = f"mujoco.mj_loadPluginLibrary(p); m = mujoco.MjModel.from_xml_string('''{xml}'''); "
        printed = loading(plugin, code + "mujoco.MjData(m)")
        assert word in printed
        assert "Error" in printed


def test_other_suffixes_are_refused(table1: FrictionModel, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="plug-in of MuJoCo is a library"):
        export_mujoco_plugin(table1, tmp_path / "friction.dll")
    assert list(tmp_path.iterdir()) == []
