"""Sliding and rest without a plant: coupling, first torque, lag, chatter, work over cycles."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr.extras.properties.scale import SLIDING, Scale, curve, figures, judge, plot
from hesr_model.audit import audit
from hesr_model.audit.attack import LoadedMotion, loaded_motions
from hesr_model.audit.properties import (
    ENERGY_ROUND_OFF,
    MAX_CHATTER,
    MAX_START_ERROR,
    MIN_LAG_WIDTH,
    MIN_USEFUL_STEP,
    Curve,
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
    has_chattered = np.zeros(bench.joints, dtype=bool)
    for dt in _COARSE_STEPS.tolist():
        dq = slide(dt)
        if not chatter_by_step:
            has_stopped = np.abs(dq[-1]) <= _STOP_SHARE * np.abs(dq[0])
        chatter_by_step[dt] = _find_chatter(dq)
        has_chattered |= chatter_by_step[dt]
        if has_chattered.all():
            break
    slopes = _measure_rest_slope(bench, scale)
    is_driven = ~has_stopped & scale.is_driving
    dq = slide(max(MIN_USEFUL_STEP, MIN_STEP))[: int(0.2 / MIN_USEFUL_STEP)]
    t = MIN_USEFUL_STEP * np.arange(len(dq), dtype=float)
    results = []
    for j in range(bench.joints):
        first_chattering = next((dt for dt in chatter_by_step if chatter_by_step[dt][j]), None)
        largest_step = _find_largest_step(slide, j, list(chatter_by_step), first_chattering)
        verdict, reason = _judge_largest_step(largest_step, is_driven=bool(is_driven[j]))
        if is_driven[j]:
            largest_step = None
        slope = float(slopes[j])
        predicted_step = None
        if slope > 0.0:
            predicted_step = 2.0 * float(inertia[j]) / slope
        velocity_curve = curve("at 1 ms", t, np.nan_to_num(dq[:, j]), max_points=200)
        property_result = PropertyResult(
            verdict=verdict,
            figures=figures(
                ("largest step without chatter", largest_step, "s"),
                ("2 J / slope at rest", predicted_step, "s"),
                ("slope at rest", slope, "N.m.s/rad"),
            ),
            reason=reason,
            plot=plot("time", "velocity", velocity_curve),
        )
        results.append(property_result)
    return results


def _measure_rest_slope(bench: FrictionBench, scale: Scale) -> Array:
    """Return the slope (n,) [N.m.s/rad] of the torque over velocity at rest, states fixed."""
    small_speed = np.full(bench.joints, _SMALL_SPEED)
    forward_torque = bench.start(load=scale.load, dq=small_speed, unmoved=True)
    backward_torque = bench.start(load=scale.load, dq=-small_speed, unmoved=True)
    # The slope of a jump is huge.
    return (forward_torque - backward_torque) / (2.0 * _SMALL_SPEED)


def _judge_largest_step(
    largest_step: float | None, *, is_driven: bool
) -> tuple[PropertyVerdict, str]:
    """Return verdict and reason for the largest step [s] without chatter, None if there is none."""
    if is_driven:
        return "not applicable", "The joint does not stop at any step: the law drives it."
    if largest_step is None:
        return "fail", f"It chatters even at the smallest step tried, {1e3 * MIN_STEP:g} ms."
    if largest_step < MIN_USEFUL_STEP:
        return "fail", "Coupled explicitly at 1 ms it chatters."
    if largest_step == MAX_STEP:
        return "pass", "No chatter up to the largest step tried."
    return "pass", ""


def _slide(bench: FrictionBench, scale: Scale, inertia: Array, dt: float) -> Array:
    """Return the velocity (K, n) of joints that slide to a stop; NaN after a failure."""
    first_speed = SLIDING * scale.speed
    momentum = inertia * first_speed
    # A level of almost zero would never stop the joint; the run time is bounded anyway.
    stopping_time = float(np.max(momentum / np.maximum(scale.level, 1e-6 * inertia * first_speed)))
    run_time = min(_STOPPING_TIMES * stopping_time, _MAX_RUN_TIME)
    step_count = max(_MIN_STEP_COUNT, int(np.ceil(run_time / dt)))
    velocity = first_speed
    dq = np.full((step_count + 1, bench.joints), np.nan)
    dq[0] = velocity
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
    first_torques = []
    steady_torques = []
    for speed in _START_SPEEDS[:, None] * scale.speed:
        for dq in (speed, -speed):
            first_torques.append(bench.start(load=scale.load, dq=dq))
            sliding_torques = bench.move(dt, np.broadcast_to(dq, (2, len(dq))))
            steady_torques.append(sliding_torques[-1])
    shape = (len(_START_SPEEDS), 2, bench.joints)  # speeds, directions, joints
    first_torque = np.reshape(first_torques, shape)
    steady_torque = np.reshape(steady_torques, shape)
    return [
        _judge_start(scale.speed[j] * _START_SPEEDS, first_torque[..., j], steady_torque[..., j])
        for j in range(bench.joints)
    ]


def _judge_start(speeds: Array, first_torque: Array, steady_torque: Array) -> PropertyResult:
    """Judge (S, 2) first and steady torques at speeds (S,), forward and backward."""
    # Half the difference of both directions, free of the offset.
    friction = np.maximum(0.5 * np.abs(steady_torque[:, 0] - steady_torque[:, 1]), _MIN_FRICTION)
    relative_error = (first_torque - steady_torque) / friction[:, None]
    row, direction = np.unravel_index(int(np.argmax(np.abs(relative_error))), relative_error.shape)
    worst_error = float(relative_error[row, direction])
    velocity = float(speeds[row])
    if direction == 1:
        velocity = -velocity
    faults = []
    if not abs(worst_error) <= MAX_START_ERROR:  # NaN fails
        faults.append(f"At {velocity:.3g} rad/s the first torque is off by {worst_error:.0%}.")
    return judge(
        ("largest difference of the first torque, of the friction", abs(worst_error), "1"),
        ("at a velocity of", velocity, "rad/s"),
        faults=faults,
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
        tau = bench.move(np.full(len(dq), period / _ROWS_PER_PERIOD), dq)
        torques.append(tau[-_ROWS_PER_PERIOD:])
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
    if abs(width) > _ROUNDING:
        return width, row
    return 0.0, row


def _judge_lag(dq: Array, fast: Array, slow: Array, level: float) -> PropertyResult:
    """Judge the torques (K,) of one period at speeds `dq` (K,), fast and slow."""
    width, row = _measure_loop_width(fast)
    slow_width, _ = _measure_loop_width(slow)
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
    velocities = []
    positions = []
    for trained_range in trained_ranges:
        joint_dq, joint_q, settling = audit.encoder_noise(trained_range)
        velocities.append(joint_dq)
        positions.append(joint_q)
    dq = np.column_stack(velocities)
    q = np.column_stack(positions)
    sample_time = trained_ranges[0].sample_time
    bench.start(load=scale.load, exact=False)
    tau = bench.move(np.full(len(dq), sample_time), dq, q)
    t = sample_time * np.arange(_PLOTTED_ROWS, dtype=float)
    results = []
    for j, level in enumerate(scale.level.tolist()):
        joint_tau = tau[settling:, j]
        deviation = float(np.std(joint_tau))
        faults = []
        if deviation > MAX_CHATTER * level:
            faults.append(f"That is {deviation / level:.0%} of the friction level.")
        torque_curve = curve("at rest", t, joint_tau[:_PLOTTED_ROWS], max_points=150)
        property_result = judge(
            ("standard deviation of the torque", deviation, "N.m"),
            faults=faults,
            plot=plot("time", "torque", torque_curve),
        )
        results.append(property_result)
    return results


def work(
    bench: FrictionBench, trained_ranges: list[TrainedRange], loads: list[tuple[float, ...]]
) -> list[PropertyResult]:
    """Sum up the work of the audit's closed cycles under loads [N.m] by joint."""
    joint_cycles: list[list[audit.Cycle]] = [[] for _ in trained_ranges]
    for frequency in audit.FREQUENCIES:
        for load_index in range(max(map(len, loads))):
            # A joint with fewer loads than others repeats its last one.
            held_loads = [
                float(joint_loads[min(load_index, len(joint_loads) - 1)]) for joint_loads in loads
            ]
            held_cycles = _run_held_loads(bench, trained_ranges, frequency, held_loads)
            _append_cycles(joint_cycles, held_cycles)
    if any(len(joint_loads) > 1 for joint_loads in loads):
        loaded_cycles = _run_moving_loads(bench, trained_ranges)
        for j, joint_loads in enumerate(loads):
            if len(joint_loads) == 1:  # the law does not depend on the load
                loaded_cycles[j] = []
        _append_cycles(joint_cycles, loaded_cycles)
    return [_judge_work(cycles) for cycles in joint_cycles]


def _append_cycles(
    joint_cycles: list[list[audit.Cycle]], further_cycles: list[list[audit.Cycle]]
) -> None:
    for cycles, further in zip(joint_cycles, further_cycles, strict=True):
        cycles += further


def _run_held_loads(
    bench: FrictionBench,
    trained_ranges: list[TrainedRange],
    frequency: float,
    held_loads: list[float],
) -> list[list[audit.Cycle]]:
    """Run cycles of all amplitudes at a frequency [Hz] under constant loads [N.m] by joint."""
    motions = []
    for trained_range in trained_ranges:
        amplitudes = np.multiply(audit.AMPLITUDES, trained_range.speed)
        motions.append(audit.closed_motions(trained_range, amplitudes, frequency))
    dq = np.column_stack([motion.dq.ravel() for motion in motions])
    q = np.column_stack([motion.q.ravel() for motion in motions])
    bench.start(load=np.array(held_loads), exact=False, dq=dq[0])
    tau = bench.move(np.full(len(dq) - 1, trained_ranges[0].sample_time), dq[1:], q[1:])
    tau = np.concatenate([tau[:1], tau]).reshape(*motions[0].dq.shape, -1)
    return [
        list(audit.measure_cycles(motion, held_loads[j], tau[:, :, j]))
        for j, motion in enumerate(motions)
    ]


def _run_moving_loads(
    bench: FrictionBench, trained_ranges: list[TrainedRange]
) -> list[list[audit.Cycle]]:
    """Run small cycles of all joints while their loads move at twice the rate."""
    sample_time = trained_ranges[0].sample_time
    joint_cycles: list[list[audit.Cycle]] = [[] for _ in trained_ranges]
    joint_motions = (
        loaded_motions(trained_range, _ANGLES, _PHASES, _LOADED_PERIOD_COUNT)
        for trained_range in trained_ranges
    )
    for motions in zip(*joint_motions, strict=True):
        dq = np.column_stack([motion.dq for motion in motions])
        q = np.column_stack([motion.q for motion in motions])
        tau_load = np.column_stack([motion.load for motion in motions])
        bench.start(load=tau_load[0], exact=False, dq=dq[0])
        tau = bench.move(np.full(len(dq), sample_time), dq, q, tau_load)
        for j, motion in enumerate(motions):
            joint_cycles[j].append(_measure_loaded_cycle(motion, tau[:, j], sample_time))
    return joint_cycles


def _measure_loaded_cycle(motion: LoadedMotion, tau: Array, sample_time: float) -> audit.Cycle:
    """Measure work and its dissipated share in the last cycle of a motion of one joint."""
    work = 0.0
    share = 1.0
    generated = motion.compute_generated_energy(tau)
    if generated:
        rows = slice(-motion.rows, None)
        power = np.abs(tau[rows] * motion.dq[rows]).sum() * sample_time
        work = -generated
        share = -generated / power
    return audit.Cycle(
        amplitude=motion.cycle.amplitude,
        frequency=motion.cycle.frequency,
        tau_load=motion.cycle.mean,
        swing=motion.cycle.swing,
        work=work,
        share=share,
    )


def _judge_work(cycles: list[audit.Cycle]) -> PropertyResult:
    """Judge all cycles of one joint by the one that generates most energy."""
    worst_cycle = min(cycles, key=lambda cycle: cycle.work)
    least_dissipative = min(cycles, key=lambda cycle: cycle.share)
    generated = max(0.0, -worst_cycle.work)
    generating_amplitude = None
    faults = []
    if generated > ENERGY_ROUND_OFF:
        generating_amplitude = worst_cycle.amplitude
        faults.append(_describe_generation(worst_cycle, generated))
    held_cycles = [cycle for cycle in cycles if not cycle.swing]
    frequencies = sorted({cycle.frequency for cycle in held_cycles})
    return judge(
        ("most energy given in a cycle", generated, "J"),
        ("amplitude of that cycle", generating_amplitude, "rad/s"),
        ("smallest dissipated share of the work", least_dissipative.share, "1"),
        ("at an amplitude of", least_dissipative.amplitude, "rad/s"),
        ("at a frequency of", least_dissipative.frequency, "Hz"),
        faults=faults,
        plot=plot(
            "amplitude",
            "work taken, share",
            *(_plot_smallest_shares(held_cycles, frequency) for frequency in frequencies[::2]),
        ),
    )


def _describe_generation(cycle: audit.Cycle, generated: float) -> str:
    sentence = f"A cycle at {cycle.frequency:.2g} Hz generates {generated:.3g} J"
    if cycle.swing:
        sentence += f" while the load swings by {cycle.swing:.3g} N.m"
    return f"{sentence}."


def _plot_smallest_shares(cycles: list[audit.Cycle], frequency: float) -> Curve:
    """Return the smallest dissipated share, at most 1, over the amplitude of one frequency."""
    smallest_shares: dict[float, float] = {}
    for cycle in cycles:
        if cycle.frequency == frequency:
            smallest_share = smallest_shares.get(cycle.amplitude, 1.0)
            smallest_shares[cycle.amplitude] = min(smallest_share, cycle.share)
    amplitudes = sorted(smallest_shares)
    shares = [smallest_shares[amplitude] for amplitude in amplitudes]
    return curve(f"{frequency:.2g} Hz", np.array(amplitudes), np.array(shares))
