"""Limits of an observer: half-widths at 95 % over the motion, and the threshold of a contact."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from fmu_src.pages.drive_page import holding_torque
from hesr_model.errors import ExportError
from hesr_model.friction.band import LEVEL, NUMBERS
from hesr_model.friction.model import FrictionModel

HOUR = 3600.0  # time in which one false alarm is allowed [s]
NAMES = NUMBERS[:6]


@dataclass(frozen=True, kw_only=True)
class ObserverLimits:
    """Numbers of the half-widths (6, n) in the order of `NAMES`, and threshold over half-width.

    `duration` [s] and `logs` are those of the calibration, 0 and none for those of a law's bands.
    """

    numbers: tuple[tuple[float, ...], ...]
    factor: float
    duration: float = 0.0
    logs: Sequence[str] = ()

    @property
    def text(self) -> str:
        """Statement on the origin of the limits."""
        if self.logs:
            return (
                f"Limits contain {100 * LEVEL:g} % of the errors in {self.duration / 60.0:.1f} min "
                "of free motion; the stated rate of false alarms is 1 per hour, from their maxima."
            )
        return "Limits are those of the bands of the law; the rate of false alarms is unknown."


def law_limits(model: FrictionModel) -> ObserverLimits:
    """Return the limits that follow from the bands of a law; ExportError if it has none."""
    rows, factors = [], []
    tries = HOUR / model.sample_time * len(model.laws)
    for law in model.laws:
        if law.band is None or model.coupling:  # bands are those of motors
            raise ExportError(f"friction model '{model.law}' has no band; give 'calibration'.")
        own = list(astuple(law.band)[: len(NAMES)])
        if law.band.envelope:  # without measured rests friction is anywhere between both directions
            own[3] = max(own[3], 2.0 * holding_torque(law))
        rows.append(own)
        factors.append((-np.log(tries) / np.log(1.0 - LEVEL)) ** law.band.tail)
    return ObserverLimits(numbers=tuple(zip(*rows, strict=True)), factor=float(max(factors)))
