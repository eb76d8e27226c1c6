"""Settings of an adaptive law, chosen on training logs."""

from dataclasses import dataclass

from hesr_model.friction.factors import CHANGE, CHANGE_OF_OFFSET


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Settings of the adaptation and thresholds of its alarms.

    correlation_time : of the unexplained torque [s].
    forgetting_time : memory of the filter [s].
    level_sd, viscosity_sd : initial and largest standard deviations.
    offset, offset_sd, offset_rate [1/s] : limits relative to the noise.
    rest : share of the largest speed below which nothing is learned.
    outlier, clipped : limits of innovations in standard deviations.
    hold : time without learning after an outlier [s].
    carried : share of the learned factors in the next log.
    change, change_of_offset : smallest detected change.
    alarm : threshold of the log-likelihood ratio.
    """

    correlation_time: float = 0.5
    forgetting_time: float = 60.0
    level_sd: float = 0.05
    viscosity_sd: float = 0.4
    offset_sd: float = 0.1
    level: tuple[float, float] = (0.5, 2.0)
    viscosity: tuple[float, float] = (0.3, 3.0)
    offset: float = 3.0
    offset_rate: float = 0.05
    rest: float = 0.02
    outlier: float = 6.0
    clipped: float = 3.0
    hold: float = 0.5
    carried: float = 0.25
    change: float = CHANGE
    change_of_offset: float = CHANGE_OF_OFFSET
    alarm: float = 20.0


TUNING = Tuning()
"""Chosen on training logs of the UR10e: laws of one or two logs, followed over the others."""
