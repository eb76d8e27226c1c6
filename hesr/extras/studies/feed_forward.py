"""Following error of the user's own robot under feed-forward, predicted on the generated plant.

The servo is identified from the commands of a log. The plant runs along the commands of the log and
along those with feed-forward; the difference of the two is added to the measured error, so that
what the plant lacks, such as ripple, counts only where feed-forward changes it.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.loop.closed_loop import StandIn
from cosim.loop.traces import Following, FollowingError
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from fmu_src.run.variables import Value
from hesr_model.errors import HesrError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, smooth
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.rigid_body.servo import ServoFit, cascade, compute_commands, identify_servo
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, rms
from hesr_model.support.files import scratch_folder

AS_LOGGED = "commands as logged"
AHEAD = "commands sent ahead by the latency"

_MAX_DURATION = 30.0  # [s] of a log that are run
_DRAW_COUNT = 10  # plants with gains of the servo as likely as the identified ones
_INTERVAL_DEVIATIONS = 2.0  # standard deviations on each side of an interval

_log = logging.getLogger(__name__)


def predict_following(
    logs: Sequence[Log],
    robot: Robot,
    body: RigidBody,
    models: Mapping[str, FrictionModel],
    model: FrictionModel,
) -> Following:
    """Predict following errors of laws on the first log with commands, for the friction `model`."""
    try:
        commanded_logs = [log for log in logs if log.q_cmd is not None or log.dq_cmd is not None]
        first_log = (commanded_logs or logs)[0]
        log = max(first_log.parts(), key=lambda part: np.ptp(part.t))
        log = log.rows(log.t - log.t[0] <= _MAX_DURATION)
        servo = identify_servo(log, robot, body.parameters)
        with scratch_folder() as folder:
            return _predict_errors(log, robot, body, models, model, servo, folder / "Plant.fmu")
    except HesrError as error:
        return Following(missing=str(error).rstrip("."))


def _predict_errors(
    log: Log,
    robot: Robot,
    body: RigidBody,
    models: Mapping[str, FrictionModel],
    model: FrictionModel,
    servo: ServoFit,
    fmu: Path,
) -> Following:
    commands = dict(feed_forward(log, robot, body, models, servo))
    kv, ki, kp = (tuple(map(float, gains)) for gains in cascade(servo.factors))
    has_position_loop = any(kp)
    if not has_position_loop:
        kp = ()
    plant_body = PlantBody.from_robot(robot, body)
    export_plant(model, fmu, plant_body=plant_body, kv=kv, ki=ki, kp=kp or None, bare=True)
    missing_torque = _estimate_missing_torque(log, robot, body, model)
    generator = np.random.default_rng(0)
    drawn_factors = [servo.factors, *(servo.draw(generator) for _ in range(_DRAW_COUNT))]
    rows = []
    with FmuInstance(fmu, name="plant") as instance:
        plant = _LoggedPlant(instance, log, servo, has_position_loop)
        logged_runs = _run_command(plant, commands[AS_LOGGED], missing_torque, drawn_factors)
        for name, command in commands.items():
            runs = logged_runs
            if name != AS_LOGGED:
                runs = _run_command(plant, command, missing_torque, drawn_factors)
            rows.append(_compute_error(name, log, logged_runs, runs))
    return Following(log=log.name, latency=servo.latency, kv=kv, ki=ki, kp=kp, rows=tuple(rows))


@dataclass(frozen=True)
class _LoggedPlant:
    """The generated plant with the servo of a log, from the first position of the log."""

    instance: FmuInstance
    log: Log
    servo: ServoFit
    has_position_loop: bool

    def run(self, command: tuple[Array, Array], missing_torque: Array, factors: Array) -> Array:
        """Return the positions (N, n) of the plant along commands.

        The plant lacks `missing_torque` (N, n) [N.m]; `factors` (n, 3) are those of the servo.
        """
        instance = self.instance
        log = self.log
        self._start(factors)
        joints = range(1, log.q.shape[1] + 1)
        if self.has_position_loop:
            input_names: tuple[str, ...] = ("q_cmd", "dq_cmd", "tau")
            input_rows = np.hstack([*command, -missing_torque])
        else:
            input_names = ("dq_cmd", "tau")
            input_rows = np.hstack([command[1], -missing_torque])
        inputs = instance.buffer(
            [f"{name}[{number}]" for name, number in product(input_names, joints)]
        )
        outputs = instance.buffer([f"q[{number}]" for number in joints])
        first_outputs = outputs.read().copy()
        times = log.t[:-1] - log.t[0]
        rows = step_rows(instance, inputs, outputs, times, np.diff(log.t), input_rows[:-1])
        return np.vstack([first_outputs, rows])

    def _start(self, factors: Array) -> None:
        kv, ki, kp = cascade(factors)
        settings = {
            "q_start": self.log.q[0],
            "servo_kv": kv,
            "servo_ki": ki,
            "gravity_share": self.servo.gravity_share,
        }
        if self.has_position_loop:
            settings["servo_kp"] = kp
        start_values: dict[str, Value] = {
            name: tuple(map(float, values)) for name, values in settings.items()
        }
        latency = self.servo.latency
        if not self.servo.held:
            # The plant holds a command, on average half a period behind a line to the next one.
            latency -= 0.5 * self.log.period
        start_values["latency"] = max(latency, 0.0)
        if self.instance.used:
            self.instance.reset()
        self.instance.initialise(start=self.instance.variables.expand_values(start_values))


class _CommandRuns(NamedTuple):
    """Positions (N, n) [rad] of the plant along one command."""

    free: list[Array]  # without the missing torque, with the identified gains, then drawn ones
    held: Array  # with the missing torque at the times of the log
    shifted: Array  # with the missing torque at the positions of the log


def _run_command(
    plant: _LoggedPlant,
    command: tuple[Array, Array],
    missing_torque: Array,
    drawn_factors: Sequence[Array],
) -> _CommandRuns:
    """Run the plant along one command, with and without the torque (N, n) that it lacks."""
    factors = plant.servo.factors
    no_torque = np.zeros_like(missing_torque)
    free = [plant.run(command, no_torque, drawn) for drawn in drawn_factors]
    shifted_torque = _shift_missing_torque(plant.log, missing_torque, free[0])
    return _CommandRuns(
        free=free,
        held=plant.run(command, missing_torque, factors),
        shifted=plant.run(command, shifted_torque, factors),
    )


def _compute_error(
    command_name: str, log: Log, logged_runs: _CommandRuns, runs: _CommandRuns
) -> FollowingError:
    """Add what a command changes on the plant to the measured error; return RMS and interval."""
    logged_error = compute_commands(log)[0] - log.q
    shifted_error = logged_error + logged_runs.held - runs.shifted
    held_error = logged_error + logged_runs.held - runs.held
    free_errors = [
        logged_error + logged_q - q for logged_q, q in zip(logged_runs.free, runs.free, strict=True)
    ]
    if log.q_cmd is None:  # a velocity command fixes no position
        shifted_error = _remove_mean(shifted_error)
        held_error = _remove_mean(held_error)
        free_errors = [_remove_mean(error) for error in free_errors]

    central_error = rms(shifted_error)
    # It is not known whether the missing torque depends on time or on position, or persists.
    missing_error = np.maximum(rms(shifted_error - held_error), rms(shifted_error - free_errors[0]))
    drawn_errors = [rms(error) for error in free_errors]
    spread = np.hypot(missing_error, _INTERVAL_DEVIATIONS * np.std(drawn_errors, axis=0))
    lower_error = np.maximum(central_error - spread, 0.0)
    upper_error = central_error + spread
    return FollowingError(
        command=command_name,
        error=tuple(map(float, central_error)),
        low=tuple(map(float, lower_error)),
        high=tuple(map(float, upper_error)),
    )


def _remove_mean(errors: Array) -> Array:
    return np.asarray(errors - errors.mean(axis=0))


def feed_forward(
    log: Log, robot: Robot, body: RigidBody, models: Mapping[str, FrictionModel], servo: ServoFit
) -> Iterator[tuple[str, tuple[Array, Array]]]:
    """Yield commanded positions and velocities (N, n) by name."""
    t = log.t
    position, speed = compute_commands(log)
    yield AS_LOGGED, (position, speed)
    desired_log = Log(name=log.name, t=t, q=position, dq=None, tau=np.zeros_like(position))
    lead = servo.latency + 0.5 * log.period * servo.held
    q, dq, ddq = _advance_motion(smooth(desired_log, robot.description.log.filter_cutoff), lead)
    yield AHEAD, (q, dq)
    standstill = np.zeros_like(q)
    tau_load = robot.torque(body.parameters, q, dq, ddq)
    supported_torque = servo.gravity_share * robot.torque(
        body.parameters, q, standstill, standstill
    )
    yield StandIn.BODY_ONLY, (q, dq + _invert_servo(tau_load - supported_torque, t, servo))
    for law_name, model in models.items():
        try:
            friction = model.predict(t=t, dq=dq, q=q, tau_load=tau_load)
        except HesrError as error:
            _log.warning("warning: %s has no feed-forward: %s", law_name, error)
            continue
        yield law_name, (q, dq + _invert_servo(tau_load + friction - supported_torque, t, servo))


def _estimate_missing_torque(
    log: Log, robot: Robot, body: RigidBody, model: FrictionModel
) -> Array:
    """Return the torque (N, n) that body and law miss on a log, smoothed as its motion."""
    log_records = friction_records(log, robot, body)
    tau = np.column_stack([record.tau for record in log_records])
    missing_torque = tau - model.predict(log_records)
    return smooth(replace(log, q=missing_torque, dq=None), robot.description.log.filter_cutoff).q


def _shift_missing_torque(log: Log, missing_torque: Array, q: Array) -> Array:
    """Return the missed torque (N, n) when each joint reaches its positions sooner, as in `q`."""
    speed = np.gradient(log.q, log.t, axis=0)
    lead_times = np.sum((q - log.q) * speed, axis=0) / np.sum(speed**2, axis=0)
    columns = zip(lead_times, missing_torque.T, strict=True)
    return np.column_stack(
        [np.interp(log.t + lead_time, log.t, column) for lead_time, column in columns]
    )


def _advance_motion(motion: Motion, lead: float) -> tuple[Array, ...]:
    """Return position, velocity and acceleration (N, n) of a motion `lead` [s] later."""
    sampled_times = np.minimum(motion.t + lead, motion.t[-1])
    advanced = []
    for values in (motion.q, motion.dq, motion.ddq):
        columns = [np.interp(sampled_times, motion.t, column) for column in values.T]
        advanced.append(np.column_stack(columns))
    return tuple(advanced)


def _invert_servo(torque: Array, t: Array, servo: ServoFit) -> Array:
    """Return the velocities (N, n) whose servo adds `torque` to what it holds at first."""
    kv, ki, _ = cascade(servo.factors)
    velocities = np.zeros_like(torque)
    held_torque = np.where(ki > 0.0, torque[0], 0.0)
    for k, period in enumerate(np.diff(t)):
        velocities[k] = (torque[k] - held_torque) / (kv + 0.5 * period * ki)
        held_torque = held_torque + period * ki * velocities[k]
    velocities[-1] = velocities[-2]
    return velocities
