"""What fixes the size of torques in logs without torque.

Positions depend on ratios of torques only: all torques times one factor move nothing. The factor
comes from a stated gain, a stated torque that the servo reached, a known inertia that single logs
added, a motor current with its constant, or gravity by the model's masses. A stated gain is taken
as it is; of the others the one with the smallest error.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cosim.servo.current import CurrentReading
from cosim.servo.interval import Interval
from hesr_model.friction.servo import ScaleSource
from hesr_model.robots.robot import RobotDescription

_MOST_ERROR = 0.3  # largest relative error of a fitted reference that still fixes the size
_CONTRADICTION = 3.0  # standard errors between two sources
_LEAST_ERROR = 1e-3  # relative, of a size that weighs in a mean


@dataclass(frozen=True, kw_only=True)
class TorqueScale:
    """Size of a joint's torques.

    Attributes
    ----------
    source : what fixes it.
    gain : gain of the servo [N.m/rad], 1 without a source.
    error : relative standard error of what is stated; None without a source.
    reference : fitted value over the gain whose size is known, such as the factor of the bodies;
        its error enters those of all torques. None if none is needed.
    fit_error : relative standard error of the reference.
    contradiction : gain over that of gravity if the two disagree, else None.
    """

    source: ScaleSource
    gain: float = 1.0
    error: float | None = None
    reference: str | None = None
    fit_error: float = 0.0
    contradiction: float | None = None

    @property
    def total_error(self) -> float:
        """Relative standard error of the gain."""
        return float(np.hypot(self.error or 0.0, self.fit_error))


def find_scale(
    interval: Interval,
    description: RobotDescription,
    j: int,
    current: CurrentReading | None = None,
) -> TorqueScale:
    """Return the size of the torques of joint j, from its fit over the gain and its current."""
    gravity = _find_by_reference(
        interval, "body_factor", 1.0, source="gravity", error=description.scale.body_error
    )
    servo = description.servo
    joint_count = len(description.joints)
    gain = servo.find_stated("kp", j, joint_count)
    if gain is not None:
        return _compare(
            TorqueScale(source="gain", gain=gain, error=servo.gain_error), gravity=gravity
        )
    candidates = list(_list_stated(interval, description, j, current))
    known = [candidate for candidate in [*candidates, gravity] if candidate is not None]
    if not known:
        return TorqueScale(source="none")
    best = min(known, key=lambda candidate: candidate.total_error)
    if best.source == "gravity":
        return best
    return _compare(best, gravity=gravity)


def find_shared_scale(scales: Sequence[TorqueScale]) -> TorqueScale | None:
    """Return the size of torques of a joint whose servo is that of joints with a known size.

    The gain is their weighted mean, its error that of the mean and the scatter between them.
    """
    known = [scale for scale in scales if scale.source != "none"]
    if not known:
        return None
    logarithms = np.log([scale.gain for scale in known])
    weights = np.array([max(scale.total_error, _LEAST_ERROR) ** -2 for scale in known])
    mean = float(np.average(logarithms, weights=weights))
    scatter = float(np.average((logarithms - mean) ** 2, weights=weights))
    # The errors of gravity are those of one model file, and do not average out.
    shared_error = min(scale.total_error for scale in known)
    return TorqueScale(
        source="other joints",
        gain=float(np.exp(mean)),
        error=float(np.sqrt(shared_error**2 + scatter)),
    )


def _list_stated(
    interval: Interval, description: RobotDescription, j: int, current: CurrentReading | None
) -> Iterator[TorqueScale | None]:
    """Yield the sizes of joint j by all that is stated except its gain; None if not fitted."""
    servo = description.servo
    joint_count = len(description.joints)
    limit = servo.find_stated("torque_limit", j, joint_count)
    if limit is not None:
        yield _find_by_reference(
            interval, "torque_limit", limit, source="stall torque", error=servo.gain_error
        )
    yield _find_by_reference(interval, "added_factor", 1.0, source="added inertia", error=0.0)
    constants = description.log.torque_per_ampere
    constant_source = description.sources.expand_per_joint("torque_per_ampere", joint_count)[j]
    if constants is None or constant_source == "guessed":
        return
    if current is None or current.kind != "motor current":
        return
    relative_error = current.slope_error / max(current.slope, 1e-300)
    if relative_error < _MOST_ERROR:
        yield TorqueScale(
            source="current",
            gain=abs(constants[j]) * current.slope,
            error=float(np.hypot(servo.gain_error, relative_error)),
        )


def _find_by_reference(
    interval: Interval, name: str, size: float, *, source: ScaleSource, error: float
) -> TorqueScale | None:
    """Return the size of torques by a fitted value whose true size is known."""
    value, value_error = interval.find(name)
    if not value > 0.0 or value_error > _MOST_ERROR * value:
        return None
    return TorqueScale(
        source=source,
        gain=size / value,
        error=error,
        reference=name,
        fit_error=value_error / value,
    )


def _compare(scale: TorqueScale, *, gravity: TorqueScale | None) -> TorqueScale:
    """Return a size of torques, with its contradiction to gravity if they disagree."""
    if gravity is None:
        return scale
    ratio = scale.gain / gravity.gain
    spread = np.hypot(scale.total_error, gravity.total_error)
    if abs(np.log(ratio)) > _CONTRADICTION * spread:
        return replace(scale, contradiction=ratio)
    return scale
