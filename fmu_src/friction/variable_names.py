"""Names of the variables of a joint's friction law in an FMU."""

from dataclasses import dataclass

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.scales import SCALES

MAX_PARAMETERS = 64  # laws with more coefficients than this show only their factors


@dataclass(frozen=True, kw_only=True)
class Place:
    """Names of one joint's variables in the order of the C code."""

    states: tuple[str, ...]
    derivatives: tuple[str, ...]
    starts: tuple[str, ...]
    parameters: tuple[str, ...]


def exposed(law: FrictionLaw) -> bool:
    """Whether the coefficients of a law are parameters of the FMU."""
    return len(law.values) <= MAX_PARAMETERS


def place(law: FrictionLaw, joint: int) -> Place:
    """Return the names of a joint's variables; joints count from 1."""
    return Place(
        states=tuple(f"{r.name}[{joint}]" for r in law.form.memory),
        derivatives=tuple(f"der({r.name}[{joint}])" for r in law.form.memory),
        starts=tuple(f"{r.name}_start[{joint}]" for r in law.form.memory),
        parameters=tuple(f"joint[{joint}].{name}" for name in law.values) if exposed(law) else (),
    )


def scales_of(joint: int) -> tuple[str, ...]:
    """Return the names of a joint's factors on Coulomb and viscous friction."""
    return tuple(f"{scale.name}[{joint}]" for scale in SCALES)
