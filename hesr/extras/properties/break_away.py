"""Experiments driven by torque: break-away, holding a load, stick-slip, dissipation."""

from itertools import product
from typing import NamedTuple

import numpy as np

from hesr.extras.properties.bench import DriveBench
from hesr.extras.properties.scale import CREEP, Scale, curve, figures, judge, plot
from hesr_model.audit.properties import (
    ENERGY_ROUND_OFF,
    MAX_DRIFT,
    MIN_BREAKAWAY_FALL,
    MIN_WEAKENING,
    PropertyResult,
)
from hesr_model.support.arrays import Array

AMPLITUDES = (0.02, 0.5, 2.0)  # in friction levels: pre-sliding, half the level, sliding
_TORQUE_FREQUENCY = 1.0  # [Hz] of the torque; the load has twice as much
PHASES = (0.5 * np.pi, 1.5 * np.pi)  # load phase [rad]
_INNER_STEP = 4e-3  # [s] communication and inner step: rows contain all work
_ROWS_PER_CYCLE = round(1.0 / (_TORQUE_FREQUENCY * _INNER_STEP))
_CYCLE_COUNT = 10
_MEASURED_CYCLES = 4
_SPRING_STRETCH = 20.0  # stretch at the friction level, in deflections


def dissipation(
    bench: DriveBench, scale: Scale, peaks: Array, is_loaded: Array
) -> list[PropertyResult]:
    """Drive spring-held joints back and forth and sum up the work of their friction.

    The torque is one tone of 1 Hz; the motion has more, since friction is not linear. Velocities of
    one to three tones are tried by the search of the certificate (`hesr_model.audit.tones`).
    The load of `is_loaded` (n,) laws moves between 0 and `peaks` (n,) [N.m].
    """
    angle = 2.0 * np.pi / _ROWS_PER_CYCLE * np.arange(1, _ROWS_PER_CYCLE * _CYCLE_COUNT + 1)
    dt = np.full(len(angle), _INNER_STEP)
    phases = PHASES if is_loaded.any() else PHASES[:1]
    worst_cycles = [_DrivenCycle(-np.inf, 0.0, np.empty(0), np.empty(0))] * bench.joints
    for share, phase in product(AMPLITUDES, phases):
        load = 0.5 * peaks * (1.0 + np.cos(2.0 * angle + phase))[:, None]
        load = np.where(is_loaded, load, scale.load)
        torque = scale.offset + share * np.sin(angle)[:, None] * scale.level
        bench.start(
            load=load[-1],
            torque=scale.offset,
            stiffness=scale.level / (_SPRING_STRETCH * scale.deflection),
            substep=_INNER_STEP,
        )
        signals = bench.run(dt, torque=torque, load=load)
        q, dq, tau = signals[:, -_MEASURED_CYCLES * _ROWS_PER_CYCLE :]
        # An offset does no work over a closed cycle.
        generated = -((tau - scale.offset) * dq).sum(axis=0) * _INNER_STEP / _MEASURED_CYCLES
        generated = np.where(np.isfinite(generated), generated, np.inf)
        for j in np.flatnonzero(generated > [cycle.generated for cycle in worst_cycles]):
            displacement = q[-_ROWS_PER_CYCLE:, j] - bench.positions[j]
            last_tau = tau[-_ROWS_PER_CYCLE:, j]
            worst_cycles[j] = _DrivenCycle(float(generated[j]), share, displacement, last_tau)
    return [_judge_dissipation(cycle) for cycle in worst_cycles]


class _DrivenCycle(NamedTuple):
    """Last cycle (K,) of a joint that is driven back and forth."""

    generated: float  # energy [J]
    share: float  # amplitude of the torque in friction levels
    displacement: Array  # [rad]
    tau: Array  # [N.m]


def _judge_dissipation(cycle: _DrivenCycle) -> PropertyResult:
    faults = []
    if cycle.generated > ENERGY_ROUND_OFF:
        faults.append(
            f"Under a sine of torque of {cycle.share:g} levels it generates "
            f"{cycle.generated:.3g} J per cycle."
        )
    loop = curve("", 1e3 * cycle.displacement, cycle.tau, closed=True)
    return judge(
        ("most energy given in a cycle", max(0.0, cycle.generated), "J"),
        ("amplitude of the torque, of the level", cycle.share, "1"),
        faults=faults,
        plot=plot("position", "torque", loop),
    )


STRETCH = 0.2  # at the friction level, in lengths of the scale
_STRETCHING_TIMES = 6.0  # run time in stretching times
_TIME_STEP = 1e-2  # [s]
_MAX_SPEED_SHARE = 0.2  # end of the examined curve, in trained speeds
_MAX_FLAT_FALL = 1e-3  # fall in levels; up to WEAKENING both outcomes are right
_MAX_STICKING_SPEED = 0.1  # over the pulling speed
_MIN_SLIPPING_SPEED = 1.5  # over the pulling speed
_MIN_AMPLITUDE_RATIO = 0.8  # ratio of the last two quarters' amplitudes


def stick_slip(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Pull the joints by springs at the speed where their steady curve falls most."""
    steepest_falls = [_find_steepest_fall(scale, j) for j in range(bench.joints)]
    pulling_speeds = np.array([speed for speed, _ in steepest_falls])
    level_stretch = STRETCH * scale.length
    seconds = _STRETCHING_TIMES * float(np.max(level_stretch / pulling_speeds))
    bench.start(load=scale.load, torque=scale.offset, stiffness=scale.level / level_stretch)
    rows = int(np.ceil(seconds / _TIME_STEP))
    ahead = 0.5 * level_stretch
    t = _TIME_STEP * np.arange(1, rows + 1, dtype=float)
    link_position = bench.positions + ahead + pulling_speeds * t[:, None]
    q, dq, _ = bench.run(np.full(rows, _TIME_STEP), link=link_position)
    stretch = link_position - q
    return [
        _judge_stick_slip(t, stretch[:, j], dq[:, j], speed, fall, bool(scale.is_driving[j]))
        for j, (speed, fall) in enumerate(steepest_falls)
    ]


def _find_steepest_fall(scale: Scale, j: int) -> tuple[float, float]:
    """Return the speed of steepest fall of the steady curve [rad/s] and its fall."""
    speeds = scale.speed[j] * np.geomspace(CREEP, _MAX_SPEED_SHARE, 100)
    tau = np.interp(speeds, scale.speeds[:, j], scale.steady[:, j])
    fall = np.max(np.maximum.accumulate(tau) - tau) / scale.level[j]
    slope = np.gradient(tau, speeds)
    steepest_row = int(np.argmin(slope))
    if not slope[steepest_row] < 0.0:  # it falls nowhere, or has no slope: pull slowly
        steepest_row = 0
    return float(speeds[steepest_row]), float(fall)


def _judge_stick_slip(
    t: Array, stretch: Array, dq: Array, pulling_speed: float, fall: float, is_driving: bool
) -> PropertyResult:
    half = len(t) // 2
    quarter = 3 * len(t) // 4
    third_swing = float(np.ptp(stretch[half:quarter]))
    last_swing = float(np.ptp(stretch[quarter:]))
    slowest = float(np.min(dq[half:]))
    fastest = float(np.max(dq[half:]))
    is_cycling = (
        slowest < _MAX_STICKING_SPEED * pulling_speed
        and fastest > _MIN_SLIPPING_SPEED * pulling_speed
        and last_swing >= _MIN_AMPLITUDE_RATIO * third_swing
    )
    is_slipping = (dq[half:-1] <= pulling_speed) & (dq[half + 1 :] > pulling_speed)
    slip_times = t[half + 1 :][is_slipping]
    period = None
    if is_cycling and len(slip_times) > 1:
        period = float(np.mean(np.diff(slip_times)))
    is_weakening = fall >= MIN_WEAKENING
    is_flat = fall <= _MAX_FLAT_FALL
    amplitude = 0.0
    outcome = "It ends in steady sliding"
    if is_cycling:
        amplitude = 0.5 * last_swing
        outcome = (
            f"It cycles between {slowest / pulling_speed:.2g} and "
            f"{fastest / pulling_speed:.2g} times the pulling speed"
        )
    if is_driving:
        passes = False
        reason = "its steady friction acts in the direction of motion at low speed"
    elif is_weakening or is_flat:
        passes = is_cycling == is_weakening
        reason = f"its steady curve falls by {fall:.1%} of the level"
    else:
        passes = True
        reason = f"its steady curve falls by only {fall:.1%}, so both are allowed"
    return PropertyResult(
        verdict="pass" if passes else "fail",
        figures=figures(
            ("amplitude of the limit cycle", amplitude, "rad"),
            ("period of the limit cycle", period, "s"),
            ("pulling speed", pulling_speed, "rad/s"),
            ("fall of the steady curve, of the level", fall, "1"),
        ),
        reason=f"{outcome}; {reason}.",
        plot=plot("time", "stretch", curve("", t, 1e3 * stretch, max_points=160)),
    )


RAMPS = (10.0, 3.0, 1.0, 0.3)  # [s] up to the friction level
LOAD = 0.5  # held load in friction levels
DITHER = 0.2  # amplitude in friction levels
FREQUENCY = 5.0  # of the dither [Hz]
MINUTE = 60.0

_SLIDING_SPEED = 0.05  # sliding threshold in trained speeds
_MAX_RAMP_LEVEL = 3.0  # end of a ramp, in friction levels
_RAMP_STEPS = 1000  # up to the friction level
_MIN_SHOWN_FALL = 1e-3  # less would print as 0.0 % or be noise
_MAX_CREEP_RATIO = 2.0  # ratio of displacements on ramps of different rate; pre-sliding has 1
_LOADING_TIME = 1.0  # [s] of the rise of a load
_SETTLING_TIME = 1.0  # [s] of rest after it
_STEPS_PER_PERIOD = 20  # of the dither


def breakaway(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Raise the torque from rest at several rates until the joints slide."""
    peaks, displacements = np.swapaxes(
        [_run_ramp(bench, scale, ramp_time) for ramp_time in RAMPS], 0, 1
    )
    return [
        _judge_break_away(peaks[:, j], displacements[:, j], float(scale.level[j]))
        for j in range(bench.joints)
    ]


def _run_ramp(bench: DriveBench, scale: Scale, seconds: float) -> tuple[Array, Array]:
    """Return peak friction before sliding (n,) [N.m] and displacement at half of it (n,) [rad].

    Both are NaN for a joint that does not slide.
    """
    bench.start(load=scale.load, torque=scale.offset)
    dt = seconds / _RAMP_STEPS
    sliding_speed = _SLIDING_SPEED * scale.speed
    rows: list[Array] = []
    is_sliding = np.zeros(bench.joints, dtype=bool)
    for step in range(1, int(_MAX_RAMP_LEVEL * _RAMP_STEPS) + 1):
        # Release sliding joints before they run away.
        bench.torque[:] = scale.offset + np.where(is_sliding, 0.0, step / _RAMP_STEPS * scale.level)
        outputs = bench.step(dt).copy()
        outputs[:, is_sliding] = np.nan
        rows.append(outputs)
        is_sliding |= np.abs(outputs[1]) > sliding_speed
        if is_sliding.all():
            break
    q, _, tau = np.swapaxes(rows, 0, 1)
    friction = tau - scale.offset
    peak, displacement = np.full((2, bench.joints), np.nan)
    for j in np.flatnonzero(is_sliding):
        is_valid = ~np.isnan(q[:, j])
        peak[j] = friction[is_valid, j].max()
        half_row = int(np.argmax(friction[is_valid, j] >= 0.5 * peak[j]))
        displacement[j] = abs(q[half_row, j] - bench.positions[j])
    return peak, displacement


def _judge_break_away(peaks: Array, displacements: Array, level: float) -> PropertyResult:
    if np.isnan(peaks).any():
        return judge(
            ("fall of the break-away torque", None, "1"),
            faults=[
                f"The joint does not slide below {_MAX_RAMP_LEVEL:g} times its friction level."
            ],
        )
    fall = 0.0
    if peaks[0] > 0.0:
        fall = float((peaks[0] - peaks[-1]) / peaks[0])
    faults = []
    if peaks[0] <= 0.0:
        faults.append("No break-away: the law drives the joint.")
    elif displacements[0] > _MAX_CREEP_RATIO * displacements[1]:
        faults.append(
            "No break-away: the joint creeps, by half the torque "
            f"{displacements[0] / displacements[1]:.2g} times as far on the slowest ramp as on "
            "the next."
        )
    if peaks[0] > 0.0 and fall < MIN_BREAKAWAY_FALL:
        if fall > _MIN_SHOWN_FALL:
            faults.append(f"The break-away torque falls by only {fall:.1%}.")
        else:
            faults.append("The break-away torque does not fall with the rate.")
    peak_curve = curve("", np.log10(level / np.array(RAMPS)), peaks)
    return judge(
        ("fall of the break-away torque", fall, "1"),
        ("break-away torque on the slowest ramp", float(peaks[0]), "N.m"),
        ("break-away torque on the fastest ramp", float(peaks[-1]), "N.m"),
        faults=faults,
        plot=plot("log10 rate", "break-away", peak_curve),
    )


def hold(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Hold a constant load for a minute, also as load input of the law."""
    load = LOAD * scale.level
    bench.start(load=load, torque=scale.offset)
    _apply_load(bench, scale, load)
    dt = np.full(600, MINUTE / 600)
    t = np.concatenate([[0.0], np.cumsum(dt[1:])])
    q, _, _ = bench.run(dt)
    return _judge_drift(t, q)


def dither(bench: DriveBench, scale: Scale) -> list[PropertyResult]:
    """Hold a constant load plus a small oscillating one for a minute."""
    load = LOAD * scale.holding_torque
    bench.start(load=scale.load, torque=scale.offset)
    _apply_load(bench, scale, load)
    step_count = round((MINUTE + _SETTLING_TIME) * FREQUENCY * _STEPS_PER_PERIOD)
    dt = np.full(step_count, 1.0 / (FREQUENCY * _STEPS_PER_PERIOD))
    wave = np.sin(2.0 * np.pi / _STEPS_PER_PERIOD * (np.arange(step_count) + 0.5))
    torque = scale.offset + load + DITHER * wave[:, None] * scale.holding_torque
    q, _, _ = bench.run(dt, torque=torque)
    # The mean of each period hides the oscillation.
    mean_position = q.reshape(-1, _STEPS_PER_PERIOD, bench.joints).mean(axis=1)
    mean_position = mean_position[round(_SETTLING_TIME * FREQUENCY) :]
    return _judge_drift(np.arange(len(mean_position)) / FREQUENCY, mean_position)


def _apply_load(bench: DriveBench, scale: Scale, load: Array) -> None:
    step_count = 100
    rise = 0.5 - 0.5 * np.cos(np.pi / step_count * np.arange(1, step_count + 1))
    bench.run(
        np.full(step_count, _LOADING_TIME / step_count), torque=scale.offset + rise[:, None] * load
    )
    bench.step(_SETTLING_TIME)


def _judge_drift(t: Array, q: Array) -> list[PropertyResult]:
    results = []
    half = len(t) // 2
    for joint_q in q.T:
        drift = float(joint_q[-1] - joint_q[0])
        if not np.isfinite(drift):
            runaway = judge(("drift in a minute", None, "rad"), faults=["The joint runs away."])
            results.append(runaway)
            continue
        drift_rate = float(np.diff(joint_q[half:]).sum() / (t[-1] - t[half]))
        faults = []
        if abs(drift) > MAX_DRIFT:
            faults.append("It creeps.")
        drift_curve = curve("", t, 1e3 * (joint_q - joint_q[0]), max_points=60)
        property_result = judge(
            ("drift in a minute", drift, "rad"),
            ("rate of the second half", drift_rate, "rad/s"),
            faults=faults,
            plot=plot("time", "moved", drift_curve),
        )
        results.append(property_result)
    return results
