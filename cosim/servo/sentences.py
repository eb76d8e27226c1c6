"""What is said of a servo from commands: its values, what fixes their size, and what is unknown."""

from collections.abc import Iterator

from cosim.servo.result import ServoResult
from hesr_model.friction.servo import ScaleSource

_MANY_STEPS = 3.0  # of the encoder: an error that it does not explain
_FEW_STEPS = 10.0  # of the encoder: a motion that shows no friction
_LEAST_FRICTION = 2.0  # steps of the encoder below which friction is not seen
_LEAST_GRAVITY_RANGE = 0.1  # of its mean, which separates gravity from a bias of the encoder
# Values of a servo: name, unit with and without a scale, and factor.
_SHOWN = (
    ("kp", "gain", "N.m/rad", "", 1.0),
    ("ki", "integral gain", "N.m/(rad.s)", "1/s of the gain", 1.0),
    ("kd", "derivative gain", "N.m.s/rad", "s of the gain", 1.0),
    ("armature", "armature", "kg.m2", "s2 of the gain", 1.0),
    ("torque_limit", "torque limit", "N.m", "rad of the servo's error", 1.0),
    ("latency", "loop delay", "ms", "ms", 1e3),
    ("command_filter", "filter of commands", "ms", "ms", 1e3),
    ("speed_limit", "speed limit", "rad/s", "rad/s", 1.0),
)
_STATED: dict[ScaleSource, str] = {
    "gain": "servo.kp",
    "stall torque": "servo.torque_limit",
    "added inertia": "scale.inertia_added",
    "current": "log.torque_per_ampere",
}


def describe_servo(result: ServoResult) -> list[str]:
    """Return the sentences about the servo of a joint."""
    return [
        _describe_values(result),
        _describe_scale(result),
        *_list_bounds(result),
        *_list_doubts(result),
    ]


def _describe_values(result: ServoResult) -> str:
    fitted = result.servo
    has_scale = fitted.scale != "none"
    values = []
    for name, title, unit, ratio_unit, factor in _SHOWN:
        value = getattr(fitted.servo, name)
        shown_unit = unit if has_scale else ratio_unit
        if not value or not shown_unit:
            continue
        text = f"{title} {factor * value:.4g}"
        if name in fitted.intervals:
            text += f" +- {factor * fitted.intervals[name]:.2g}"
        values.append(f"{text} {shown_unit}")
    return (
        f"{', '.join(values)}; position error {1e3 * fitted.position_rmse:.3g} mrad, "
        f"{1e3 * fitted.ideal_rmse:.3g} of an ideal servo"
    )


def _describe_scale(result: ServoResult) -> str:
    """Return what fixes the size of torques."""
    fitted = result.servo
    percent = 100.0 * (fitted.scale_error or 0.0)
    if fitted.scale == "none":
        milliradians = 1e3 * result.usual_friction
        return (
            f"torques are known up to one factor: friction is {milliradians:.3g} mrad of the "
            "servo's error; state servo.kp, servo.torque_limit or scale.same_servos, or log a "
            "posture that gravity loads, or logs with and without a known inertia"
        )
    if fitted.scale == "gravity":
        return f"scale from gravity, +- {percent:.0f} %: as good as the masses of the model file"
    if fitted.scale == "added inertia":
        percent = 100.0 * result.scale.fit_error
        return f"scale from the added inertia, +- {percent:.1f} %"
    if fitted.scale == "other joints":
        return f"scale from the other joints, stated to have the same servo, +- {percent:.0f} %"
    if fitted.scale == "current":
        return f"scale from the motor's current and its constant, +- {percent:.0f} %"
    return f"scale from the stated {fitted.scale}, +- {percent:.0f} %"


def _list_bounds(result: ServoResult) -> Iterator[str]:
    """Yield bounds of what the motion did not show."""
    servo = result.servo.servo
    has_scale = result.servo.scale != "none"
    unit = "rad of the servo's error"
    if has_scale:
        unit = "N.m"
    if servo.torque_limit is None and servo.ki == 0.0:
        yield f"torque limit: at least {servo.kp * result.largest_error:.3g} {unit}"
    if result.usual_friction < _LEAST_FRICTION * result.encoder_step:
        most = _LEAST_FRICTION * result.encoder_step * servo.kp
        yield f"friction below the encoder's resolution: at most {most:.2g} {unit}"
    width = result.servo.intervals.get("armature", 0.0)
    if has_scale and width >= servo.armature:
        yield f"armature not visible beside the link: at most {servo.armature + width:.2g} kg.m2"


def _list_doubts(result: ServoResult) -> Iterator[str]:
    """Yield what the fit could not explain or separate."""
    fitted = result.servo
    if result.travel < _FEW_STEPS * result.encoder_step:
        yield "the joint moves less than 10 steps of the encoder, which shows no friction"
    if fitted.scale == "gravity" and result.gravity_range < _LEAST_GRAVITY_RANGE:
        yield "encoder bias and scale cannot be separated; the bias is held at 0"
    if fitted.scale == "none" and result.added_inertia > 0.0:
        yield "a constant inertia does not fix the scale: the armature absorbs it"
    if fitted.position_rmse > _MANY_STEPS * result.encoder_step:
        yield (
            f"the error is {fitted.position_rmse / result.encoder_step:.0f} steps of the encoder: "
            "servo or law is incomplete, and friction may hold what the servo does"
        )
    if result.scale.contradiction is not None:
        yield (
            f"{_STATED[fitted.scale]} and the model's gravity disagree by a factor of "
            f"{result.scale.contradiction:.3g}: is the base tilted, a mass missing, or the gain in "
            "other units? the gain is kept"
        )
    if result.release_count:
        yield (
            f"moved {result.release_count} times while it and its command rested, as if shaken "
            "loose: no law has that"
        )
    if result.current is not None:
        yield result.current.sentence
