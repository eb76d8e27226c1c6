"""Components of a closed loop other than friction and arm, each compared with its definition."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import HARMONICS, start_values, trajectory
from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ExportError, SimulationError
from hesr_model.motions.trajectories import Fourier, Reversed, Sine, Sweep, chirp, random_fourier
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

UR10E = Path(__file__).parents[1] / "real" / "ur10e.toml"
STEP = 0.005
N = 3
Values = Mapping[str, Any]


@pytest.fixture(scope="module")
def uf850() -> Robot:
    return Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))


@pytest.fixture(scope="module")
def fmus(uf850: Robot, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    folder = tmp_path_factory.mktemp("blocks")
    contents = {
        "Trajectory": trajectory(N),
        "InverseDynamics": inverse_dynamics(uf850, uf850.nominal_parameters),
        "Controller": controller(N),
        "Velocity": velocity(N),
    }
    return {name: write_fmu(c, folder / f"{name}.fmu") for name, c in contents.items()}


BLOCKS = ("Trajectory", "InverseDynamics", "Controller", "Velocity")


def run(
    fmu: Path,
    outputs: Sequence[str],
    *,
    inputs: Mapping[str, np.ndarray] | None = None,
    start: Values | None = None,
    t: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Run an FMU as in the replay of a log: inputs (N, n) in, outputs (N, n) by name."""
    given = inputs or {}
    t = STEP * np.arange(len(next(iter(given.values())))) if t is None else t
    with FmuInstance(fmu) as block:
        names = [e for name in given for e in block.variables.elements(name)]
        read = {name: block.buffer(block.variables.elements(name)) for name in outputs}
        rows = np.hstack(list(given.values())) if given else np.empty((len(t), 0))
        batch = block.buffer(names)
        block.enter_initialisation(
            time=float(t[0]), start=block.variables.expand_values(start or {})
        )
        found: dict[str, list[np.ndarray]] = {name: [] for name in outputs}
        for k, row in enumerate(rows):
            if names:
                batch.values[:] = row
                batch.write()
            if k == 0:
                block.exit_initialisation()
            else:
                block.step(float(t[k - 1]), float(t[k] - t[k - 1]))
            for name, values in read.items():
                found[name].append(values.read().copy())
    return {name: np.array(values) for name, values in found.items()}


# --- Trajectory -------------------------------------------------------------------------------

OFFSET = np.array([0.1, 0.3, -1.9])
PEAK = np.array([1.3, 0.0, 1.1])
SWEEP = {"start": OFFSET, "amplitude": np.array([0.75, 0.6, 0.0]), "first": 0.1}

MOTIONS = {
    "fourier": random_fourier(
        seed=3, harmonics=HARMONICS, period=20.0, peak_velocity=PEAK + 0.1, offset=OFFSET, periods=2
    ),
    "short_fourier": random_fourier(
        seed=4, harmonics=2, period=1.0, peak_velocity=PEAK + 0.1, offset=OFFSET
    ).reverse_time(),
    "sine": Sine(offset=OFFSET, amplitude=PEAK, frequency=0.25, periods=3),
    "sweep": Sweep(
        **SWEEP, swing=np.array([0.45, -0.3, 0.2]), swing_phase=np.array([0.0, 1.0, 2.0]),
        swing_period=7.0, last=0.45, length=42.0,
    ),
    "chirp": chirp(**SWEEP, last=1.0, length=4.68),
}  # fmt: skip


@pytest.mark.parametrize("preview", [0.0, 0.0125])
@pytest.mark.parametrize("name", MOTIONS)
def test_trajectories_match_python(fmus: Mapping[str, Path], name: str, preview: float) -> None:
    motion = MOTIONS[name]
    t = STEP * np.arange(round(motion.duration / STEP) + 1)
    names = ("q", "dq", "ddq")
    found = run(
        fmus["Trajectory"],
        [*names, *(f"{n}_ahead" for n in names)],
        t=t,
        start=start_values(motion) | {"preview": preview},
    )
    for tail, ahead in (("", 0.0), ("_ahead", preview)):
        for one, expected in zip(names, motion.sample(t + ahead), strict=True):
            np.testing.assert_allclose(found[one + tail], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["sine", "sweep"])
def test_trajectories_allow_uneven_steps_and_any_start_time(
    fmus: Mapping[str, Path], name: str
) -> None:
    t = 1.3 + np.cumsum(np.random.default_rng(0).uniform(1e-4, 0.3, size=40))
    found = run(fmus["Trajectory"], ["q", "dq"], t=t, start=start_values(MOTIONS[name]))
    q, dq, _ = MOTIONS[name].sample(t)
    np.testing.assert_allclose(found["q"], q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["dq"], dq, rtol=0, atol=1e-12)


def test_fast_sweeps_allow_steps_of_many_periods(fmus: Mapping[str, Path]) -> None:
    """Up to 10 Hz; the integrated position must not depend on the step."""
    sweep = chirp(start=OFFSET, amplitude=PEAK, first=0.5, last=10.0, length=6.0)
    t = np.array([0.0, 0.5, 1.0, 2.3, 2.4, 4.0, 5.9, 6.0])
    found = run(fmus["Trajectory"], ["q", "dq"], t=t, start=start_values(sweep))
    for name, expected in zip(("q", "dq"), sweep.sample(t), strict=False):
        np.testing.assert_allclose(found[name], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("start", [-3.0, 0.0, 1e5, 1.7e9, 1e300])
@pytest.mark.parametrize("name", ["sweep", "chirp"])
def test_sweeps_are_at_rest_outside_their_length(
    fmus: Mapping[str, Path], name: str, start: float
) -> None:
    """Any start time works from the first step."""
    motion, t = MOTIONS[name], np.array([start])
    held = np.clip(t, 0.0, motion.duration)
    found = run(fmus["Trajectory"], ["q", "dq", "ddq"], t=t, start=start_values(motion))
    q, dq, ddq = motion.sample(held)
    np.testing.assert_allclose(found["q"], q, rtol=0, atol=1e-12)
    moves = start == held
    np.testing.assert_allclose(found["dq"], dq * moves, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["ddq"], ddq * moves, rtol=0, atol=1e-12)
    for one, expected in zip(("q", "dq", "ddq"), motion.sample(t), strict=True):
        np.testing.assert_allclose(found[one], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("first", "last", "length", "swing_period"),
    [
        (0.1, 0.45, 42.0, 0.5),  # the swing is faster than the sweep, then slower
        (1.0, 0.2, 20.0, 3.0),  # falling
        (0.5, 0.5, 20.0, 2.0),  # constant, with one constant term
        (0.5, 0.5 + 1e-9, 20.0, 3.0),
        (2.0, 9.0, 1.0, 1e3),
    ],
)
def test_positions_of_a_sweep_are_the_integral_of_its_velocity(
    fmus: Mapping[str, Path], first: float, last: float, length: float, swing_period: float
) -> None:
    """Also for sweeps that Python does not generate: Gauss quadrature over panels of 5 ms."""
    start = {"kind": "sweep", "first": first, "last": last, "length": length,
             "swing_period": swing_period, "amplitude": (1.0, 0.0, 0.3), "swing": (0.0, 1.0, 0.7),
             "swing_phase": (0.0, 0.4, -2.0)}  # fmt: skip
    edges = STEP * np.arange(round(length / STEP) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    middle = edges[:-1, None] + STEP / 2.0 * (1.0 + nodes)
    found = run(fmus["Trajectory"], ["q"], t=edges, start=start)["q"]
    dq = run(fmus["Trajectory"], ["dq"], t=middle.ravel(), start=start)["dq"]
    moved = STEP / 2.0 * np.einsum("pnj,n->pj", dq.reshape(*middle.shape, N), weights)
    np.testing.assert_allclose(found[1:], np.cumsum(moved, axis=0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", MOTIONS)
def test_trajectories_may_start_after_a_rest(fmus: Mapping[str, Path], name: str) -> None:
    t, rest, preview = STEP * np.arange(100), 0.0512, 0.01
    found = run(
        fmus["Trajectory"], ["q", "dq", "ddq", "q_ahead", "dq_ahead"], t=t,
        start=start_values(MOTIONS[name]) | {"preview": preview, "rest_time": rest},
    )  # fmt: skip
    for tail, time in (("", t), ("_ahead", t + preview)):
        q, dq, _ = MOTIONS[name].sample(np.maximum(time - rest, 0.0))
        np.testing.assert_allclose(found[f"q{tail}"], q, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found[f"dq{tail}"], dq, rtol=0, atol=1e-12)
    assert not found["ddq"][t < rest].any()


def test_unsupported_motions_are_refused() -> None:
    with pytest.raises(ExportError, match="kind 'Reversed' cannot be made"):
        start_values(Reversed(forward=MOTIONS["sweep"]))
    many = random_fourier(
        seed=1, harmonics=HARMONICS + 1, period=9.0, peak_velocity=PEAK + 1, offset=OFFSET
    )
    with pytest.raises(ExportError, match="11 harmonics cannot be made"):
        start_values(many)


def test_start_values_name_every_harmonic() -> None:
    """Unused harmonics are zero, whatever the FMU was set to before."""
    motion = MOTIONS["short_fourier"]
    assert isinstance(motion, Fourier)
    values = start_values(motion)
    assert len([name for name in values if name[0] in "ab"]) == 2 * N * HARMONICS
    assert values["a[2,1]"] == motion.a[1, 0]
    assert values["b[3,10]"] == 0.0


# --- InverseDynamics --------------------------------------------------------------------------


def poses(n: int, count: int = 200) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    scales = {"q": 3.0, "dq": 2.0, "ddq": 10.0}
    return {name: rng.uniform(-s, s, size=(count, n)) for name, s in scales.items()}


def off_by(fmu: Path, robot: Robot, parameters: np.ndarray, start: Values) -> float:
    """Largest error of the FMU's torque, relative to the largest torque of the joint."""
    inputs = poses(robot.n)
    found = run(fmu, ["tau"], inputs=inputs, start=start)["tau"]
    expected = robot.torque(parameters, *inputs.values())
    return float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())


def names_of(robot: Robot) -> list[str]:
    """The FMU's names of a robot's parameters."""
    links = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    joints = range(1, robot.n + 1)
    return [f"link[{i}].{p}" for i in joints for p in links] + [f"link[{i}].Ir" for i in joints]


def test_torque_is_right_for_the_uf850(fmus: Mapping[str, Path], uf850: Robot) -> None:
    assert off_by(fmus["InverseDynamics"], uf850, uf850.nominal_parameters, {}) <= 1e-12


def test_torque_is_right_for_other_parameters(fmus: Mapping[str, Path], uf850: Robot) -> None:
    """Arbitrary numbers, as from identification: also zero and negative masses."""
    values = np.random.default_rng(8).normal(size=len(uf850.parameter_names))
    values[::10] = 0.0
    start = dict(zip(names_of(uf850), values.tolist(), strict=True))
    assert off_by(fmus["InverseDynamics"], uf850, values, start) <= 1e-12


def test_torque_is_right_for_gravity_alone(fmus: Mapping[str, Path], uf850: Robot) -> None:
    q = poses(N)["q"]
    found = run(fmus["InverseDynamics"], ["tau"], inputs={"q": q})["tau"]
    expected = uf850.torque(uf850.nominal_parameters, q, 0.0 * q, 0.0 * q)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def check_robot(robot: Robot, folder: Path) -> None:
    fmu = write_fmu(inverse_dynamics(robot, robot.nominal_parameters), folder / "Body.fmu")
    assert off_by(fmu, robot, robot.nominal_parameters, {}) <= 1e-12


def test_torque_is_right_for_the_ur10e(tmp_path: Path) -> None:
    description = RobotDescription.read(UR10E)
    if not description.model.is_file():
        pytest.skip(f"the UR10e's URDF is not next to the repository, at {description.model}")
    check_robot(Robot(description), tmp_path)


TREE = """
<robot name="tree">
  <link name="base"/>
  <link name="l1"><inertial><origin xyz="0.1 -0.2 0.3" rpy="0.1 0.2 0.3"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0.03" izz="0.15"/></inertial></link>
  <link name="l2"><inertial><origin xyz="0 0.1 0.1"/><mass value="2"/>
    <inertia ixx="0.2" ixy="0" ixz="0.01" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="l3"><inertial><origin xyz="-0.1 0 0.2"/><mass value="1.5"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0.01" izz="0.07"/></inertial></link>
  <link name="l4"><inertial><origin xyz="0.05 0.05 0"/><mass value="1"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial></link>
  <link name="l5"><inertial><origin xyz="0.2 0 0"/><mass value="0.5"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="j1" type="prismatic"><parent link="base"/><child link="l1"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.5 -0.4 1.1"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="j2" type="continuous"><parent link="l1"/><child link="l2"/>
    <origin xyz="0 0.3 0.1" rpy="-1.2 0.3 0.2"/><axis xyz="0.48 0.6 0.64"/></joint>
  <joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/>
    <origin xyz="0.2 0 0.1" rpy="0 1.57 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
  <joint name="j4" type="prismatic"><parent link="l2"/><child link="l4"/>
    <origin xyz="-0.1 0.2 0" rpy="0.3 0.2 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="j5" type="revolute"><parent link="l4"/><child link="l5"/>
    <origin xyz="0 0 0.4" rpy="3 0 1"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
</robot>
"""


@pytest.mark.parametrize("rotors", [True, False])
def test_torque_is_right_for_a_tree_with_sliding_joints(tmp_path: Path, rotors: bool) -> None:
    urdf = tmp_path / "tree.urdf"
    urdf.write_text(TREE, encoding="utf-8")
    robot = Robot(
        RobotDescription(
            name="tree", model=urdf, joints=("j1", "j2", "j3", "j4", "j5"),
            gravity=(1.0, -2.0, -9.0), rotor_inertia=rotors,
        )
    )  # fmt: skip
    assert [joint.parent for joint in robot.tree] == [-1, 0, 1, 1, 3]
    assert [joint.prismatic for joint in robot.tree] == [True, False, False, True, False]
    check_robot(robot, tmp_path)


def test_torque_is_right_for_springs_and_balancers(tmp_path: Path) -> None:
    urdf = tmp_path / "tree.urdf"
    urdf.write_text(TREE, encoding="utf-8")
    own = RobotDescription(
        name="tree", model=urdf, joints=("j1", "j2", "j3", "j4", "j5"), springs=("j1", "j3"),
        balancers=("j3", "j5"),
    )  # fmt: skip
    for rotors in (True, False):
        robot = Robot(own.model_copy(update={"rotor_inertia": rotors}))
        parameters = robot.nominal_parameters.copy()
        parameters[robot.inertial :] = np.random.default_rng(3).uniform(-90.0, 90.0, 13)
        fmu = write_fmu(inverse_dynamics(robot, parameters), tmp_path / "Body.fmu")
        assert off_by(fmu, robot, parameters, {}) <= 1e-12
    more = {"spring[1].k": 5.0, "spring[3].sin2": -7.0}
    for name, value in more.items():
        i, _, kind = name.removeprefix("spring[").partition("].")
        parameters[robot.parameter_names.index(f"j{i}.{kind}")] = value
    assert off_by(fmu, robot, parameters, more) <= 1e-12


def test_torque_is_right_for_joints_that_follow_others(tmp_path: Path) -> None:
    urdf = tmp_path / "tree.urdf"
    follower = (
        '<joint name="j4" type="prismatic"><mimic joint="j2" multiplier="-0.4" offset="0.1"/>'
    )
    text = TREE.replace('<joint name="j4" type="prismatic">', follower)
    assert follower in text
    urdf.write_text(text, encoding="utf-8")
    robot = Robot(urdf)
    assert (robot.joints, robot.links) == (("j1", "j2", "j3", "j5"), 5)
    check_robot(robot, tmp_path)


# --- Controller -------------------------------------------------------------------------------

GAINS: dict[str, tuple[float, ...]] = {
    "Kp": (0.004, 0.005, 0.008),
    "Kd": (1e-5, 2e-5, 0.0),
    "Kx": (5.0, 0.0, 2.0),
    "Kv": (90.0, 150.0, 50.0),
    "Ki": (900.0, 1500.0, 0.0),
}
MORE: dict[str, float] = {"lambda": 3.0, "friction_gain": 0.8}
INPUTS = ("q_d", "dq_d", "tau_rb", "tau_f", "tau_g", "tau_meas", "q")


def signals(count: int = 60) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(6)
    return {n: rng.normal(size=(count, N)) * (20.0 if "tau" in n else 1.0) for n in INPUTS}


def controlled(fmus: Mapping[str, Path], compensation: str) -> tuple[Any, dict[str, np.ndarray]]:
    """Run the controller; return its inputs, including the desired torque, and its outputs."""
    given = signals()
    found = run(
        fmus["Controller"],
        ["dq_cmd", "tau_d", "dq_comp"],
        inputs=given,
        start=GAINS | MORE | {"compensation": compensation},
    )
    tau_d = given["tau_rb"] + 0.8 * given["tau_f"]
    np.testing.assert_allclose(found["tau_d"], tau_d, rtol=1e-14)
    outer = np.array(GAINS["Kx"]) * (given["q_d"] - given["q"])
    np.testing.assert_allclose(
        found["dq_cmd"], given["dq_d"] + found["dq_comp"] + outer, rtol=1e-12, atol=1e-13
    )
    return given | {"tau_d": tau_d}, found


def test_compensation_can_be_off(fmus: Mapping[str, Path]) -> None:
    _, found = controlled(fmus, "none")
    assert not found["dq_comp"].any()


def test_torque_error_is_fed_back(fmus: Mapping[str, Path]) -> None:
    given, found = controlled(fmus, "torque_error")
    error = given["tau_d"] - given["tau_meas"]
    rate = np.diff(error, axis=0, prepend=error[:1]) / STEP
    fade = np.exp(-3.0 * np.abs(given["dq_d"]))
    expected = fade * (np.array(GAINS["Kp"]) * error + np.array(GAINS["Kd"]) * rate)
    np.testing.assert_allclose(found["dq_comp"], expected, rtol=1e-11, atol=1e-14)


def test_the_servo_is_inverted(fmus: Mapping[str, Path]) -> None:
    """A servo in initial equilibrium gives the desired torque in the middle of each sample."""
    given, found = controlled(fmus, "servo_inversion")
    wanted = given["tau_d"] - given["tau_g"]
    Kv, Ki = np.array(GAINS["Kv"]), np.array(GAINS["Ki"])
    command = found["dq_comp"]
    held = np.where(Ki > 0.0, wanted[0], 0.0)  # by the servo's initial integral
    before = STEP * np.vstack([np.zeros(N), np.cumsum(command, axis=0)[:-1]])
    torque = held + Kv * command + Ki * (before + 0.5 * STEP * command)
    np.testing.assert_allclose(torque, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("compensation", ["none", "torque_error", "servo_inversion"])
def test_the_first_command_is_known_during_initialisation(
    fmus: Mapping[str, Path], compensation: str
) -> None:
    """Masters pass it on then: the loop starts at rest, whatever is stored later."""
    start = {"Kp": 0.01, "Kd": 0.01, "Kv": 10.0, "Ki": (50.0, 50.0, 0.0), "tau_rb": 20.0}
    given = {"tau_meas": 15.0, "tau_g": 5.0, "dq_d": 0.1, "lambda": 0.0}
    expected = {
        "none": [0.0, 0.0, 0.0],
        "torque_error": [0.05, 0.05, 0.05],
        "servo_inversion": [0.0, 0.0, 1.5],
    }
    with FmuInstance(fmus["Controller"]) as block:
        expanded = block.variables.expand_values
        names = [f"{n}[{i}]" for n in ("dq_comp", "dq_cmd", "tau_d") for i in range(1, N + 1)]
        for _ in range(2):
            block.enter_initialisation(
                start=expanded(start | {"compensation": compensation, "tau_rb": 7.0})
            )
            block.get(names)  # inputs may still change
            block.set(expanded(start | given))
            begun = block.get(names)
            np.testing.assert_allclose(begun[:N], expected[compensation], rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(begun[N : 2 * N], 0.1 + begun[:N], rtol=1e-15)
            block.exit_initialisation()
            np.testing.assert_array_equal(block.get(names), begun)
            block.step(0.0, STEP)
            block.reset()


@pytest.mark.parametrize("steps", [(2.0,), (0.4, 0.7), (0.2,), (1.1, 0.93, 3.4), (0.31830988618,)])
def test_the_controller_samples_at_its_own_step(
    fmus: Mapping[str, Path], steps: tuple[float, ...]
) -> None:
    """For any step of the host: it samples at multiples of its own step and holds in between."""
    names = [f"dq_cmd[{i}]" for i in range(1, N + 1)]
    start = GAINS | {"compensation": "servo_inversion"}
    rng = np.random.default_rng(5)

    def given(k: int) -> dict[str, float]:
        signals = [f"{name}[{i}]" for name in ("dq_d", "tau_f") for i in range(1, N + 1)]
        values = np.random.default_rng(k).normal(size=len(signals))
        return dict(zip(signals, values.tolist(), strict=True))

    with FmuInstance(fmus["Controller"]) as free, FmuInstance(fmus["Controller"]) as own:
        for block in (free, own):
            block.initialise(start=block.variables.expand_values(start))
        time, samples, k = 0.0, 0, 0
        while samples < 40:
            step = STEP * steps[k % len(steps)]
            # Both get the same inputs: the values at the last sample.
            values = given(int(rng.integers(1000)))
            free.set(values)
            if abs(time / STEP - round(time / STEP)) > 1e-6:  # values are held between samples
                assert free.get(names) == pytest.approx(own.get(names), rel=1e-12, abs=0.0)
            free.step(time, step)
            while STEP * (samples + 1) <= time + step + 1e-6 * STEP:
                own.set(values)
                own.step(STEP * samples, STEP)
                samples += 1
            time, k = time + step, k + 1
            np.testing.assert_allclose(free.get(names), own.get(names), rtol=1e-12)


@pytest.mark.parametrize("share", [0.92, 0.999, 1.01, 1.08, 1.9, 2.5])
def test_other_steps_are_never_mistaken_for_samples(fmus: Mapping[str, Path], share: float) -> None:
    """They are refused, or the outputs are those of the last sample."""
    start = {"Kv": 10.0, "Ki": 200.0, "tau_rb": 20.0, "compensation": "servo_inversion"}
    with FmuInstance(fmus["Controller"]) as block:
        expanded = block.variables.expand_values
        command = block.buffer(["dq_comp[1]"])

        def commands(count: int, step: float) -> list[float]:
            block.enter_initialisation(start=expanded(start | {"tau_rb": 0.0}))
            block.exit_initialisation()
            block.set(expanded({"tau_rb": 20.0}))
            found = []
            for k in range(count):
                block.step(k * step, step)
                found.append(float(command.read()[0]))
            block.reset()
            return found

        samples = commands(150, STEP)
        # 20 N.m of a servo with zero initial integral: the command decays as the integral takes
        # over.
        first, fading = 20.0 / (10.0 + 0.5 * STEP * 200.0), 1.0 - 200.0 * STEP / 10.5
        np.testing.assert_allclose(samples, first * fading ** np.arange(150), rtol=1e-9)
        count = int(149 / share)
        try:
            found = commands(count, share * STEP)
        except SimulationError:
            return
    passed = share * np.arange(1, count + 1)
    between = (np.abs(passed - np.round(passed)) > 1e-6) & (passed > 1.0)
    expected = np.array(samples)[np.floor(passed[between]).astype(int) - 1]
    np.testing.assert_allclose(np.array(found)[between], expected, rtol=1e-9)


# --- Velocity ---------------------------------------------------------------------------------


def test_velocity_is_the_difference_quotient(fmus: Mapping[str, Path]) -> None:
    q = np.random.default_rng(1).normal(size=(30, N))
    found = run(fmus["Velocity"], ["dq"], inputs={"q": q})["dq"]
    np.testing.assert_allclose(found[0], np.zeros(N))
    np.testing.assert_allclose(found[1:], np.diff(q, axis=0) / STEP, rtol=1e-12)


def test_velocity_is_low_pass_filtered(fmus: Mapping[str, Path]) -> None:
    """A ramp from rest: the step response of a first-order lag."""
    t = STEP * np.arange(60)
    q = np.outer(t, [1.0, -2.0, 0.0])
    found = run(fmus["Velocity"], ["dq"], inputs={"q": q}, start={"time_constant": 0.02})["dq"]
    expected = np.outer(1.0 - np.exp(-t / 0.02), [1.0, -2.0, 0.0])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


# --- all blocks --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "start", "said"),
    [
        ("Trajectory", {"period": 0.0}, "period is 0; it must be positive."),
        ("Trajectory", {"length": -1.0}, "length is -1; it must be positive."),
        ("Trajectory", {"first": 0.0}, "first is 0; it must be positive."),
        ("Trajectory", {"last": -0.1}, "last is -0.1; it must be positive."),
        ("Trajectory", {"swing_period": 0.0}, "swing_period is 0; it must be positive."),
        ("Controller", {"sample_time": 0.0}, "sample_time is 0 s; it must be positive."),
        (
            "Controller",
            {"compensation": "servo_inversion"},
            "Kv[1] is 0 N.m.s/rad; it must be positive for servo_inversion.",
        ),
        (
            "Controller",
            {"compensation": "servo_inversion", "Kv": 1.0, "Ki": (1.0, -1.0, 1.0)},
            "Ki[2] is -1 N.m/rad; it must not be negative for servo_inversion.",
        ),
        ("Velocity", {"time_constant": -0.1}, "time_constant is -0.1 s; it must not be negative."),
        (
            "Velocity",
            {"time_constant": float("nan")},
            "it cannot be nan; it must be a finite number",
        ),
    ],
)
def test_invalid_parameters_are_refused(
    fmus: Mapping[str, Path], block: str, start: Values, said: str
) -> None:
    with FmuInstance(fmus[block]) as component:
        with pytest.raises(SimulationError) as error:
            component.initialise(start=component.variables.expand_values(start))
        assert said in str(error.value)
        # The same instance is usable after a reset.
        component.reset()
        component.initialise()


def moved(block: str) -> tuple[dict[str, Any], Callable[[int], np.ndarray]]:
    """Parameters and inputs that exercise the whole memory of a block."""
    start: dict[str, dict[str, Any]] = {
        "Trajectory": dict(start_values(MOTIONS["sweep"])) | {"preview": 0.01},
        "Controller": GAINS | {"compensation": "servo_inversion"},
        "Velocity": {"time_constant": 0.03},
    }
    return start.get(block, {}), lambda k: np.sin(0.1 * k + np.arange(100.0))


@pytest.mark.parametrize("block", BLOCKS)
def test_runs_are_identical_after_reset_and_restore(fmus: Mapping[str, Path], block: str) -> None:
    start, motion = moved(block)
    with FmuInstance(fmus[block]) as component:
        variables = component.variables
        inputs = component.buffer(variables.inputs)
        outputs = component.buffer(list(variables.feedthrough))

        def steps(first: int, last: int) -> list[np.ndarray]:
            found = []
            for k in range(first, last):
                inputs.values[:] = motion(k)[: len(inputs.values)]
                inputs.write()
                component.step(STEP * k, STEP)
                found.append(outputs.read().copy())
            return found

        component.initialise(start=variables.expand_values(start))
        begun = steps(0, 30)
        saved = component._instance.slave.getFMUState()
        ended = steps(30, 60)
        component._instance.slave.setFMUState(saved)
        np.testing.assert_array_equal(steps(30, 60), ended)
        component._instance.slave.freeFMUState(saved)
        component.reset()
        component.initialise(start=variables.expand_values(start))
        np.testing.assert_array_equal(steps(0, 60), begun + ended)


@pytest.mark.parametrize(
    "block",
    [
        "Controller",
        *(pytest.param(b, marks=pytest.mark.nightly("laws")) for b in BLOCKS if b != "Controller"),
    ],
)
def test_checkers_find_no_problem(fmus: Mapping[str, Path], block: str) -> None:
    assert check(fmus[block]).problems == ()


@pytest.mark.parametrize("block", BLOCKS)
def test_fmpy_finds_no_problem(fmus: Mapping[str, Path], block: str) -> None:
    assert validate_fmu(str(fmus[block])) == []
