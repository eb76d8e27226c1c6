"""Forward simulation: bodies and laws with known motion, and the twin to the last digit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_twin import MOTIONS

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from cosim.study.position_errors import simulate_tests
from fmu_src.arm.plant import Plant
from fmu_src.arm.truth import true_friction
from hesr_model.errors import SimulationError
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit
from hesr_model.forward.simulation import (
    Simulator,
    count_inner_steps,
    cut_windows,
    join_windows,
    position_errors,
    to_single_window,
)
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper, predict
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

TWIN = models_folder() / "uf850"

SLIDE = """
<mujoco>
  <worldbody>
    <body name="carriage">
      <joint name="axis" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def carriage(tmp_path: Path) -> Robot:
    (tmp_path / "slide.xml").write_text(SLIDE, encoding="utf-8")
    description = RobotDescription(
        name="axis",
        model=tmp_path / "slide.xml",
        joints=("axis",),
        rotor_inertia=False,
        log=LogFormat(),
    )
    return Robot(description)


def stribeck(**values: float) -> FrictionModel:
    form = registry()["stribeck"].form({})
    numbers = {c.name: values.get(c.name, 0.0) for c in form.coefficients} | {"v_s": 0.1}
    law = FrictionLaw(name="stribeck", form=form, values=numbers)
    return FrictionModel(
        law="stribeck",
        robot="axis",
        joints=("axis",),
        laws=(law,),
        sample_time=0.01,
        sliding=(True,),
    )


def axis_record(t: np.ndarray, force: np.ndarray, dq: np.ndarray, q: np.ndarray) -> FrictionRecord:
    zero = np.zeros_like(t)
    return FrictionRecord(
        log="run", joint="axis", t=t, dq=dq, q=q, tau_load=zero, tau=force, sliding=True
    )


def test_mass_and_weight_match_the_body(carriage: Robot) -> None:
    mass, bias = carriage.dynamics(carriage.nominal_parameters, np.ones((3, 1)), np.ones((3, 1)))
    np.testing.assert_allclose(mass, np.full((3, 1, 1), 5.0))
    np.testing.assert_allclose(bias, 0.0, atol=1e-12)


def test_a_mass_with_viscous_friction_follows_the_closed_form(carriage: Robot) -> None:
    """Closed form of m q'' + d q' = F from rest."""
    t, m, d, force = np.arange(0, 1.0, 0.002), 5.0, 20.0, 3.0
    lag = m / d
    q = force / d * (t - lag * (1.0 - np.exp(-t / lag)))
    dq = force / d * (1.0 - np.exp(-t / lag))
    model = stribeck(sigma_2=d)
    window = to_single_window([axis_record(t, np.full_like(t, force), dq, q)])
    found = Simulator(robot=carriage, parameters=carriage.nominal_parameters, model=model).run(
        window
    )
    # Implicit steps of 2 ms delay the velocity by half a step.
    np.testing.assert_allclose(found[0, :, 0], q, atol=2e-3 * np.abs(q).max())
    (error,) = position_errors(found, window)
    assert error is not None
    assert error < 1e-3 * np.abs(q).max()


@pytest.mark.parametrize("force", [1.9, -1.9])
def test_a_force_below_coulomb_friction_moves_nothing(carriage: Robot, force: float) -> None:
    t = np.arange(0, 0.5, 0.01)
    still = np.zeros_like(t)
    dahl = FrictionModel(
        law="lugre", robot="axis", joints=("axis",), sample_time=0.01, sliding=(True,),
        laws=(FrictionLaw(
            name="lugre", form=registry()["lugre"].form({}),
            values={"F_c": 2.0, "F_s": 2.0, "v_s": 0.1, "sigma_0": 1e7, "sigma_1": 0.0,
                    "sigma_2": 1.0, "tau_0": 0.0},
        ),),
    )  # fmt: skip
    window = to_single_window([axis_record(t, np.full_like(t, force), still, still)])
    found = Simulator(robot=carriage, parameters=carriage.nominal_parameters, model=dahl).run(
        window
    )
    assert np.abs(found).max() < 2e-6  # bristles of 1e7 N/m, at any step


def test_steps_match_a_law_over_a_log(registry_models: dict[str, FrictionModel]) -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.01, 60))
    dq, q, load = np.cumsum(rng.normal(size=(3, 60)), axis=1) * np.array([[0.05], [0.01], [1.0]])
    dq[0] = 0.0  # at rest, laws begin at their start values
    for name, model in registry_models.items():
        law = model.laws[0]
        expected = predict(law, t=t, dq=dq, q=q, tau_load=load)
        steps, x = LawStepper(law), np.array(law.start)[:, None].repeat(2, axis=1)
        for k in range(60):
            dt = np.full(2, t[k] - t[k - 1] if k else 0.0)
            inputs = (np.full(2, column[k]) for column in (dq, q, load))
            torque, x = steps(dt, *inputs, x)
            np.testing.assert_allclose(
                torque, expected[k], rtol=1e-9, atol=1e-9, err_msg=f"{name}, row {k}"
            )


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return the twin's body and friction, the fitted ones, and its torque at 1 ms."""
    path = tmp_path_factory.mktemp("twin") / "motions.toml"
    path.write_text(MOTIONS, encoding="utf-8")
    motions, plant = Motions.read(path), Plant.read(TWIN / "plant.toml")
    robot = Robot(RobotDescription.read(TWIN / "robot.toml"))
    logs = {r.log.name: r.log for r in record_motions(motions, plant)}
    body = identify([logs["excitation"]], robot)
    law = fit("lugre", friction_records(logs["sweep"], robot, body), robot="uf850")
    one = motions.model_copy(
        update={"motions": tuple(m for m in motions.motions if m.name == "trial")}
    )
    (fine,) = record_motions(one, plant.model_copy(update={"sample_rate": 1000.0}))
    truth = true_friction(plant.model, plant.joints, sample_time=1e-3)
    zero = np.zeros(len(fine.log.t))
    log = [
        FrictionRecord(
            log="trial",
            joint=joint,
            t=fine.log.t,
            tau_load=zero,
            dq=fine.truth.dq[:, k].copy(),
            q=fine.truth.q[:, k].copy(),
            tau=fine.truth.tau_meas[:, k].copy(),
        )
        for k, joint in enumerate(robot.description.joints)
    ]
    return {"robot": robot, "body": body, "law": law, "truth": truth, "log": log}


@pytest.mark.parametrize("length", [0.2, 0.5])
def test_true_parameters_simulate_the_twin(twin: dict[str, object], length: float) -> None:
    """Below a hundredth of LuGre's error: with MuJoCo's own order of steps, only round-off."""
    robot, body = twin["robot"], twin["body"]
    windows = cut_windows([twin["log"]], length)
    true = Simulator(
        robot=robot, parameters=robot.nominal_parameters, model=twin["truth"], as_plant=True
    )
    lugre = Simulator(robot=robot, parameters=body.parameters, model=twin["law"], as_plant=True)
    of_true, of_lugre = (
        np.array(position_errors(one.run(windows), windows), dtype=float) for one in (true, lugre)
    )
    assert np.all(of_true < 0.01 * of_lugre)
    assert np.all(of_true < 1e-9)
    assert np.all(of_lugre > 1e-4)
    assert np.all(of_lugre < 0.01)


def test_inner_steps_of_both_orders_agree(twin: dict[str, object]) -> None:
    """At 1 ms the order of steps matters far less than the choice of law."""
    robot, windows = twin["robot"], cut_windows([twin["log"]], 0.2)
    true = Simulator(robot=robot, parameters=robot.nominal_parameters, model=twin["truth"])
    errors = np.array(position_errors(true.run(windows), windows), dtype=float)
    assert np.all(errors < 2e-4)


def test_sets_of_windows_are_simulated_together(twin: dict[str, object]) -> None:
    robot, log = twin["robot"], twin["log"]
    later = [replace(record, t=record.t + 3.0) for record in log]
    sets = [cut_windows([log], 0.2), cut_windows([later, log], 0.2)]
    one = Simulator(robot=robot, parameters=robot.nominal_parameters, model=twin["law"])
    alone = np.concatenate([one.run(w) for w in sets])
    np.testing.assert_allclose(one.run(join_windows(sets)), alone, rtol=0.0, atol=1e-9)


def test_rounded_times_add_no_inner_steps() -> None:
    t = 17.0 + 0.005 * np.arange(400)
    assert np.ptp(np.diff(t)) > 0.0
    assert {count_inner_steps(np.array([dt])) for dt in np.diff(t)} == {2}
    assert [count_inner_steps(np.array([1e-3, dt])) for dt in (0.0025, 0.0026, 0.008)] == [1, 2, 4]


def test_impossible_simulations_are_refused(twin: dict[str, object]) -> None:
    robot, log = twin["robot"], twin["log"]
    with pytest.raises(SimulationError, match=r"log trial: too short .* 9 s"):
        cut_windows([log], 9.0)
    hollow = Simulator(robot=robot, parameters=-robot.nominal_parameters, model=twin["law"])
    with pytest.raises(SimulationError, match="mass matrix is not positive; identify"):
        hollow.run(cut_windows([log], 0.2))


def test_a_diverging_simulation_says_nothing_of_the_body(twin: dict[str, object]) -> None:
    robot = twin["robot"]
    windows = cut_windows([twin["log"]], 0.2)
    thrown = replace(windows, tau=1e12 * windows.tau)
    possible = Simulator(robot=robot, parameters=robot.nominal_parameters, model=twin["law"])
    assert max(error or np.inf for error in position_errors(possible.run(thrown), thrown)) > 1e6


def test_windows_cover_a_log_after_its_run_in() -> None:
    t = 0.01 * np.arange(500)
    log = [axis_record(t, t, 2.0 * t, 3.0 * t)]
    windows = cut_windows([log, [replace(log[0], t=t + 7.0)]], 0.5)
    assert [row for place, row in windows.places if place == 0] == list(range(100, 450, 50))
    assert windows.t.shape == (14, 51)
    np.testing.assert_array_equal(windows.q[:7, 0, 0], 3.0 * t[100:450:50])
    np.testing.assert_array_equal(windows.t[7:], windows.t[:7] + 7.0)


def test_windows_of_alternate_blocks_share_no_row(carriage: Robot) -> None:
    t = 1000.0 + np.arange(0, 9.1, 0.01)
    log = [axis_record(t, 0.0 * t, 0.0 * t, np.sin(t))]
    halves: list[set[float]] = [set(), set()]
    for length in (0.5, 2.0):
        cut = cut_windows([log, log], length)
        blocks = cut.blocks(2.0)
        assert set(blocks) == {0.0, 1.0, 2.0, 3.0, 4.0}  # those of the second log begin at 1
        first = np.array([part == 0 for part, _ in cut.places])
        for k, half in enumerate(halves):
            some = cut.select(first & (blocks % 2 == k))
            assert len(some.t) == len(some.places) > 0
            half |= set(some.t[:, :-1].ravel())
    assert not halves[0] & halves[1]


def test_one_joint_under_gravity_is_simulated_at_each_position(tmp_path: Path) -> None:
    """A pendulum: its weight changes with position, that of a carriage does not."""
    hinge = SLIDE.replace('type="slide" axis="1 0 0"', 'type="hinge" axis="0 1 0"')
    hanging = hinge.replace('<inertial pos="0 0 0"', '<inertial pos="0 0 -1"')
    (tmp_path / "slide.xml").write_text(hanging, encoding="utf-8")
    description = RobotDescription(
        name="axis",
        model=tmp_path / "slide.xml",
        joints=("axis",),
        rotor_inertia=False,
        log=LogFormat(),
    )
    robot = Robot(description)
    t = np.arange(0, 0.3, 1e-3)
    start = np.full_like(t, 0.5)
    model = stribeck(sigma_2=1e-6)
    window = to_single_window([axis_record(t, 0.0 * t, 0.0 * t, start)])
    found = Simulator(robot=robot, parameters=robot.nominal_parameters, model=model).run(window)
    swing = 5.0 * 9.81 / (5.0 + 1.0)  # weight over inertia
    expected = 0.5 - 0.5 * swing * np.sin(0.5) * t**2  # at first
    np.testing.assert_allclose(found[0, :50, 0], expected[:50], atol=5e-4)
    assert found[0, -1, 0] < 0.5 - 0.1


def test_whole_logs_are_simulated_where_nothing_hangs(carriage: Robot) -> None:
    t = 0.01 * np.arange(900)
    v = 0.5 * np.sin(t)
    mass, viscous = 5.0, 2.0
    force = mass * 0.5 * np.cos(t) + viscous * v
    q = 0.5 * (1.0 - np.cos(t))
    record = axis_record(t, force, v, q)
    log = Log(name="run", t=t, q=q[:, None], dq=v[:, None], tau=force[:, None])
    body = identify([log], carriage)
    model = stribeck(sigma_2=viscous)
    [errors] = simulate_tests({"stribeck": model}, {"test": [[record]]}, carriage, body).values()
    [axis_error] = errors.open_loop["stribeck"]
    assert axis_error is not None
    assert axis_error < 5e-3
    assert len(errors.windows["stribeck"]) == len(errors.lengths)
