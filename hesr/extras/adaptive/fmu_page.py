"""Equations and notes on the page of an adaptive friction FMU."""

from hesr.extras.adaptive.component import HEALTH, Tuning


def adaptive_lines(tuning: Tuning) -> tuple[str, ...]:
    """Return the equations of `component.adaptive_component`, in the names of one joint."""
    level_low, level_high = tuning.level
    viscosity_low, viscosity_high = tuning.viscosity
    return (
        "tau = law above with bounds times level, viscous terms times viscosity, + offset",
        "  with the factors at the last sample; with a temperature also times c and n",
        "r = tau_meas - tau_rigid - tau",
        f"e = r within +-{tuning.clipped:g} sqrt(noise^2 + s)",
        "phi = (d tau / d level, d tau / d viscosity, 1), the first two 0 if dq is slow",
        f"g = P phi,  s = phi' g,  R = 2 T_c noise^2,  T_c = {tuning.correlation_time:g} s",
        "w = dt / (R + s dt), but 0 if health is switched_off, slow or saturated",
        "v = w, but 0 if health is outlier",
        "(level, viscosity, offset) = previous(level, viscosity, offset) + g v e, within limits:",
        f"  {level_low:g} <= level <= {level_high:g}, "
        f"{viscosity_low:g} <= viscosity <= {viscosity_high:g}, "
        f"abs(offset) <= {tuning.offset:g} noise, "
        f"abs(d offset / dt) <= {tuning.offset_rate:g} noise per second",
        f"P = previous(P) - g g' (v - dt / ((T_f + dt) s)),  T_f = {tuning.forgetting_time:g} s, "
        "unchanged if v is 0,",
        f"  with deviations of at most the initial ones: level {tuning.level_sd:g}, "
        f"viscosity {tuning.viscosity_sd:g}, offset {tuning.offset_sd:g} noise",
        "level_sd, viscosity_sd, offset_sd = roots of the diagonal of P",
        "up = max(0, previous(up) + d p w e - d^2 p^2 w / 2), down the same with -d, both at most "
        f"{1.5 * tuning.alarm:g}",
        f"drift = (up > {tuning.alarm:g}) - (down > {tuning.alarm:g}) with p = phi[1] + phi[2], "
        f"d = {tuning.change:g}",
        f"shift = the same with p = 1, d = {tuning.change_of_offset:g} noise",
        f"health = the first that holds of {_reasons(tuning)}; else 0",
    )


def _reasons(tuning: Tuning) -> str:
    numbers = {name: number for number, name in HEALTH}
    conditions = {
        "switched_off": "adapt is false",
        "slow": "abs(dq) <= speed_least",
        "saturated": "abs(tau_meas) > torque_limit > 0",
        "outlier": f"abs(r) exceeded {tuning.outlier:g} sqrt(noise^2 + s) in the last "
        f"{tuning.hold:g} s",
        "at_limit": "level or viscosity is at a limit",
    }
    texts = [f"{numbers[name]} = {name} ({text})" for name, text in conditions.items()]
    return ", ".join(texts)


ADAPTIVE_NOTES = (
    "A Kalman filter estimates three factors of each joint from its measured torque. Names "
    "without an index are those of one joint: joint[i].noise, level[i]. Bounds are those of "
    "stops, F_c and F_s; they carry the Coulomb friction. previous(x) is x at the last sample, P "
    "the covariance of the factors.",
    "Connect dq, q and tau_load as for every friction FMU, tau_meas to the measured torque of the "
    "same sample, and tau_rigid to the rigid-body torque of the measured motion, acceleration "
    "included. tau does not depend on tau_meas of the same step, so no loop closes through the "
    "FMU.",
    "Set adapt to false during a tool change, with an unknown payload, or in intended contact. An "
    "alarm ends when the factors have adapted.",
    "The next run may begin with level_start, viscosity_start and offset_start a quarter of the "
    "way from 1 (0 for the offset) to the last values.",
    "The reference results follow a motion within the trained speeds. Their measured torques "
    "differ from those of the law by up to two standard deviations of its training.",
)
