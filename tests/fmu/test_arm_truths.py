"""Alternative plants of the twin: losses and torsion as specified, equal in C and Python."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_models import HOME, OUTPUTS, STEP, UF850, Unpacked, assert_goes_on, run

from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.python_arm.simulation import Simulation
from fmu_src.arm.signals import read_signals
from fmu_src.arm.table import Losses, LossTable, OutputTable, SignalTable, StartTable
from fmu_src.arm.truth import GearElasticity, Truth, true_friction, write_truth
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ConfigError
from hesr_model.friction.predict import predict
from hesr_model.robots.mjcf import compile_model

PLANT, TABLE = Plant.read(UF850 / "plant.toml"), SignalTable.read(UF850 / "arm.toml")
QUIET = {f"{name}_noise[{i}]": 0.0 for name in ("q", "tau_meas") for i in (1, 2, 3)}
NAMES = ("strain_wave", "rate_and_state")


def written(name: str, folder: Path) -> tuple[Path, SignalTable]:
    path = folder / f"{name}.xml"
    return path, write_truth(PLANT.truths[name], PLANT.model, PLANT.joints, TABLE, path)


@pytest.fixture(scope="module", params=NAMES)
def truth(request, tmp_path_factory):
    """Name, FMU and Python simulation of a plant."""
    path, table = written(request.param, tmp_path_factory.mktemp(request.param))
    fmu = export_mjcf(path, path.with_suffix(".fmu"), table=table)
    return request.param, fmu, Simulation(read_signals(path, table))


def simulation(name: str, folder: Path) -> Simulation:
    return Simulation(read_signals(*written(name, folder)))


def commands(steps: int) -> np.ndarray:
    t = STEP * np.arange(steps)[:, None]
    return np.array([0.8, 0.6, 0.7]) * np.sin(2 * np.pi * np.array([0.9, 0.7, 1.1]) * t)


def by_name(rows: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(OUTPUTS, np.moveaxis(rows.reshape(len(rows), -1, 3), 1, 0), strict=True))


def at_speed(one: Simulation, speed: float, start: dict[str, float], seconds: float = 1.5):
    """Outputs once all joints move at a given speed."""
    rows = one.reset(HOME | QUIET | start)
    for _ in range(round(seconds / STEP)):
        rows = one.step([speed] * 3, STEP)
    return {name: values[0] for name, values in by_name(rows[None]).items()}


# --- agreement with C --------------------------------------------------------------------------


def test_the_fmu_matches_the_simulation_in_python(truth):
    _, fmu, one = truth
    inputs = commands(300)
    expected = [one.reset(HOME), *(one.step(row, STEP) for row in inputs)]
    found = []
    with FmuInstance(fmu) as arm:
        arm.initialise(start=HOME)
        outputs = [f"{name}[{i}]" for name in OUTPUTS for i in (1, 2, 3)]
        found.append(arm.get(outputs))
        for k, row in enumerate(inputs):
            arm.set({f"dq_cmd[{i}]": v for i, v in enumerate(row, start=1)})
            arm.step(k * STEP, STEP)
            found.append(arm.get(outputs))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert np.ptp(expected, axis=0).min() > 0.05


def test_a_saved_state_resumes_with_its_levels_and_ages(truth, tmp_path):
    _, fmu, _ = truth
    assert_goes_on(Unpacked(fmu, tmp_path), HOME | {"payload": 1.5, "friction_scale": 0.8})


def test_levels_of_instances_are_independent(truth):
    _, fmu, _ = truth
    with FmuInstance(fmu) as alone:
        alone.initialise(start=HOME)
        expected = run(alone, 60)
    with FmuInstance(fmu) as one, FmuInstance(fmu) as other:
        one.initialise(start=HOME)
        other.initialise(start=HOME | {"friction_scale": 3.0, "payload": 5.0})
        found = []
        for k in range(60):
            rows = run(one, 1, first=k)
            found += [rows[0]] if k == 0 else []
            found.append(rows[-1])
            run(other, 1, first=k)
    np.testing.assert_array_equal(found, expected)


def test_a_simulation_returns_to_its_levels_and_ages(truth):
    _, _, one = truth
    one.reset(HOME)
    inputs = commands(80)
    for row in inputs[:40]:
        one.step(row, STEP)
    state = one.state()
    first = [one.step(row, STEP) for row in inputs[40:]]
    one.restore(state)
    np.testing.assert_array_equal([one.step(row, STEP) for row in inputs[40:]], first)


# --- losses ------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.02, 0.2, -0.6])
def test_steady_friction_follows_rate_and_state(speed, tmp_path):
    truth = PLANT.truths["rate_and_state"]
    losses = truth.losses
    found = at_speed(simulation("rate_and_state", tmp_path), speed, {})
    v = np.abs(found["dq_true"])
    age = 1.0 / (v / losses.slip + 1.0 / losses.longest)
    level = (
        np.array(losses.constant)
        + losses.direct * np.log1p(v / losses.speed)
        + losses.evolution * np.log1p(age / losses.age)
    )
    expected = np.sign(speed) * (level + np.array(truth.viscous) * v)
    np.testing.assert_allclose(found["tau_f_true"], expected, rtol=2e-3)
    np.testing.assert_allclose(v, abs(speed), rtol=0.05)


def test_static_friction_grows_with_the_logarithm_of_rest(tmp_path):
    one = simulation("rate_and_state", tmp_path)
    losses = PLANT.truths["rate_and_state"].losses
    peaks = []
    for seconds in (1.0, 10.0):
        one.reset(HOME | QUIET)
        one.step([0.0] * 3, seconds)
        rows = [one.step([0.02] * 3, 0.001) for _ in range(1500)]
        peaks.append(by_name(np.array(rows))["tau_f_true"].max(axis=0))
    expected = np.array(losses.evolution) * np.log((1.0 + 10.0 / 0.01) / (1.0 + 1.0 / 0.01))
    np.testing.assert_allclose(np.diff(peaks, axis=0)[0], expected, rtol=0.25)


@pytest.mark.parametrize("payload", [0.0, 8.0])
def test_gear_losses_are_proportional_to_the_transmitted_torque(payload, tmp_path):
    truth = PLANT.truths["strain_wave"]
    found = at_speed(simulation("strain_wave", tmp_path), 0.15, {"payload": payload}, seconds=1.0)
    transmitted = found["tau_true"] - found["tau_f_true"]  # the acceleration is small
    level = np.array(truth.losses.constant) + truth.losses.load * np.abs(transmitted)
    expected = level + np.array(truth.viscous) * found["dq_true"]
    np.testing.assert_allclose(found["tau_f_true"], expected, rtol=0.02)
    assert abs(transmitted[1]) > 5.0


def test_the_friction_scale_includes_losses_and_their_damping(tmp_path):
    one = simulation("rate_and_state", tmp_path)
    single, double, none = (
        at_speed(one, 0.2, {"friction_scale": scale})["tau_f_true"] for scale in (1.0, 2.0, 0.0)
    )
    np.testing.assert_allclose(double, 2.0 * single, rtol=2e-3)
    np.testing.assert_allclose(none, 0.0, atol=1e-6)


def test_dry_friction_holds_a_load_at_rest(tmp_path):
    """The servo's integral is also constant; its torque would reveal creep."""
    one = simulation("rate_and_state", tmp_path)
    one.reset(HOME | QUIET | {"payload": 0.5})
    first = by_name(one.step([0.0] * 3, 1.0)[None])["q_true"][0]
    last = by_name(one.step([0.0] * 3, 10.0)[None])["q_true"][0]
    assert np.abs(last - first).max() < 1e-5


# --- torsion -----------------------------------------------------------------------------------


def test_torsion_follows_its_elements(tmp_path):
    """Slow loading with the rotor held follows the loops of a Prandtl model."""
    path, _ = written("strain_wave", tmp_path)
    model = compile_model(path)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    rotor, link = (int(model.joint(f"joint3{x}").dofadr[0]) for x in ("", "_link"))
    model.dof_damping[link] = 3.0  # no oscillation
    model.dof_frictionloss[:] = 1e4
    load = 8.0 * np.interp(np.arange(0, 20_000), [0, 4000, 12_000, 20_000], [0, 1, -1, 1])
    angle, torque = np.empty_like(load), np.empty_like(load)
    for k, force in enumerate(load):
        data.qfrc_applied[link] = force
        mujoco.mj_step(model, data)
        angle[k] = data.qpos[link] - data.qpos[rotor]
        torque[k] = -data.qfrc_spring[link]
    gear = PLANT.truths["strain_wave"].transmission
    assert gear is not None
    half = gear.backlash[2] / 2.0
    expected = gear.stiffness[2] * np.sign(angle) * np.maximum(np.abs(angle) - half, 0.0)
    for element in gear.hysteresis:
        force, before = 0.0, 0.0
        for k, now in enumerate(angle):
            force = np.clip(
                force + element.stiffness[2] * (now - before), -element.limit[2], element.limit[2]
            )
            before = now
            expected[k] += force
    np.testing.assert_allclose(torque[50:], expected[50:], rtol=0, atol=0.1)
    np.testing.assert_allclose(torque[2000::2000], load[2000::2000], rtol=0, atol=0.1)
    up, down = (
        np.interp(0.0, torque[a:b:s], angle[a:b:s])
        for a, b, s in ((12_000, 20_000, 1), (11_999, 4000, -1))
    )
    assert down - up > 1.5e-4  # hysteresis and play


def test_the_encoder_is_at_the_rotor_and_the_true_position_at_the_link(tmp_path):
    """A payload twists the gear: the link is lower than the encoder reading."""
    found = at_speed(simulation("strain_wave", tmp_path), 0.0, {"payload": 10.0}, seconds=3.0)
    twist = np.abs(found["q_true"] - found["q"])
    assert twist[0] < 1.5e-4 < 4e-4 < twist[1] < 3e-3  # gravity has no torque about the first axis
    np.testing.assert_allclose(found["dq_true"], 0.0, atol=5e-3)


# --- plant as a law ----------------------------------------------------------------------------


def test_the_true_friction_as_a_law_matches_the_arm(truth, tmp_path):
    name, _, one = truth
    path, table = written(name, tmp_path)
    rows = [one.reset(HOME | QUIET), *(one.step(row, STEP) for row in commands(600))]
    found = by_name(np.array(rows))
    law = true_friction(path, PLANT.joints, sample_time=STEP, losses=table.losses)
    t = STEP * np.arange(len(rows))
    transmitted = found["tau_true"] - found["tau_f_true"]
    for k in range(3):
        # The rotor's own inertia is not transmitted: its acceleration is small compared with the
        # load.
        tau = predict(
            law.laws[k],
            t=t,
            dq=found["dq_true"][:, k],
            q=found["q"][:, k],
            tau_load=transmitted[:, k],
        )
        moving = np.abs(found["dq_true"][:, k]) > 0.1
        error = (tau - found["tau_f_true"][:, k])[moving]
        assert np.sqrt(np.mean(error**2)) < 0.03 * np.std(found["tau_f_true"][:, k])


# --- refusals ----------------------------------------------------------------------------------

LOSS = {"constant": (1.0, 1.0, 1.0)}
GEAR = {"stiffness": (1.0,) * 3, "damping": (1.0,) * 2, "backlash": (0.0,) * 3}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"losses": {"constant": (1.0,)}}, "viscous has 3 entries; 1 are needed"),
        ({"losses": LOSS | {"load": (0.1,)}}, "load has 1 entries; 3 are needed"),
        ({"losses": LOSS | {"direct": (1.0,) * 3}}, "direct needs speed"),
        ({"losses": LOSS | {"evolution": (1.0,) * 3, "age": (1.0,) * 3}}, "evolution needs slip"),
        ({"losses": {"constant": (-1.0, 1.0, 1.0)}}, "greater than or equal to 0"),
        ({"transmission": GEAR}, "damping has 2 entries; 3 are needed"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_an_incomplete_plant_is_refused(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        Truth.model_validate({"losses": LOSS, "viscous": (1.0,) * 3} | change)


def test_a_plant_of_another_arm_is_refused(tmp_path):
    two = Truth(losses=Losses(constant=(1.0, 1.0)), viscous=(1.0, 1.0))
    with pytest.raises(ConfigError, match="truth is of 2 joints"):
        write_truth(two, PLANT.model, PLANT.joints, TABLE, tmp_path / "arm.xml")
    other = tmp_path / "other.xml"
    body = '<body><joint name="joint1"/><geom size="1"/></body>'
    other.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    with pytest.raises(ConfigError, match="joint 'joint2', or another file"):
        write_truth(
            PLANT.truths["rate_and_state"], other, PLANT.joints, TABLE, tmp_path / "arm.xml"
        )
    assert not (tmp_path / "arm.xml").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"joints": ("joint1",)}, "joints has 1 entries; 3 are needed"),
        ({"load": (0.1,) * 3}, "load needs carriers"),
        ({"load": (0.1,) * 3, "carriers": ("joint1",)}, "carriers has 1 entries; 3 are needed"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_incomplete_losses_are_refused(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        LossTable.model_validate(LOSS | {"joints": PLANT.joints} | change)


def test_incompatible_parts_are_named(tmp_path):
    path, table = written("rate_and_state", tmp_path)
    losing = table.model_copy(
        update={"losses": LossTable(joints=("joint1",), constant=(1.0,)), "start": {}}
    )
    with pytest.raises(
        ConfigError, match=r"'joint2' of 'outputs\.tau_f_true\.losses' has no losses"
    ):
        read_signals(path, losing)
    with pytest.raises(ConfigError, match="joint 'joint1' has losses"):
        read_signals(PLANT.model, TABLE.model_copy(update={"losses": losing.losses}))
    with pytest.raises(ValueError, match="losses has 1 entries; 2 are needed"):
        OutputTable(unit="N.m", sensors=({}, {}), losses=("joint1",))
    with pytest.raises(ValueError, match="others has 1 entries; 2 are needed"):
        StartTable(unit="rad", joints=("joint1", "joint2"), others=("joint3",))


def test_a_stiff_transmission_has_no_effect(tmp_path):
    """Without compliance, rotor and link move as one, as without a rotor."""
    losses = Losses(constant=(3.0, 3.0, 2.0))
    stiff = GearElasticity(
        stiffness=(6e4, 6e4, 3e4), damping=(60.0, 60.0, 20.0), backlash=(0.0,) * 3
    )
    rows = []
    for name, gear in (("one", None), ("two", stiff)):
        truth = Truth(losses=losses, viscous=(10.0,) * 3, transmission=gear)
        path = tmp_path / f"{name}.xml"
        table = write_truth(truth, PLANT.model, PLANT.joints, TABLE, path)
        one = Simulation(read_signals(path, table))
        one.reset(HOME | QUIET)
        rows.append(by_name(np.array([one.step(row, STEP) for row in commands(300)])))
    for name, most in (("q_true", 5e-4), ("dq_true", 2e-2), ("tau_true", 1.5)):
        np.testing.assert_allclose(rows[1][name], rows[0][name], rtol=0, atol=most, err_msg=name)
