"""Sliding and rest without a plant: coupling, first torque, lag, chatter, work over cycles."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import SLIDING, Scale, curve, figures, judge, plot
from hesr_model.audit import audit
from hesr_model.audit.attack import loaded_motions
from hesr_model.audit.properties import (
    ENERGY_ROUND_OFF,
    MAX_CHATTER,
    MAX_START_ERROR,
    MIN_LAG_WIDTH,
    MIN_USEFUL_STEP,
    PropertyResult,
    PropertyVerdict,
)
from hesr_model.errors import SimulationError
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

MIN_STEP = 5e-5  # [s] lower bound of the step search
MAX_STEP = 0.1  # [s] upper bound of the step search
_COARSE_STEPS = np.geomspace(MIN_STEP, MAX_STEP, 24)
_HALVINGS = 5
_MIN_STEP_COUNT = 400
_STOPPING_TIMES = 5.0  # run time in stopping times at the friction level
_MAX_RUN_TIME = 2.0  # [s]
_REST_SHARE = 1e-3  # share of the first speed below which a joint rests
_STOP_SHARE = 0.2  # share of the first speed below which a joint has stopped
_SMALL_SPEED = 1e-6  # [rad/s]
_MIN_SWITCHES = 8  # sign changes in a row; a true stop has fewer


def coupling(bench: FrictionBench, scale: Scale, inertia: Array) -> list[PropertyResult]:
    """Slide joints of an inertia (n,) [kg.m2] to a stop, with many coupling steps."""
    slide = partial(_slide, bench, scale, inertia)
    chatter_by_step: dict[float, Array] = {}
    has_stopped = np.zeros(bench.joints, dtype=bool)
    for dt in _COARSE_STEPS.tolist():
        dq = slide(dt)
        if not chatter_by_step:
            has_stopped = np.abs(dq[-1]) <= _STOP_SHARE * np.abs(dq[0])
        chatter_by_step[dt] = _find_chatter(dq)
        if all(any(joint_chatter) for joint_chatter in zip(*chatter_by_step.values(), strict=True)):
            break
    small_speed = np.full(bench.joints, _SMALL_SPEED)
    end_torques = [
        bench.start(load=scale.load, dq=dq, unmoved=True) for dq in (small_speed, -small_speed)
    ]
    # At rest with fixed states; the slope of a jump is huge.
    slopes = (end_torques[0] - end_torques[1]) / (2.0 * _SMALL_SPEED)
    is_driven = ~has_stopped & scale.is_driving
    dq = slide(max(MIN_USEFUL_STEP, MIN_STEP))[: int(0.2 / MIN_USEFUL_STEP)]
    t = MIN_USEFUL_STEP * np.arange(len(dq), dtype=float)
    results = []
    for j in range(bench.joints):
        first_chattering = next((dt for dt in chatter_by_step if chatter_by_step[dt][j]), None)
        largest_step = _find_largest_step(slide, j, list(chatter_by_step), first_chattering)
        slope = float(slopes[j])
        predicted_step = 2.0 * float(inertia[j]) / slope if slope > 0.0 else None
        joint_figures = figures(
            ("largest step without chatter", None if is_driven[j] else largest_step, "s"),
            ("2 J / slope at rest", predicted_step, "s"),
            ("slope at rest", slope, "N.m.s/rad"),
        )
        velocity_curve = curve("at 1 ms", t, np.nan_to_num(dq[:, j]), max_points=200)
        velocity_plot = plot("time", "velocity", velocity_curve)
        verdict: PropertyVerdict = "fail"
        if is_driven[j]:
            verdict = "not applicable"
            reason = "The joint does not stop at any step: the law drives it."
        elif largest_step is None:
            reason = f"It chatters even at the smallest step tried, {1e3 * MIN_STEP:g} ms."
        elif largest_step < MIN_USEFUL_STEP:
            reason = "Coupled explicitly at 1 ms it chatters."
        else:
            verdict = "pass"
            reason = "No chatter up to the largest step tried." if largest_step == MAX_STEP else ""
        property_result = PropertyResult(
            verdict=verdict, figures=joint_figures, reason=reason, plot=velocity_plot
        )
        results.append(property_result)
    return results


def _slide(bench: FrictionBench, scale: Scale, inertia: Array, dt: float) -> Array:
    """Return the velocity (K, n) of joints that slide to a stop; NaN after a failure."""
    first_speed = SLIDING * scale.speed
    stopping_time = float(
        np.max(inertia * first_speed / np.maximum(scale.level, 1e-6 * inertia * first_speed))
    )
    step_count = max(
        _MIN_STEP_COUNT, int(np.ceil(min(_STOPPING_TIMES * stopping_time, _MAX_RUN_TIME) / dt))
    )
    dq = np.full((step_count + 1, bench.joints), np.nan)
    dq[0] = velocity = first_speed
    q = bench.positions.copy()
    # Start with the states of rest, which excite the slope at rest.
    tau = bench.start(load=scale.load, dq=velocity, unmoved=True)
    # A divergence shows in the velocity; after a failure later rows stay NaN.
    with np.errstate(all="ignore"), suppress(SimulationError):
        for k in range(1, step_count + 1):
            velocity = velocity + dt / inertia * (scale.offset - tau)
            q = q + dt * velocity
            tau = bench.step(dt, velocity, q)
            dq[k] = velocity
    return dq


def _find_chatter(dq: Array) -> Array:
    """Return whether the velocity of each joint alternates from step to step, (n,)."""
    is_moving = np.abs(dq) > _REST_SHARE * np.abs(dq[0])
    signs = np.sign(dq)  # a diverging velocity has no finite products
    changes_sign = (signs[1:] * signs[:-1] < 0.0) & is_moving[1:] & is_moving[:-1]
    has_chatter = np.lib.stride_tricks.sliding_window_view(changes_sign, _MIN_SWITCHES, axis=0).all(
        axis=-1
    )
    return np.asarray(has_chatter.any(axis=0) | ~np.isfinite(dq).all(axis=0))


def _find_largest_step(
    slide: Callable[[float], Array], j: int, steps: list[float], first_chattering: float | None
) -> float | None:
    """Return the largest step [s] without chatter of a joint, below the first with chatter."""
    if first_chattering is None:
        return MAX_STEP
    if first_chattering == steps[0]:
        return None
    quiet_step = steps[steps.index(first_chattering) - 1]
    chattering_step = first_chattering
    for _ in range(_HALVINGS):
        trial_step = float(np.sqrt(quiet_step * chattering_step))
        if _find_chatter(slide(trial_step))[j]:
            chattering_step = trial_step
        else:
            quiet_step = trial_step
    return quiet_step


_MIN_SPEED_SHARE = 0.01  # slowest one-way motion, in trained speeds
_MAX_SPEED_SHARE = 0.11  # fastest one-way motion, in trained speeds
_PERIODS = (1.0, 50.0)  # [s]
_ROWS_PER_PERIOD = 500
_PERIOD_COUNT = 3  # the last one is measured
_ROUNDING = 1e-9  # [N.m]
_ANGLES = (1e-5, 1e-4, 1e-3)
_PHASES = (0.5 * np.pi, 1.5 * np.pi)
_LOADED_PERIOD_COUNT = 20
_PLOTTED_ROWS = 400
_START_SPEEDS = np.geomspace(0.05, 1.0, 5)  # in trained speeds
_READING_TIME = 1e-3  # [s] before the steady torque is read, as short as a servo's
_MIN_FRICTION = 1e-6  # [N.m]


def start(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Start at several speeds in both directions and slide on to the steady state."""
    dt = np.array([bench.sliding_time, _READING_TIME])
    torque_pairs = []
    for speed in _START_SPEEDS[:, None] * scale.speed:
        for dq in (speed, -speed):
            first_torque = bench.start(load=scale.load, dq=dq)
            torque_pairs.append(
                (first_torque, bench.move(dt, np.broadcast_to(dq, (2, len(dq))))[-1])
            )
    torques = np.array(torque_pairs).reshape(len(_START_SPEEDS), 2, 2, bench.joints)
    return [
        _judge_start(scale.speed[j] * _START_SPEEDS, torques[:, :, 0, j], torques[:, :, 1, j])
        for j in range(bench.joints)
    ]


def _judge_start(speeds: Array, first_torque: Array, steady_torque: Array) -> PropertyResult:
    """Judge (S, 2) first and steady torques at speeds (S,), forward and backward."""
    # Half the difference of both directions, free of the offset.
    friction = np.maximum(0.5 * np.abs(steady_torque[:, 0] - steady_torque[:, 1]), _MIN_FRICTION)
    relative_error = (first_torque - steady_torque) / friction[:, None]
    row, direction = np.unravel_index(int(np.argmax(np.abs(relative_error))), relative_error.shape)
    worst_error = float(relative_error[row, direction])
    speed = float(speeds[row]) * (-1.0 if direction else 1.0)
    sentence = f"At {speed:.3g} rad/s the first torque is off by {worst_error:.0%}."
    return judge(
        ("largest difference of the first torque, of the friction", abs(worst_error), "1"),
        ("at a velocity of", speed, "rad/s"),
        faults=[] if abs(worst_error) <= MAX_START_ERROR else [sentence],  # NaN fails
        plot=plot(
            "velocity",
            "torque",
            curve("first", speeds, first_torque[:, 0]),
            curve("steady", speeds, steady_torque[:, 0]),
        ),
    )


def lag(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Slide in one direction with oscillating speed, at two periods."""
    phase = 2.0 * np.pi / _ROWS_PER_PERIOD * (np.arange(_ROWS_PER_PERIOD * _PERIOD_COUNT) + 0.5)
    middle = 0.5 * (_MAX_SPEED_SHARE + _MIN_SPEED_SHARE)
    amplitude = 0.5 * (_MAX_SPEED_SHARE - _MIN_SPEED_SHARE)
    dq = (middle - amplitude * np.cos(phase))[:, None] * scale.speed
    torques = []
    for period in _PERIODS:
        bench.start(load=scale.load)
        torques.append(
            bench.move(np.full(len(dq), period / _ROWS_PER_PERIOD), dq)[-_ROWS_PER_PERIOD:]
        )
    fast, slow = torques
    return [
        _judge_lag(dq[-_ROWS_PER_PERIOD:, j], fast[:, j], slow[:, j], float(scale.level[j]))
        for j in range(bench.joints)
    ]


def _measure_loop_width(tau: Array) -> tuple[float, int]:
    """Return the largest distance of branches [N.m], + if acceleration is above, and its row."""
    # Rows k and -1 - k have the same speed.
    branch_distance = tau[: _ROWS_PER_PERIOD // 2] - tau[::-1][: _ROWS_PER_PERIOD // 2]
    row = int(np.argmax(np.abs(branch_distance)))
    width = float(branch_distance[row])
    return (width if abs(width) > _ROUNDING else 0.0), row


def _judge_lag(dq: Array, fast: Array, slow: Array, level: float) -> PropertyResult:
    (width, row), (slow_width, _) = _measure_loop_width(fast), _measure_loop_width(slow)
    accelerating = slice(0, _ROWS_PER_PERIOD // 2)
    mean_torque = 0.5 * (slow + slow[::-1])[accelerating]
    slope = np.gradient(mean_torque, dq[accelerating])
    faults = []
    if width == 0.0:
        faults.append("No lag: the torque follows the velocity at once.")
    else:
        if abs(width) < MIN_LAG_WIDTH * level:
            faults.append(f"The branches are only {abs(width) / level:.2%} of the level apart.")
        # Parts of the torque may rise at once: one fall suffices.
        if (width > 0.0 and slope.min() >= 0.0) or (width < 0.0 and slope[row] <= 0.0):
            faults.append("The torque leads the velocity instead of lagging behind it.")
        if abs(width) <= abs(slow_width):
            faults.append("Faster changes of the speed do not widen the loop.")
    curves = (
        curve(f"{period:g} s", dq, tau) for period, tau in zip(_PERIODS, (fast, slow), strict=True)
    )
    return judge(
        ("width of the loop at 1 Hz, + if acceleration is above", width, "N.m"),
        ("width at 0.02 Hz", slow_width, "N.m"),
        ("slope of the curve where it is widest", float(slope[row]), "N.m.s/rad"),
        faults=faults,
        plot=plot("velocity", "torque", *curves),
    )


def chatter(
    bench: FrictionBench, scale: Scale, trained_ranges: list[TrainedRange]
) -> list[PropertyResult]:
    """Rest under encoder noise, with the sample time and discretisation of the law."""
    noise = [audit.encoder_noise(trained_range) for trained_range in trained_ranges]
    dq, q = (np.column_stack([joint_noise[k] for joint_noise in noise]) for k in (0, 1))
    settling = noise[0][2]
    sample_time = trained_ranges[0].sample_time
    bench.start(load=scale.load, exact=False)
    tau = bench.move(np.full(len(dq), sample_time), dq, q)
    results = []
    for j, level in enumerate(scale.level.tolist()):
        joint_tau = tau[settling:, j]
        deviation = float(np.std(joint_tau))
        t = sample_time * np.arange(_PLOTTED_ROWS, dtype=float)
        sentence = f"That is {deviation / level:.0%} of the friction level."
        results.append(
            judge(
                ("standard deviation of the torque", deviation, "N.m"),
                faults=[sentence] if deviation > MAX_CHATTER * level else [],
                plot=plot(
                    "time", "torque", curve("at rest", t, joint_tau[:_PLOTTED_ROWS], max_points=150)
                ),
            )
        )
    return results


def work(
    bench: FrictionBench, trained_ranges: list[TrainedRange], loads: list[tuple[float, ...]]
) -> list[PropertyResult]:
    """Sum up the work of the audit's closed cycles under loads [N.m] by joint."""
    joint_cycles: list[list[audit.Cycle]] = [[] for _ in trained_ranges]
    for frequency in audit.FREQUENCIES:
        motions = [
            audit.closed_motions(
                trained_range, np.multiply(audit.AMPLITUDES, trained_range.speed), frequency
            )
            for trained_range in trained_ranges
        ]
        for load_index in range(max(map(len, loads))):
            held_loads = np.array(
                [joint_loads[min(load_index, len(joint_loads) - 1)] for joint_loads in loads]
            )
            dq, q = (
                np.column_stack([getattr(motion, field_name).ravel() for motion in motions])
                for field_name in ("dq", "q")
            )
            bench.start(load=held_loads, exact=False, dq=dq[0])
            tau = bench.move(np.full(len(dq) - 1, trained_ranges[0].sample_time), dq[1:], q[1:])
            tau = np.concatenate([tau[:1], tau]).reshape(*motions[0].dq.shape, -1)
            for j, motion in enumerate(motions):
                joint_cycles[j] += audit.measure_cycles(motion, float(held_loads[j]), tau[:, :, j])
    if any(len(joint_loads) > 1 for joint_loads in loads):
        for j, loaded_cycles in enumerate(_run_moving_loads(bench, trained_ranges)):
            joint_cycles[j] += loaded_cycles if len(loads[j]) > 1 else []
    return [_judge_work(cycles) for cycles in joint_cycles]


def _run_moving_loads(
    bench: FrictionBench, trained_ranges: list[TrainedRange]
) -> list[list[audit.Cycle]]:
    joint_cycles: list[list[audit.Cycle]] = [[] for _ in trained_ranges]
    joint_motions = (
        loaded_motions(trained_range, _ANGLES, _PHASES, _LOADED_PERIOD_COUNT)
        for trained_range in trained_ranges
    )
    for motions in zip(*joint_motions, strict=True):
        dq, q, tau_load = (
            np.column_stack([getattr(motion, field_name) for motion in motions])
            for field_name in ("dq", "q", "load")
        )
        bench.start(load=tau_load[0], exact=False, dq=dq[0])
        tau = bench.move(np.full(len(dq), trained_ranges[0].sample_time), dq, q, tau_load)
        for j, motion in enumerate(motions):
            rows = slice(-motion.rows, None)
            power = np.abs(tau[rows, j] * motion.dq[rows]).sum() * trained_ranges[0].sample_time
            generated = motion.compute_generated_energy(tau[:, j])
            joint_cycles[j].append(
                audit.Cycle(
                    amplitude=motion.cycle.amplitude,
                    frequency=motion.cycle.frequency,
                    tau_load=motion.cycle.mean,
                    swing=motion.cycle.swing,
                    work=-generated if generated else 0.0,
                    share=-generated / power if generated else 1.0,
                )
            )
    return joint_cycles


def _judge_work(cycles: list[audit.Cycle]) -> PropertyResult:
    worst_cycle = min(cycles, key=lambda cycle: cycle.work)
    generated = max(0.0, -worst_cycle.work)
    least_dissipative = min(cycles, key=lambda cycle: cycle.share)
    is_generating = generated > ENERGY_ROUND_OFF
    swing_text = (
        f" while the load swings by {worst_cycle.swing:.3g} N.m" if worst_cycle.swing else ""
    )
    sentence = f"A cycle at {worst_cycle.frequency:.2g} Hz generates {generated:.3g} J{swing_text}."
    curves = []
    for frequency in sorted({cycle.frequency for cycle in cycles if not cycle.swing})[::2]:
        smallest_share: dict[float, float] = {}
        for cycle in cycles:
            if cycle.frequency == frequency and not cycle.swing:
                smallest_share[cycle.amplitude] = min(
                    smallest_share.get(cycle.amplitude, 1.0), cycle.share
                )
        x, y = (
            np.array(coordinates)
            for coordinates in zip(*sorted(smallest_share.items()), strict=True)
        )
        curves.append(curve(f"{frequency:.2g} Hz", x, y))
    return judge(
        ("most energy given in a cycle", generated, "J"),
        ("amplitude of that cycle", worst_cycle.amplitude if is_generating else None, "rad/s"),
        ("smallest dissipated share of the work", least_dissipative.share, "1"),
        ("at an amplitude of", least_dissipative.amplitude, "rad/s"),
        ("at a frequency of", least_dissipative.frequency, "Hz"),
        faults=[sentence] if is_generating else [],
        plot=plot("amplitude", "work taken, share", *curves),
    )
