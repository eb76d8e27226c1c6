"""Position servo of a plant: errors become torque; delay, filter, limits, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import scipy
from hobby_servo import run_along, write_robot

from fmu_src.check.run import check
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.plant.servo import PositionServo
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot

Array = np.ndarray

MASS, CENTRE, ARMATURE, KP, VISCOUS = 0.4, 0.15, 0.02, 15.0, 0.4
WEIGHT = MASS * 9.81 * CENTRE
INERTIA = MASS * CENTRE**2 + 1e-5 + ARMATURE
RATE = 200.0
T = np.arange(601) / RATE


def smooth_model(coulomb: float = 0.0) -> FrictionModel:
    law = FrictionLaw(
        name="coulomb_viscous",
        form=estimator("coulomb_viscous").form({}),
        values={"F_c": coulomb, "sigma_2": VISCOUS, "tau_0": 0.0},
    )
    return FrictionModel(
        law="coulomb_viscous", robot="lever", joints=("joint1",), laws=(law,), sample_time=5e-3
    )


def export(folder: Path, *, coulomb: float = 0.0, fmi: int = 2, **servo: float) -> Path:
    robot = Robot(write_robot(folder, MASS, CENTRE))
    parameters = robot.nominal_parameters.copy()
    parameters[10 * robot.links] = ARMATURE
    changes = {name: (value,) for name, value in servo.items() if name != "latency"}
    default = PositionServo.from_stiffness((KP,))
    fields = {**vars(default), **changes, "latency": servo.get("latency", 0.0)}
    return export_plant(
        smooth_model(coulomb),
        folder / f"plant{fmi}.fmu",
        plant_body=PlantBody(robot=robot, parameters=parameters),
        servo=PositionServo(**fields),
        fmi=fmi,
    )


def integrate(command, *, kp: float = KP, ki: float = 0.0, limit: float = np.inf) -> Array:
    """Return the positions by SciPy, of a lever that hangs at 0."""

    def flow(t: float, x: Array) -> list[float]:
        error = command(t) - x[0]
        torque = np.clip(kp * error + ki * x[2], -limit, limit)
        return [
            x[1],
            (torque - WEIGHT * np.sin(x[0]) - VISCOUS * x[1]) / INERTIA,
            error,
        ]

    solution = scipy.integrate.solve_ivp(
        flow, (0.0, T[-1]), [0.0] * 3, t_eval=T, max_step=1.0 / RATE / 4, rtol=1e-9, atol=1e-11
    )
    return solution.y[0]


def held(t: float) -> float:
    """Return the command of the row before a time."""
    return float(COMMANDS[min(int(t * RATE + 1e-9), len(T) - 1)])


COMMANDS = 0.6 * np.sin(2.0 * np.pi * 0.8 * T) + 0.3 * (T > 1.5)


@pytest.mark.parametrize(
    ("servo", "truth"),
    [
        ({}, {}),
        ({"ki": 20.0}, {"ki": 20.0}),
        ({"torque_limit": 0.45}, {"limit": 0.45}),
    ],
    ids=["proportional", "integral", "limit"],
)
def test_the_motion_is_that_of_another_solver(
    tmp_path: Path, servo: dict[str, float], truth: dict[str, float]
) -> None:
    reached = run_along(export(tmp_path, **servo), T, COMMANDS, {"substep": 5e-4})
    expected = integrate(held, **truth)
    assert np.ptp(expected) > 0.3
    assert np.max(np.abs(reached - expected)) < 2e-4


@pytest.mark.parametrize("latency", [0.0023, 0.005, 0.0171, 0.1])
def test_commands_act_after_any_latency(tmp_path: Path, latency: float) -> None:
    reached = run_along(export(tmp_path, latency=latency), T, COMMANDS, {"substep": 5e-4})
    expected = integrate(lambda t: held(t - latency) if t >= latency else COMMANDS[0])
    assert np.max(np.abs(reached - expected)) < 2e-4


def test_the_motion_is_continuous_in_the_latency(tmp_path: Path) -> None:
    fmu = export(tmp_path)
    latencies = 0.012 + 1e-6 * np.arange(4)
    runs = [run_along(fmu, T, COMMANDS, {"latency": latency}) for latency in latencies]
    changes = np.array([np.max(np.abs(run - runs[0])) for run in runs[1:]])
    assert changes / changes[0] == pytest.approx([1.0, 2.0, 3.0], rel=1e-2)


def test_a_filter_and_a_speed_limit_shape_commands(tmp_path: Path) -> None:
    constant = np.full_like(T, 0.5)
    filtered = run_along(export(tmp_path, command_filter=0.05), T, constant, {"q_cmd[1]": 0.0})
    direct = run_along(export(tmp_path), T, constant, {})
    # At the start the filter is at the first command, so both jump from rest alike.
    assert np.max(np.abs(filtered - direct)) < 1e-9
    step = np.where(T < 0.5, 0.0, 0.5)
    expected = integrate(lambda t: 0.5 * (1.0 - np.exp(-(t - 0.5) / 0.05)) if t > 0.5 else 0.0)
    assert np.max(
        np.abs(run_along(export(tmp_path, command_filter=0.05), T, step, {}) - expected)
    ) < (1e-3)
    ramp = integrate(lambda t: float(np.clip(0.4 * (t - 0.5), 0.0, 0.5)))
    limited = run_along(export(tmp_path, speed_limit=0.4), T, step, {})
    assert np.max(np.abs(limited - ramp)) < 1e-3


def test_a_stuck_joint_starts_stuck_and_stays(tmp_path: Path) -> None:
    start = 0.5
    needed = WEIGHT * np.sin(start)
    command = np.full_like(T, start + 0.8 * needed / KP)  # friction carries the rest
    fmu = export(tmp_path, coulomb=0.3 * needed)
    assert np.all(run_along(fmu, T, command, {"q_start[1]": start}) == start)


def test_fmi_3_moves_alike_and_both_are_sound(tmp_path: Path) -> None:
    fmus = [export(tmp_path, fmi=fmi, ki=5.0, latency=0.012) for fmi in (2, 3)]
    runs = [run_along(fmu, T, COMMANDS, {}) for fmu in fmus]
    assert np.array_equal(*runs)
    for fmu in fmus:
        assert check(fmu).problems == ()


def test_negative_gains_and_two_servos_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="'kp' of joint 1 is -1"):
        PositionServo.from_stiffness((-1.0,))
    robot = Robot(write_robot(tmp_path, MASS, CENTRE))
    with pytest.raises(ExportError, match="two servos"):
        export_plant(
            smooth_model(),
            tmp_path / "two.fmu",
            plant_body=PlantBody.from_robot(robot),
            servo=PositionServo.from_stiffness((KP,)),
            kv=(1.0,),
        )
