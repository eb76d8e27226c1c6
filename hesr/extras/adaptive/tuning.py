"""The numbers of an adaptive law, chosen on training logs."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """How quickly factors follow, how far they go, and when they stay.

    Attributes
    ----------
    correlation_time : of what a law does not explain [s].
    forgetting_time : over which the filter looks back [s].
    level_sd, viscosity_sd : standard deviations of the factors before anything is measured; none is
        ever less certain.
    offset_sd : the same of the offset, over the noise.
    level, viscosity : between which factors stay.
    offset : how large it becomes, over the noise.
    offset_rate : how quickly it moves, over the noise [1/s].
    rest : share of the largest speed below which nothing is learned.
    outlier : innovations over so many standard deviations are not learned from.
    clipped : innovations count as no more than so many.
    hold : for how long nothing is learned after an outlier [s].
    carried : share of what factors had become that the next log starts from; how sure they are
        starts anew, since a night lies between days.
    change : smallest change of friction that is looked for, as a share.
    change_of_offset : the same of the offset, over the noise.
    alarm : log-likelihood ratio at which a change counts as found.
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
    change: float = 0.1
    change_of_offset: float = 0.5
    alarm: float = 20.0


TUNING = Tuning()
"""As chosen on the training logs of the UR10e: of laws that were fitted to one or two of them and
followed over those left out, in the order of their days, with the least harm to any joint."""
