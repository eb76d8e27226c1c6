"""The friction component: its interface and its generated C, from a friction model."""

from collections.abc import Iterator, Mapping
from math import inf

from fmu_src.friction.codegen import law_functions, switches
from fmu_src.friction.laws_header import Needs, laws_header
from fmu_src.friction.place import MAX_PARAMETERS, exposed, place
from fmu_src.interface import Enumeration, Interface, Variable
from hesr_model.errors import ExportError
from hesr_model.friction.functions import DQ, INPUT_UNITS, INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm, Relaxation
from hesr_model.friction.model import FrictionModel
from hesr_model.units import unit_of_joint

DISCRETISATION = Enumeration(
    name="Discretisation",
    items=(
        ("exact", "exact for inputs held over a step, stable at any step"),
        ("euler", "explicit Euler, requires rate * step < 1"),
    ),
)

_CRAWL = 0.1
"""Speed at whose steady state a state's nominal value is taken [rad/s]."""

_INPUT_DESCRIPTIONS = {
    "dq": "velocity of {}",
    "q": "position of {}",
    "tau_load": "load torque on {}: rigid-body torque of the motion",
}
_EFFORT = {False: "torque", True: "force"}
"""What a joint that turns, or one that slides, takes to move."""


def interface(model: FrictionModel) -> Interface:
    """Return the variables of a friction FMU.

    The connectors `dq[i]`, `q[i]`, `tau_load[i]` -> `tau[i]` are those of every friction FMU.

    Raises
    ------
    ExportError
        If the laws' names are not names in FMI, or their discretisations differ.
    """
    # A joint's name may have the word torque in it, so it is put in afterwards.
    inputs = [
        Variable(
            name=f"{symbol.name}[{joint}]",
            role="input",
            description=_INPUT_DESCRIPTIONS[symbol.name]
            .replace("torque", _EFFORT[slides])
            .format(name),
            unit=unit_of_joint(INPUT_UNITS[symbol.name], slides=slides),
        )
        for symbol in INPUTS
        for joint, (name, slides) in enumerate(zip(model.joints, model.slides, strict=True), 1)
    ]
    outputs = [
        Variable(
            name=f"tau[{joint}]",
            role="output",
            description=f"friction {_EFFORT[slides]} of {model.joints[joint - 1]}",
            unit=unit_of_joint("N.m", slides=slides),
            dependencies=torque_dependencies(law, joint, _sources(joint)),
        )
        for joint, (law, slides) in enumerate(zip(model.laws, model.slides, strict=True), 1)
    ]
    slopes = [
        Variable(
            name=f"dtau_ddq[{joint}]",
            role="on_demand",
            description=f"slope of tau[{joint}] over dq[{joint}] held over the last step, the "
            "states following; in model exchange that at the last event, the states at rest",
            unit=unit_of_joint("N.m.s/rad", slides=slides),
            dependencies=torque_dependencies(law, joint, _sources(joint)),
        )
        for joint, (law, slides) in enumerate(zip(model.laws, model.slides, strict=True), 1)
    ]
    choice = discretisation(
        model,
        "how co-simulation integrates the states over a step; without meaning in model exchange, "
        "where the importer's solver does",
    )
    own = [
        v
        for joint, law in enumerate(model.laws, start=1)
        for v in law_variables(law, joint, _sources(joint))
    ]
    indicators = sum(len(switches(law.form)) for law in model.laws)
    return Interface(
        variables=(*inputs, *outputs, *slopes, choice, *own),
        indicators=indicators,
        own=1 + len(inputs) + indicators,  # step, inputs and signs of friction.c
    )


def discretisation(model: FrictionModel, description: str) -> Variable:
    """Return the parameter that says how states are integrated.

    Raises
    ------
    ExportError
        If the discretisations of the laws differ.
    """
    found = {law.discretisation for law in model.laws if law.form.relaxations}
    if len(found) > 1:
        raise ExportError(
            f"friction model '{model.law}': its joints use both exact and Euler integration; "
            "needed is one for all joints."
        )
    choice = found.pop() if found else "exact"
    return Variable(
        name="discretisation",
        role="fixed",
        description=description,
        enumeration=DISCRETISATION,
        start=1.0 + ("exact", "euler").index(choice),
    )


def law_variables(
    law: FrictionLaw, joint: int, sources: Mapping[str, tuple[str, ...]]
) -> Iterator[Variable]:
    """Yield the states of a joint's law, their derivatives and its parameters.

    Parameters
    ----------
    law : of the joint.
    joint : number of the joint, from 1.
    sources : for each input of laws the variables that it is computed from.
    """
    own = place(law, joint)
    pairs = list(zip(law.form.relaxations, own.states, own.derivatives, strict=True))
    for (relaxation, state, _), start in zip(pairs, law.start, strict=True):
        yield Variable(
            name=state,
            role="state",
            description=f"friction state {relaxation.name} of joint {joint}",
            unit=relaxation.unit,
            start=start,
            nominal=nominal(law, relaxation),
        )
    for relaxation, state, derivative in pairs:
        symbols = relaxation.drive.free_symbols | relaxation.rate.free_symbols
        yield Variable(
            name=derivative,
            role="local",
            description=f"time derivative of {state}",
            unit=_per_second(relaxation.unit),
            derivative_of=state,
            dependencies=(
                *dict.fromkeys(n for u in INPUTS if u in symbols for n in sources[u.name]),
                state,
                *(n for n, c in zip(own.parameters, law.form.coefficients, strict=False)
                  if exposed(law) and c.symbol in symbols),
            ),
        )  # fmt: skip
    if not exposed(law):
        yield Variable(name=f"scale[{joint}]", role="tunable", unit="1", start=1.0,
                       description=f"factor on the friction torque of joint {joint}")  # fmt: skip
        return
    for name, coefficient in zip(own.parameters, law.form.coefficients, strict=True):
        yield Variable(
            name=name,
            role="tunable",
            description=coefficient.description,
            unit=coefficient.unit,
            start=law.values[coefficient.name],
        )


def torque_dependencies(
    law: FrictionLaw, joint: int, sources: Mapping[str, tuple[str, ...]]
) -> tuple[str, ...]:
    """Return the variables that a joint's friction torque is computed from."""
    own = place(law, joint)
    inputs = dict.fromkeys(name for symbol in law.form.inputs for name in sources[symbol.name])
    return (*inputs, *own.states, *own.parameters)


def _sources(joint: int) -> dict[str, tuple[str, ...]]:
    """Return what the inputs of laws are: inputs of the FMU."""
    return {symbol.name: (f"{symbol.name}[{joint}]",) for symbol in INPUTS}


def nominal(law: FrictionLaw, relaxation: Relaxation) -> float:
    """Size of a state in slow sliding, where it is drive / rate; 1 where that is nothing usable."""
    at = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    at |= dict.fromkeys(INPUTS, 0.0) | {DQ: _CRAWL}
    drive, rate = (float(e.subs(at)) for e in (relaxation.drive, relaxation.rate))
    size = abs(drive / rate) if rate else 0.0
    return float(f"{size:.2g}") if 0.0 < size < inf else 1.0


def _per_second(unit: str) -> str:
    """Return the unit of a quantity's time derivative."""
    above, slash, below = unit.partition("/")
    return f"{above}/({below}.s)" if slash else f"{above}/s"


def laws_to_c(model: FrictionModel, table: Interface) -> str:
    """Return laws.h: functions of each distinct form and where each joint's variables stand."""
    first = {name.upper(): f"{name}[1]" for name in ("dq", "q", "tau_load", "tau", "dtau_ddq")}
    needs = Needs(functions=_functions, members=_MEMBERS, more=_NO_CHANGE)
    return laws_header(model, table, first | {"DISCRETISATION": "discretisation"}, needs)


def _functions(form: LawForm, name: str) -> str:
    return law_functions(form, name, tunable=len(form.coefficients) <= MAX_PARAMETERS)


_MEMBERS = {
    "first_switch": "int first_switch;         /* among those of all joints */",
    "names": "const char *const *names; /* of what they are signs */",
    "relaxations": """\
void (*relaxations)(const double *k, const double *u, const double *s, double *drive,
                        double *rate);""",
    "torque": """\
double (*torque)(const double *k, const double *u, const double *s, const double *x,
                     const double *dx);""",
    "relaxations_tangent": """\
void (*relaxations_tangent)(const double *k, const double *u, const double *s,
                                const double *dk, const double *du, double *drive,
                                double *rate);""",
    "torque_tangent": """\
double (*torque_tangent)(const double *k, const double *u, const double *s, const double *x,
                             const double *dx, const double *dk, const double *du,
                             const double *tx, const double *tdx);""",
}

_NO_CHANGE = """
/* Direction along which no coefficient changes. */
static const double no_change[MAX_COEFFICIENTS] = {0.0};
"""
