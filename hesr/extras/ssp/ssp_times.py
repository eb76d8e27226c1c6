"""Steps and times of an SSP, which are texts of engines, as numbers [s]."""

from math import floor, inf, isfinite, nan

from hesr_model.errors import ConfigError
from hesr_model.findings import caution, log_findings

_ROUND_OFF = 1e-9  # relative, of multiples


def read_step(text: str, where: str) -> float:
    """Return a step [s]; raise ConfigError unless it is positive and finite."""
    try:
        step_size = float(text)
    except ValueError:
        step_size = nan
    if not 0.0 < step_size < inf:
        raise ConfigError(f"{where} is '{text}'; it must be a positive number of seconds.")
    return step_size


def fit_hint(hint: str, base_step: float, where: str) -> float | None:
    """Return the step [s] of a component, None for that of the system; warn of a change.

    A hint need not fit: like libcosim, take the multiple of `base_step` [s] below it, at least one.
    Raises ConfigError if it is no positive number.
    """
    if hint.strip() in ("", "0"):  # none is known
        return None
    wanted_step = read_step(hint, where)
    multiple = max(1, floor(wanted_step / base_step * (1.0 + _ROUND_OFF)))
    step_size = multiple * base_step
    if abs(step_size - wanted_step) > _ROUND_OFF * wanted_step:
        observation = (
            f"the step of {wanted_step:g} s is no multiple of that of the system, {base_step:g} s, "
            f"so that it steps by {step_size:g} s"
        )
        remedy = "give 'step' a divisor of all steps"
        log_findings([caution(check="step-hint", where=where, found=observation, remedy=remedy)])
    return step_size


def fit_stop(start_time: float, stop_time: float, step_size: float, where: str) -> float:
    """Return the end of the last whole step until `stop_time` [s]; warn if it is earlier."""
    count = floor((stop_time - start_time) / step_size * (1.0 + _ROUND_OFF))
    last_time = start_time + max(1, count) * step_size
    if abs(last_time - stop_time) <= _ROUND_OFF * (stop_time - start_time):
        return stop_time
    observation = (
        f"stopTime is {stop_time:g} s, which is not at a step of {step_size:g} s, so that the run "
        f"ends at {last_time:g} s"
    )
    remedy = "give 'stop' or 'step' for another end"
    log_findings([caution(check="stop-time", where=where, found=observation, remedy=remedy)])
    return last_time


def require_times(start_time: float, stop_time: float, where: str) -> None:
    """Raise ConfigError unless a run ends after its start [s]."""
    if not (isfinite(start_time) and isfinite(stop_time) and stop_time > start_time):
        raise ConfigError(f"{where}: it stops at {stop_time:g} s and starts at {start_time:g} s.")
