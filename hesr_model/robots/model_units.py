"""Units of a model file, judged by its masses, lengths and inertias against each other.

URDF and MJCF have no units: CAD programs export millimetres, grams and their products as they are.
The bounds hold for all of 160 public arms, hands and legged robots of three joints or more, from a
fruit fly to a bridge crane, with a factor of at least 3 but for one hand, whose masses are odd.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hesr_model.findings import Finding, caution
from hesr_model.support.text import join_with_and

_MIN_JOINTS = 3  # a pendulum or a cart of a benchmark may have any size
_MIN_REACH = 0.1  # [m], below which a reach says nothing
_MAX_REACH = 30.0  # [m]
_DENSITY = (0.005, 3000.0)  # mass over the cube of the reach [kg/m3]
_GYRATION = (0.003, 2.0)  # median radius of gyration over the reach
_USUAL_REACH = 0.8  # [m]
_USUAL_DENSITY = 15.0  # [kg/m3], the median of these robots
_USUAL_GYRATION = 0.06  # over the reach, their median
_LENGTH_UNITS = {"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_RARE_UNITS = ("centimetres", "inches", "g.m2", "kg.cm2")
_ODDNESS = 3.0  # logarithm of the size by which an odd unit is less likely
_MASS_UNITS = {"kilograms": 1.0, "grams": 1e-3}
_INERTIA_UNITS = {"kg.m2": 1.0, "g.m2": 1e-3, "kg.mm2": 1e-6, "g.mm2": 1e-9, "kg.cm2": 1e-4}


class RobotSize(NamedTuple):
    """Size of a robot as its file states it.

    Attributes
    ----------
    reach : largest sum of distances between joints, from the base to a centre of mass [m].
    mass : mass of all links that move [kg].
    gyration : median radius of gyration of these links about their centres [m].
    """

    reach: float
    mass: float
    gyration: float

    def is_plausible(self) -> bool:
        """Return whether a robot of such a size can exist."""
        if not _MIN_REACH <= self.reach <= _MAX_REACH:
            return False
        density = self.mass / self.reach**3
        relative_gyration = self.gyration / self.reach
        return (
            _DENSITY[0] <= density <= _DENSITY[1]
            and _GYRATION[0] <= relative_gyration <= _GYRATION[1]
        )

    def distance_from_usual(self) -> float:
        """Return the sum of the logarithms of ratios to the reach and shape of most robots."""
        density = self.mass / self.reach**3
        relative_gyration = self.gyration / self.reach
        ratios = (
            self.reach / _USUAL_REACH,
            density / _USUAL_DENSITY,
            relative_gyration / _USUAL_GYRATION,
        )
        return float(np.abs(np.log(ratios)).sum())

    def convert(self, length: float, mass: float, inertia: float) -> "RobotSize":
        """Return the size where the units of the file are so many SI units."""
        return RobotSize(
            reach=length * self.reach,
            mass=mass * self.mass,
            gyration=np.sqrt(inertia / mass) * self.gyration,
        )


def measure_size(pin_model: Any) -> RobotSize | None:
    """Return the size of a model of Pinocchio; None if its links have no mass or no inertia."""
    distances = np.zeros(pin_model.njoints)
    reach = 0.0
    masses = []
    gyrations = []
    for joint in range(1, pin_model.njoints):
        placement = pin_model.jointPlacements[joint].translation
        distances[joint] = distances[pin_model.parents[joint]] + np.linalg.norm(placement)
        inertia = pin_model.inertias[joint]
        trace = float(np.trace(inertia.inertia))
        if inertia.mass <= 0.0 or trace <= 0.0:
            continue
        reach = max(reach, float(distances[joint] + np.linalg.norm(inertia.lever)))
        masses.append(inertia.mass)
        # The trace is twice the sum of m r^2 about the centre.
        gyrations.append(np.sqrt(0.5 * trace / inertia.mass))
    if not masses:
        return None
    return RobotSize(reach, float(np.sum(masses)), float(np.median(gyrations)))


def doubt_units(path: Path, pin_model: Any) -> Iterator[Finding]:
    """Yield a finding if no robot has such masses, lengths and inertias, with likely units."""
    size = measure_size(pin_model)
    if pin_model.njoints <= _MIN_JOINTS or size is None or size.reach < _MIN_REACH:
        return
    if size.is_plausible():
        return
    observation = (
        f"a reach of {size.reach:.3g} m, {size.mass:.3g} kg and a radius of gyration of "
        f"{size.gyration:.3g} m do not fit each other"
    )
    units = find_units(size)
    remedy = "check the units of lengths, masses and inertias"
    if units:
        remedy = f"convert the file if it has {join_with_and(units)}"
    yield caution(check="model-units", where=str(path), found=observation, remedy=remedy)


def find_units(size: RobotSize) -> list[str]:
    """Return the units other than SI that make a size plausible, none if no units do.

    Of several choices, that of the most usual robot is taken; each further odd unit counts as much
    as a factor of 20 in its size, each rare one twice.
    """
    best_units: list[str] = []
    best_rank = np.inf
    for length, mass in product(_LENGTH_UNITS, _MASS_UNITS):
        length_factor = _LENGTH_UNITS[length]
        mass_factor = _MASS_UNITS[mass]
        for inertia, inertia_factor in _INERTIA_UNITS.items():
            converted = size.convert(length_factor, mass_factor, inertia_factor)
            if not converted.is_plausible():
                continue
            units = []
            penalties = 0
            if length_factor != 1.0:
                units.append(f"lengths in {length}")
                penalties += 2 if length in _RARE_UNITS else 1
            if mass_factor != 1.0:
                units.append(f"masses in {mass}")
                penalties += 1
            # A file in millimetres or grams usually has inertias in the same units.
            is_product = np.isclose(inertia_factor, mass_factor * length_factor**2)
            if not is_product:
                penalties += 2 if inertia in _RARE_UNITS else 1
            if inertia_factor != 1.0 or not is_product:
                units.append(f"inertias in {inertia}")
            rank = _ODDNESS * penalties + converted.distance_from_usual()
            if rank < best_rank:
                best_rank = rank
                best_units = units
    return best_units
