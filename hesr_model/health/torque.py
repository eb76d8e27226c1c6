"""Torque checks: raw signal, and signs and scales against motion and model."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hesr_model.equations.recurrence import recurrence
from hesr_model.health.evidence import (
    ModelTorques,
    SmoothPart,
    TorqueFit,
    estimate_white_noise,
    fit_joint_torque,
    friction_shape,
)
from hesr_model.health.positions import is_mirrored
from hesr_model.health.referee import (
    CURE_GAIN,
    MATERIAL_GAIN,
    Estimate,
    Hypothesis,
    LeftOutRows,
    Race,
    Statistic,
)
from hesr_model.logs.rest import find_resting_speeds, moves_both_ways
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Mask
from hesr_model.units import reverse_unit, unit_of_joint

_MAX_SCALE = 3.0  # plausible factor of gravity; real arms have 0.6 to 1.5
_MAX_REAL_SCALE = 1.6  # of gravity once its unit is right, or its inverse
_HUGE_SCALE = 10.0  # factor of a gravity that the model has hardly any of
_MIN_R2 = 0.8  # minimum R^2 for a scale estimate
NO_SIGNAL_R2 = 0.35  # R^2 below which nothing is explained
_DEFLECTION_SHARES = (0.03, 0.1, 0.3)  # of the travel, after which friction slides
_MAX_COMPUTED_RESIDUAL = 0.1  # residual share of computed torques
_MAX_WEIGHTLESS_SHARE = 0.1  # share of the model's gravity in weightless torques
_MAX_PEAK_TO_LIMIT = 10.0
_MIN_RATIO_TO_OTHERS = 30.0  # peak over the model's limit, others over own
_SIGNIFICANCE = 5.0  # standard errors that choose between gravity and inertia as a measure
_TELLING_MOTION = "motion that reverses, at several speeds"
_MASS_ROWS = 40  # at which mass matrices are evaluated
_MIN_RELIABILITY = 0.1  # share of an inertial torque that is no noise, below which nothing is told
TorqueFits = Mapping[int, TorqueFit]  # by index of the joint


def fit_joint_torques(part: SmoothPart, torques: ModelTorques) -> TorqueFits:
    """Regress the torque of every moving joint."""
    fits: dict[int, TorqueFit] = {}
    for j in np.flatnonzero(part.is_moving & (np.ptp(part.tau, axis=0) > 0.0)):
        fits[int(j)] = fit_joint_torque(
            part.tau[:, j], torques.gravity[:, j], torques.inertial[:, j], part.v[:, j]
        )
    return fits


@dataclass(frozen=True, eq=False)
class Explanations:
    """What may explain the torque of a joint along a part of a log, free of charge.

    Attributes
    ----------
    part : rows of a log at the side that the log measures.
    torques : of the model.
    j : index of the joint.
    left_out : folds of the rows.
    """

    part: SmoothPart
    torques: ModelTorques
    j: int
    left_out: LeftOutRows

    @property
    def tau(self) -> Array:
        """The torque (N,)."""
        return self.part.tau[:, self.j]

    @property
    def gravity(self) -> Array:
        """The model's gravity (N,), without its mean."""
        return self.torques.gravity[:, self.j]

    @property
    def inertial(self) -> Array:
        """The model's torque (N,) of acceleration."""
        return self.torques.inertial[:, self.j]

    @cached_property
    def friction(self) -> Array:
        """Coulomb and viscous friction and an offset (N, 3)."""
        v = self.part.v[:, self.j]
        return np.column_stack([friction_shape(v), v, np.ones_like(v)])

    @cached_property
    def friction_with_memory(self) -> tuple[Array, ...]:
        """Friction that slides after deflections of several sizes, each (N, 4)."""
        v = self.part.v[:, self.j]
        q = self.part.q[:, self.j]
        travel = max(float(np.ptp(q)), 1e-300)
        distances = np.abs(v) * np.diff(self.part.t, prepend=self.part.t[0])
        alternatives = []
        for share in _DEFLECTION_SHARES:
            # x' = v / w - |v| x / w, exactly for speeds held over a step.
            decay = np.exp(-distances / (share * travel))
            deflection = recurrence(decay, (1.0 - decay) * np.sign(v), 0.0)
            position = (q - q.mean()) / travel
            alternatives.append(np.column_stack([deflection, v, position, np.ones_like(v)]))
        return tuple(alternatives)

    def predict(self, target: Array, *columns: Array, non_negative: int = 0) -> Array:
        """Return the squared errors (N,) of predictions of a target on left-out rows."""
        table = np.column_stack(columns)
        return self.left_out.predict(table, target, non_negative=non_negative) ** 2

    def race_signs(self, rival: str, column: Array, *others: Array, non_negative: int) -> Race:
        """Return the race of the opposite sign of a column against its own, the rival.

        The first `non_negative` columns, this one included, have no negative factor.
        """
        return Race(
            rival=rival,
            rival_squares=self.predict(self.tau, column, *others, non_negative=non_negative),
            squares=self.predict(self.tau, -column, *others, non_negative=non_negative),
        )

    def race_torque_signs(self) -> Race:
        """Return the race of a reversed torque against the torque, under gravity as stated.

        Friction brakes, and the inertia is free. In free swing gravity and inertia cancel, so that
        a torque that brakes the swing looks reversed if gravity may be left out.
        """
        non_negative = 3  # of inertia and both shapes of friction, but not of the offset
        others = (self.inertial, self.friction)
        return Race(
            rival="the torque as it is, with the model's gravity",
            rival_squares=self.predict(self.tau - self.gravity, *others, non_negative=non_negative),
            squares=self.predict(-self.tau - self.gravity, *others, non_negative=non_negative),
        )

    def estimate_spread(self, kind: int) -> float:
        """Return half the range of a scale over free shapes of friction.

        Parameters
        ----------
        kind : 0 for that of gravity, 1 for that of inertia.
        """
        scales = []
        for friction in (self.friction, *self.friction_with_memory):
            columns = np.column_stack([self.gravity, self.inertial, friction])
            # Scaled, since a cut-off of singular values is none for columns of different units; a
            # column of zeros gets a coefficient of 0.
            size = np.maximum(np.linalg.norm(columns, axis=0), 1e-150)
            coefficients = np.linalg.lstsq(columns / size, self.tau, rcond=1e-9)[0] / size
            scales.append(float(coefficients[kind]))
        return 0.5 * (max(scales) - min(scales))

    def estimate_reliability(self, robot: Robot) -> float:
        """Return the share of the model's inertial torque that noise of positions does not feign.

        What gravity and friction explain of it does not count, since it decides nothing.
        """
        rows = self.part.q[:: -(-len(self.part.q) // _MASS_ROWS)]
        masses, _ = robot.dynamics(robot.nominal_parameters, rows, np.zeros_like(rows))
        torque_noise = masses.transpose(0, 2, 1) * self.part.estimate_acceleration_noise()[:, None]
        coupling = robot.description.logged
        if coupling is not None:
            torque_noise = coupling.torque(torque_noise)
        noise_square = float(np.mean(np.sum(torque_noise[:, :, self.j] ** 2, axis=1)))
        others = np.column_stack([self.gravity, self.friction])
        size = np.maximum(np.linalg.norm(others, axis=0), 1e-150)
        coefficients = np.linalg.lstsq(others / size, self.inertial, rcond=1e-9)[0]
        residual = self.inertial - others / size @ coefficients
        return max(1.0 - noise_square / max(float(np.mean(residual**2)), 1e-300), 0.0)

    @cached_property
    def explained_share(self) -> Estimate:
        """Share of the torque's signal that the best explanation predicts on left-out rows.

        Nothing can explain white noise.
        """
        ones = np.ones((len(self.tau), 1))
        constant_squares = self.predict(self.tau, ones)
        candidates = [
            self.predict(self.tau, self.gravity, self.inertial, friction)
            for friction in (self.friction, *self.friction_with_memory)
        ]
        best_squares = min(candidates, key=lambda squares: float(squares.sum()))
        gain = Race(rival="a constant", rival_squares=constant_squares, squares=best_squares).gain
        noise = float(estimate_white_noise(self.part.log.tau[:, [self.j]])[0])
        variance = float(np.var(self.tau))
        noise_share = min(noise**2 / max(variance, 1e-300), 1.0)
        signal_share = max(1.0 - noise_share, MATERIAL_GAIN)
        return Estimate(value=gain.value / signal_share, error=gain.error / signal_share)


def check_torque(
    part: SmoothPart,
    fits: TorqueFits,
    robot: Robot,
    blurred_joints: Collection[int] = (),
    torques: ModelTorques | None = None,
    *,
    is_stated: bool = True,
) -> Iterator[Hypothesis]:
    """Doubt torques, by their fits and by races on left-out rows.

    Parameters
    ----------
    part : rows of a log at the side that the log measures.
    fits : of the moving joints.
    robot : the model.
    blurred_joints : joints whose scale is not judged.
    torques : of the model along the part; without them there are no races.
    is_stated : whether the robot file states the body, which then can be judged.
    """
    left_out = LeftOutRows.split([part.log.name], [part.t])
    for j, fit in fits.items():
        explanations = None
        if torques is not None:
            explanations = Explanations(part, torques, j, left_out)
        doubt = _doubt_signal(part, fit, j, robot, explanations, is_stated=is_stated)
        if doubt is not None:
            yield doubt
            continue
        yield from _doubt_sign(
            fit,
            j,
            robot,
            explanations,
            is_stated=is_stated,
            is_mirrored=is_mirrored(part.q[:, j], robot, j),
        )
        if is_stated:
            if j not in blurred_joints:
                yield from _doubt_scale(fit, j, fits, robot, explanations)
            yield from _doubt_gravity(fit, j, robot, explanations)
    if is_stated:
        yield from _doubt_friction(fits, robot)
    yield from _doubt_peaks(part, fits, robot)


def _doubt_signal(
    part: SmoothPart,
    fit: TorqueFit,
    j: int,
    robot: Robot,
    explanations: Explanations | None,
    *,
    is_stated: bool,
) -> Hypothesis | None:
    """Doubt that a torque holds a signal, if nothing explains it."""
    if fit.r2 >= NO_SIGNAL_R2:
        return None
    if explanations is None:
        explained_share = Estimate(value=fit.r2, error=0.0)
    else:
        explained_share = explanations.explained_share
    trial = Statistic(
        name="the explained share of its signal",
        estimate=explained_share,
        low=NO_SIGNAL_R2,
        errors=1.0,
    )
    if trial.outcome == "lost":
        return None
    # Motion one way at one speed shows no friction, however good the torque.
    contradictions: tuple[str, ...] = ()
    if not moves_both_ways(part.log.q[:, j]):
        contradictions = ("it never reverses, so that its friction may be a constant",)
    level_count = len(np.unique(part.tau[:, j]))
    remedy = "it contains almost no signal, or belongs to another joint"
    if is_stated:
        remedy += ", or the model is of another robot"
    return Hypothesis(
        check="torque-signal",
        joint=robot.description.joints[j],
        observation=f"model and friction explain {100 * max(explained_share.value, 0.0):.0f} % of "
        f"its torque, which takes {level_count} values",
        remedy=remedy,
        severity="warning",
        trials=(trial,),
        contradictions=contradictions,
        record=_TELLING_MOTION,
    )


def _build_share_trial(name: str, size: float, residual: float) -> Statistic:
    """Return the trial that a part of a torque explains a material share of its squares."""
    share = size**2 / max(size**2 + residual**2, 1e-300)
    return Statistic(name=name, estimate=Estimate(value=share, error=0.0), high=MATERIAL_GAIN)


def _doubt_gravity(
    fit: TorqueFit, j: int, robot: Robot, explanations: Explanations | None
) -> Iterator[Hypothesis]:
    """Doubt that the model's gravity acts from the side that the file states."""
    if fit.gravity.value >= 0.0:
        return
    trials: list[Race | Statistic] = [
        Statistic(name="gravity over the model's", estimate=fit.gravity, low=0.0),
        _build_share_trial("the share of gravity", fit.gravity_size, fit.residual),
    ]
    if explanations is not None:
        # In free swing gravity and inertia cancel: both at once or neither explain the torque.
        others = (explanations.inertial, explanations.friction)
        trials.append(
            explanations.race_signs(
                "gravity as the file has it", explanations.gravity, *others, non_negative=2
            )
        )
    yield Hypothesis(
        check="gravity-sign",
        joint=robot.description.joints[j],
        observation="its gravity torque has the opposite sign of the model's "
        f"({fit.gravity.value:.2g} times, {abs(fit.gravity.t):.0f} standard errors)",
        remedy="the mounting differs from 'gravity', its zero is off by half a turn, or "
        "torque or position has the wrong sign",
        trials=tuple(trials),
        record="the joint at rest in several positions",
    )


def _doubt_sign(
    fit: TorqueFit,
    j: int,
    robot: Robot,
    explanations: Explanations | None,
    *,
    is_stated: bool,
    is_mirrored: bool,
) -> Iterator[Hypothesis]:
    """Doubt the sign of a torque that drives the motion where friction should brake it.

    Gravity decides whose sign it is. Without gravity, limits that only mirrored positions keep do.
    """
    if fit.friction.value >= 0.0:
        return
    is_of_position, alternative = _find_wrong_sign(fit, is_mirrored=is_mirrored)
    subject = "torque counts"
    if is_of_position:
        subject = "position and velocity count"
    description = robot.description
    unit = unit_of_joint("N.m", is_prismatic=robot.slides[j])
    yield Hypothesis(
        check="torque-sign",
        joint=description.joints[j],
        observation="its torque drives the motion where friction should brake it "
        f"({fit.friction.value:.3g} {unit} along the velocity, {abs(fit.friction.t):.0f} "
        "standard errors)",
        remedy=f"its {subject} backwards{alternative}",
        trials=_try_sign(fit, explanations, is_stated=is_stated),
        record=_TELLING_MOTION,
        changes=find_sign_change(description, j, position=is_of_position),
    )


def _find_wrong_sign(fit: TorqueFit, *, is_mirrored: bool) -> tuple[bool, str]:
    """Return whether the position has the wrong sign, not the torque, and what else it may be."""
    if fit.bears_gravity:
        # A torque that follows gravity has the right sign.
        return fit.gravity.t > _SIGNIFICANCE, ""
    if is_mirrored:
        return True, ", since only then they keep the model's limits"
    return False, ", or its position and velocity do"


def _try_sign(
    fit: TorqueFit, explanations: Explanations | None, *, is_stated: bool
) -> tuple[Race | Statistic, ...]:
    """Return the trials of a torque that drives the motion."""
    trials: list[Race | Statistic] = [
        Statistic(name="friction along the velocity", estimate=fit.friction, low=0.0),
        _build_share_trial("the share of friction", fit.friction_size, fit.residual),
    ]
    if explanations is not None:
        coulomb = explanations.friction[:, 0]
        offset = explanations.friction[:, -1]
        others = (explanations.gravity, explanations.inertial, offset)
        trials.append(
            explanations.race_signs("friction that brakes", coulomb, *others, non_negative=1)
        )
        if is_stated:
            trials.append(explanations.race_torque_signs())
    return tuple(trials)


def find_sign_change(
    description: RobotDescription, j: int | None, *, position: bool
) -> dict[str, object]:
    """Return the change that reverses a torque or position; `j` None means all."""
    if position:
        return {f"log.units.{key}": _reverse_units(description, key, j) for key in ("q", "dq")}
    gains = description.log.torque_per_ampere
    if gains is None:
        return {"log.units.tau": _reverse_units(description, "tau", j)}
    new_gains = list(gains)
    for k, gain in enumerate(gains):
        if j in (k, None):
            new_gains[k] = -gain
    return {"log.torque_per_ampere": tuple(new_gains)}


def _reverse_units(
    description: RobotDescription, quantity: str, j: int | None
) -> tuple[str | float, ...]:
    """Return the unit of each joint, reversed for joint `j` or for all if it is None."""
    units = list(description.log.units.expand_per_joint(quantity, len(description.joints)))
    for k, unit in enumerate(units):
        if j in (k, None):
            units[k] = reverse_unit(unit)
    return tuple(units)


def _doubt_scale(
    fit: TorqueFit, j: int, fits: TorqueFits, robot: Robot, explanations: Explanations | None
) -> Iterator[Hypothesis]:
    """Doubt the unit or the torque constant of a torque that the model explains."""
    # Races decide whether the model explains enough of it.
    min_r2 = _MIN_R2 if explanations is None else NO_SIGNAL_R2
    if fit.r2 < min_r2:
        return
    scale = _estimate_scale(fit, robot, explanations)
    if scale is None:
        return
    factor = scale.estimate.value
    statistic = Statistic(
        name=f"its {scale.torque_kind} torque over the model's",
        estimate=scale.estimate,
        low=1.0 / _MAX_SCALE,
        high=scale.high,
    )
    races: tuple[Race, ...] = ()
    if explanations is not None:
        races = _race_scale(explanations, fit, by_gravity=scale.by_gravity)
    factors = {k: abs(other.gravity.value) for k, other in fits.items() if other.bears_gravity}
    if _lacks_gravity(fit, factor):
        remedy = (
            "gravity was removed from it, a spring or counterweight carries the arm, or the file "
            "declares another gravity"
        )
        changes: dict[str, object] = {}
    else:
        remedy, changes = _explain_scale(robot.description, j, {**factors, j: factor})
    half_interval = _SIGNIFICANCE * scale.estimate.error
    factor_text = f"{factor:.2g} (+- {half_interval:.1g}) times"
    yield Hypothesis(
        check="torque-scale",
        joint=robot.description.joints[j],
        observation=f"its torque is {factor_text} the {scale.torque_kind} torque of the model",
        remedy=remedy,
        trials=(statistic, *races),
        record="faster motion, and rests in several positions",
        changes=changes,
    )


class _Scale(NamedTuple):
    """A factor of the model's torque that is implausible, and what it is measured by.

    Attributes
    ----------
    by_gravity : whether by gravity, otherwise by inertia.
    estimate : the factor.
    high : the largest plausible factor; the smallest one is 1 / `_MAX_SCALE`.
    """

    by_gravity: bool
    estimate: Estimate
    high: float

    @property
    def torque_kind(self) -> str:
        """The torque that measures the factor, in words."""
        if self.by_gravity:
            return "gravity"
        return "inertial"


def _estimate_scale(
    fit: TorqueFit, robot: Robot, explanations: Explanations | None
) -> _Scale | None:
    """Return the factor of the model's torque, unless it is plausible or nothing tells it."""
    by_gravity = _tells_scale_by_gravity(fit)
    if by_gravity:
        estimate = Estimate(value=abs(fit.gravity.value), error=fit.gravity.error)
        high = _MAX_SCALE
        kind = 0
    else:
        estimate = fit.inertia
        # A rotor may exceed the links many times, but never reduces the inertia.
        high = np.inf
        kind = 1
    if 1.0 / _MAX_SCALE <= estimate.value <= high or not np.isfinite(estimate.error):
        return None
    if explanations is None:
        return _Scale(by_gravity, estimate, high)
    if not by_gravity:
        reliability = explanations.estimate_reliability(robot)
        if reliability < _MIN_RELIABILITY:
            return None
        # Noise of the acceleration reduces the estimate by its share.
        estimate = Estimate(value=estimate.value / reliability, error=estimate.error / reliability)
        if estimate.value >= 1.0 / _MAX_SCALE:
            return None
    spread = explanations.estimate_spread(kind)
    error = max(estimate.error, spread / _SIGNIFICANCE)
    return _Scale(by_gravity, Estimate(value=estimate.value, error=error), high)


def _tells_scale_by_gravity(fit: TorqueFit) -> bool:
    """Return whether gravity measures the scale of a torque, or that there is hardly any of it."""
    if _is_weightless(fit):
        return True
    lowest_factor = fit.gravity.value - _SIGNIFICANCE * fit.gravity.error
    is_huge = fit.gravity_size > 0.0 and lowest_factor > _HUGE_SCALE
    return abs(fit.gravity.t) > _SIGNIFICANCE and (fit.bears_gravity or is_huge)


def _is_weightless(fit: TorqueFit) -> bool:
    """Return whether a torque surely lacks most of the gravity that the model has."""
    highest_factor = fit.gravity.value + _SIGNIFICANCE * fit.gravity.error
    return fit.bears_gravity and highest_factor < 1.0 / _MAX_SCALE


def _lacks_gravity(fit: TorqueFit, factor: float) -> bool:
    """Return whether a torque has the model's inertia, and only a small factor of its gravity."""
    has_inertia = abs(fit.inertia.value) >= 1.0 / _MAX_SCALE
    return factor <= _MAX_WEIGHTLESS_SHARE and _is_weightless(fit) and has_inertia


def _race_scale(
    explanations: Explanations, fit: TorqueFit, *, by_gravity: bool
) -> tuple[Race, ...]:
    """Return the races of a scaled model against the model as it is, and against none."""
    tau = explanations.tau
    gravity = explanations.gravity
    inertial = explanations.inertial
    friction = explanations.friction
    if by_gravity:
        # A torque that counts backwards has another finding.
        signed_tau = float(np.sign(fit.gravity.value) or 1.0) * tau
        # Rotors may add to the inertia. Friction that drives would explain a braked free swing.
        as_it_is = explanations.predict(
            signed_tau - gravity - inertial, inertial, friction, non_negative=3
        )
        without = explanations.predict(tau, inertial, friction)
        scaled = explanations.predict(signed_tau, gravity, inertial, friction, non_negative=4)
    else:
        as_it_is = explanations.predict(tau - inertial, inertial, gravity, friction, non_negative=1)
        without = explanations.predict(tau, gravity, friction)
        scaled = explanations.predict(tau, gravity, inertial, friction)
    races = [Race(rival="the model as it is", rival_squares=as_it_is, squares=scaled)]
    if by_gravity and abs(fit.gravity.value) > _MAX_SCALE:
        # What follows no model is friction, a spring or a cable, whatever its factor.
        races.append(
            Race(
                rival="friction alone",
                rival_squares=without,
                squares=scaled,
                min_gain=CURE_GAIN,
            )
        )
    return tuple(races)


def _explain_scale(
    description: RobotDescription, j: int, scales: Mapping[int, float]
) -> tuple[str, dict[str, object]]:
    """Return what may be wrong with the torque of a joint, and the changes that mend it.

    Parameters
    ----------
    description : of the robot.
    j : index of the joint.
    scales : torque over the model's, of this joint and of others whose gravity tells.
    """
    scale = scales[j]
    if description.log.torque_per_ampere is not None:
        return _explain_constant(scale), {}
    if 1 / _MAX_SCALE < 1e-3 * scale < _MAX_SCALE:
        return "torque is in mN.m", {"log.units.tau": "mN.m"}
    gear_ratios = description.gear_ratio
    if gear_ratios and _is_before_gear(scales, gear_ratios):
        return "it is the motor torque before the gear", {"log.units.tau": gear_ratios}
    causes = []
    is_implausible = [not 1 / _MAX_SCALE <= each <= _MAX_SCALE for each in scales.values()]
    if len(scales) < 2 or not all(is_implausible):
        causes.append("the unit of torque or position is wrong")
    if scale < 1.0 and not gear_ratios:
        # As a current, it is smaller by a constant of the joint, and a log shows no more of it.
        causes.append("the column holds motor torques before a gear, to be stated as gear_ratio")
    causes.append("it holds a current, to be named under [log.columns] with torque_per_ampere")
    return ", or ".join(causes), {}


def _explain_constant(scale: float) -> str:
    """Return what a torque over the model's says of the torque constant."""
    if scale <= 0:
        return "its torque_per_ampere is far too small, or the column holds another signal"
    if scale < 1:
        direction = "small"
        deviation_factor = 1.0 / scale
    else:
        direction = "large"
        deviation_factor = scale
    # One significant digit, for the log shows no more of it.
    digit_count = len(str(int(deviation_factor)))
    rounded_factor = round(deviation_factor, 1 - digit_count)
    return f"its torque_per_ampere is about {rounded_factor:g} times too {direction}"


def _is_before_gear(scales: Mapping[int, float], gear_ratios: Sequence[float]) -> bool:
    """Return whether gears explain the torques of all joints, not of one by chance."""
    return all(
        1 / _MAX_REAL_SCALE < scale * gear_ratios[j] < _MAX_REAL_SCALE
        for j, scale in scales.items()
    )


def _doubt_friction(fits: TorqueFits, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt that torques were measured, if the model without friction explains them."""
    explained_fits = {j: fit for j, fit in fits.items() if fit.r2 > _MIN_R2}
    shows_friction = [
        abs(fit.friction.t) > _SIGNIFICANCE or fit.residual > _MAX_COMPUTED_RESIDUAL * fit.deviation
        for fit in explained_fits.values()
    ]
    if not explained_fits or any(shows_friction):
        return
    joints = [robot.description.joints[j] for j in explained_fits]
    yield Hypothesis(
        check="no-friction",
        joint=joints[0],
        further_joints=tuple(joints[1:]),
        observation="the model's rigid body explains their torques completely, and no part "
        "follows the velocity",
        remedy="they were computed or commanded instead of measured, or friction was removed",
        severity="warning",
    )


def _doubt_peaks(part: SmoothPart, fits: TorqueFits, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt torques far from the model's limits, or from what the other joints use of theirs."""
    torque_limits = np.where(np.isfinite(robot.torque_limits), robot.torque_limits, 0.0)
    peaks = np.quantile(np.abs(part.tau), 0.99, axis=0)
    shares = {
        j: float(peaks[j] / torque_limits[j])
        for j in fits
        if torque_limits[j] > 0 and not robot.slides[j]
    }
    for j, share in shares.items():
        joint = robot.description.joints[j]
        if share > _MAX_PEAK_TO_LIMIT:
            yield Hypothesis(
                check="torque-limit",
                joint=joint,
                observation=f"its torque reaches {peaks[j]:.3g}, {share:.2g} times the model's "
                "limit",
                remedy="its unit or its torque_per_ampere is wrong",
            )
        other_shares = [other_share for k, other_share in shares.items() if k != j]
        usual_share = 0.0
        if len(other_shares) > 1:
            usual_share = float(np.median(other_shares))
        is_small = share * _MIN_RATIO_TO_OTHERS < usual_share and fits[j].r2 > _MIN_R2
        if is_small and not _has_scale_of_model(fits[j]):
            yield Hypothesis(
                check="torque-small",
                joint=joint,
                observation=f"its torque reaches {100 * share:.2g} % of the model's limit, the "
                f"other joints' {100 * usual_share:.2g} %",
                remedy="its unit or its torque_per_ampere may be wrong",
                severity="warning",
            )


def _has_scale_of_model(fit: TorqueFit) -> bool:
    """Return whether gravity or inertia surely have the model's size, as of a light wrist."""
    return any(
        estimate.t > _SIGNIFICANCE and 1.0 / _MAX_SCALE < estimate.value < _MAX_SCALE
        for estimate in (fit.gravity, fit.inertia)
    )


_SPEED_WINDOW = 0.1  # averaging window of a speed [s]
_MIN_MOVING_TO_RESTING = 2.5  # speed of a moving joint over the speed at which it rests
_FINE_LEVELS = 200  # distinct values of a finely quantised signal
_MAX_HELD_SHARE = 0.3  # share of repeated rows
_MIN_STUCK_TIME = 0.3  # duration [s] of a stuck signal
_MIN_STUCK_ROWS = 15
_MIN_STUCK_TO_USUAL = 10.0  # stuck run over others
_MIN_MOVING_SHARE = 0.25  # of a stuck run
_MIN_SPIKE_TO_RANGE = 3.0  # torque spike over the range of other rows
_ROWS_OF_A_CHANGE = 3  # before and after a sudden change of speed
_MIN_SUDDEN_CHANGE_SHARE = 0.3  # of the speed, over the larger of both
_MIN_SUDDEN_SPEED_SHARE = 0.03  # the larger of both, over the peak of the log
_MAX_SPEED_TO_LIMIT = 1.3  # speed over the limit; drives exceed it slightly


def check_raw_signals(log: Log, description: RobotDescription) -> Iterator[Hypothesis]:
    """Doubt raw signals with held, stuck and outlying values."""
    if len(log.t) < 2 * _MIN_STUCK_ROWS:
        return
    speeds = compute_speeds(log)
    min_speeds = _MIN_MOVING_TO_RESTING * find_resting_speeds([log.t], [log.q], [speeds])
    is_moving = np.abs(speeds) > min_speeds
    is_fine = np.array([len(np.unique(column)) > _FINE_LEVELS for column in log.tau.T])
    yield from _doubt_repeated_rows(log, is_moving, is_fine)
    for j, joint in enumerate(description.joints):
        if log.dq is not None:
            row = _find_constant_run(log, log.q[:, j], np.abs(log.dq[:, j]) > min_speeds[j])
            if row is not None:
                yield _doubt_sensor(log, joint, "position", row, "its velocity is not zero")
        tau = log.tau[:, j]
        row = None
        if is_fine[j]:
            row = _find_constant_run(log, tau, is_moving[:, j])
        if row is not None and abs(tau[row]) < np.max(np.abs(tau)):
            yield _doubt_sensor(log, joint, "torque", row, "it moves")
        lowest, highest = np.quantile(tau, [0.01, 0.99])
        neighbour_mean = 0.5 * (tau[:-2] + tau[2:])
        excursion = np.abs(tau[1:-1] - neighbour_mean)
        is_single = (np.abs(tau[2:] - tau[:-2]) < 0.2 * excursion) & ~_changes_speed(log.q[:, j])
        k = int(np.argmax(np.where(is_single, excursion, 0.0)))
        if is_single[k] and excursion[k] > _MIN_SPIKE_TO_RANGE * (highest - lowest) > 0.0:
            yield Hypothesis(
                check="torque-spikes",
                joint=joint,
                observation=f"its torque is {excursion[k]:.3g} off in a single row, at t = "
                f"{log.t[k + 1]:.4g} s",
                remedy="that row is wrong; leave it out",
            )


def _changes_speed(q: Array) -> Mask:
    """Return whether a position (N,) changes its speed suddenly at its inner rows (N - 2,).

    A drive that reverses within a row needs the torque of a single row.
    """
    rows = np.arange(1, len(q) - 1)
    before = np.maximum(rows - _ROWS_OF_A_CHANGE, 0)
    after = np.minimum(rows + _ROWS_OF_A_CHANGE, len(q) - 1)
    speed_before = (q[rows] - q[before]) / (rows - before)
    speed_after = (q[after] - q[rows]) / (after - rows)
    local_peaks = np.maximum(np.abs(speed_before), np.abs(speed_after))
    # At a smooth reversal both speeds are small.
    is_fast = local_peaks > _MIN_SUDDEN_SPEED_SHARE * np.max(local_peaks, initial=0.0)
    return np.asarray(
        is_fast & (np.abs(speed_after - speed_before) > _MIN_SUDDEN_CHANGE_SHARE * local_peaks)
    )


def compute_speeds(log: Log) -> Array:
    """Return speeds (N, n) of raw positions."""
    half_window = max(1, round(0.5 * _SPEED_WINDOW / log.period))
    rows = np.arange(len(log.t))
    first_rows = np.maximum(rows - half_window, 0)
    last_rows = np.minimum(rows + half_window, len(rows) - 1)
    return np.asarray(
        (log.q[last_rows] - log.q[first_rows]) / (log.t[last_rows] - log.t[first_rows])[:, None]
    )


def _doubt_repeated_rows(log: Log, is_moving: Mask, is_fine: Mask) -> Iterator[Hypothesis]:
    if not np.any(is_fine):
        return
    is_in_motion = np.any(is_moving[1:], axis=1)
    if is_in_motion.sum() < _MIN_STUCK_ROWS:
        return
    is_repeated = np.all(np.diff(log.tau[:, is_fine], axis=0) == 0.0, axis=1)
    share = float(np.mean(is_repeated[is_in_motion]))
    if share > _MAX_HELD_SHARE:
        yield Hypothesis(
            check="held-samples",
            joint="",
            observation=f"{100 * share:.0f} % of the rows in motion repeat the torques of the row "
            "before",
            remedy="the log is faster than the robot's data; log at the robot's own rate",
            severity="warning",
        )


def _find_constant_run(log: Log, signal: Array, is_moving: Mask) -> int | None:
    edges = np.flatnonzero(np.diff(np.r_[False, np.diff(signal) == 0.0, False].astype(int)))
    starts = edges[::2]
    lengths = edges[1::2] - edges[::2]
    if not len(starts):
        return None
    k = int(np.argmax(lengths))
    first = int(starts[k])
    last = int(starts[k] + lengths[k])
    usual_length = 1.0
    if len(lengths) > 1:
        usual_length = float(np.quantile(np.delete(lengths, k), 0.95))
    is_long = last - first >= max(_MIN_STUCK_ROWS, _MIN_STUCK_TO_USUAL * usual_length)
    is_lasting = log.t[last] - log.t[first] > _MIN_STUCK_TIME
    if is_long and is_lasting and np.mean(is_moving[first:last]) > _MIN_MOVING_SHARE:
        return first
    return None


def _doubt_sensor(log: Log, joint: str, quantity: str, row: int, contradiction: str) -> Hypothesis:
    return Hypothesis(
        check="stuck",
        joint=joint,
        observation=f"its {quantity} is constant from t = {log.t[row]:.4g} s, while "
        f"{contradiction}",
        remedy="the sensor or its connection failed there; cut these rows out",
    )


def check_speed(part: SmoothPart, robot: Robot) -> Iterator[Hypothesis]:
    """Doubt speeds beyond the model's limits."""
    speed_limits = np.where(np.isfinite(robot.limits[2]), robot.limits[2], 0.0)
    peak_speeds = np.quantile(np.abs(part.v), 0.998, axis=0)
    for j in np.flatnonzero(part.is_moving & (speed_limits > 0.0)):
        ratio = float(peak_speeds[j] / speed_limits[j])
        if ratio <= _MAX_SPEED_TO_LIMIT:
            continue
        unit = unit_of_joint("rad/s", is_prismatic=robot.slides[j])
        yield Hypothesis(
            check="speed-limit",
            joint=robot.joints[j],
            observation=f"it reaches {peak_speeds[j]:.3g} {unit}, {ratio:.2g} times the model's "
            "limit",
            remedy="the time stamps come from a wrong sample rate, a unit is wrong, or the model's "
            "limits are",
            severity="warning",
        )
