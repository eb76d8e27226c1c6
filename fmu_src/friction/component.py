"""The friction component: its interface and its generated C, from a friction model."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

from fmu_src.friction.codegen import law_functions, switches
from fmu_src.interface import Enumeration, Interface, Variable, literal
from hesr_model.errors import ExportError
from hesr_model.friction.functions import DQ, INPUT_UNITS, INPUTS, Q
from hesr_model.friction.law import FrictionLaw, FrictionModel, LawForm, Relaxation

MAX_PARAMETERS = 64
"""Laws with more coefficients than this show one scale factor instead of all of them."""

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


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Names of one joint's variables, in the order in which the C side expects them."""

    states: tuple[str, ...]
    derivatives: tuple[str, ...]
    parameters: tuple[str, ...]


def exposed(law: FrictionLaw) -> bool:
    """Whether the coefficients of a law are parameters of the FMU."""
    return len(law.values) <= MAX_PARAMETERS


def _place(law: FrictionLaw, joint: int) -> _Place:
    return _Place(
        states=tuple(f"{r.name}[{joint}]" for r in law.form.relaxations),
        derivatives=tuple(f"der({r.name}[{joint}])" for r in law.form.relaxations),
        parameters=tuple(f"joint[{joint}].{name}" for name in law.values)
        if exposed(law)
        else (f"scale[{joint}]",),
    )


def interface(model: FrictionModel) -> Interface:
    """Return the variables of a friction FMU.

    The connectors `dq[i]`, `q[i]`, `tau_load[i]` -> `tau[i]` are those of every friction FMU.

    Raises
    ------
    ExportError
        If the laws' names are not names in FMI, or their discretisations differ.
    """
    joints = range(1, len(model.laws) + 1)
    inputs = [
        Variable(
            name=f"{symbol.name}[{joint}]",
            role="input",
            description=_INPUT_DESCRIPTIONS[symbol.name].format(model.joints[joint - 1]),
            unit=INPUT_UNITS[symbol.name],
        )
        for symbol in INPUTS
        for joint in joints
    ]
    outputs = [
        Variable(
            name=f"tau[{joint}]",
            role="output",
            description=f"friction torque of {model.joints[joint - 1]}",
            unit="N.m",
            dependencies=_dependencies(law, joint),
        )
        for joint, law in enumerate(model.laws, start=1)
    ]
    slopes = [
        Variable(
            name=f"dtau_ddq[{joint}]",
            role="on_demand",
            description=f"slope of tau[{joint}] over dq[{joint}] held over the last step, the "
            "states following; in model exchange that at the last event, the states at rest",
            unit="N.m.s/rad",
            dependencies=_dependencies(law, joint),
        )
        for joint, law in enumerate(model.laws, start=1)
    ]
    choice = Variable(
        name="discretisation",
        role="fixed",
        description="how co-simulation integrates the states over a step; without meaning in "
        "model exchange, where the importer's solver does",
        enumeration=DISCRETISATION,
        start=1.0 + ("exact", "euler").index(_discretisation(model)),
    )
    own = [v for joint, law in enumerate(model.laws, start=1) for v in _of_joint(law, joint)]
    indicators = sum(len(switches(law.form)) for law in model.laws)
    return Interface(
        variables=(*inputs, *outputs, *slopes, choice, *own),
        indicators=indicators,
        own=1 + len(inputs) + indicators,  # step, inputs and signs of friction.c
    )


def _discretisation(model: FrictionModel) -> str:
    found = {law.discretisation for law in model.laws if law.form.relaxations}
    if len(found) > 1:
        raise ExportError(
            f"friction model '{model.law}': its joints use both exact and Euler integration; "
            "needed is one for all joints."
        )
    return found.pop() if found else "exact"


def _of_joint(law: FrictionLaw, joint: int) -> Iterator[Variable]:
    """States, their derivatives and the parameters of a joint."""
    place = _place(law, joint)
    pairs = list(zip(law.form.relaxations, place.states, place.derivatives, strict=True))
    for (relaxation, state, _), start in zip(pairs, law.start, strict=True):
        yield Variable(
            name=state,
            role="state",
            description=f"friction state {relaxation.name} of joint {joint}",
            unit=relaxation.unit,
            start=start,
            nominal=_nominal(law, relaxation),
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
                *(f"{u.name}[{joint}]" for u in INPUTS if u in symbols),
                state,
                *(n for n, c in zip(place.parameters, law.form.coefficients, strict=False)
                  if exposed(law) and c.symbol in symbols),
            ),
        )  # fmt: skip
    if not exposed(law):
        yield Variable(name=f"scale[{joint}]", role="tunable", unit="1", start=1.0,
                       description=f"factor on the friction torque of joint {joint}")  # fmt: skip
        return
    for name, coefficient in zip(place.parameters, law.form.coefficients, strict=True):
        yield Variable(
            name=name,
            role="tunable",
            description=coefficient.description,
            unit=coefficient.unit,
            start=law.values[coefficient.name],
        )


def _dependencies(law: FrictionLaw, joint: int) -> tuple[str, ...]:
    place = _place(law, joint)
    inputs = tuple(f"{symbol.name}[{joint}]" for symbol in law.form.inputs)
    return (*inputs, *place.states, *place.parameters)


def _nominal(law: FrictionLaw, relaxation: Relaxation) -> float:
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
    forms: list[LawForm] = []
    for law in model.laws:
        if law.form not in forms:
            forms.append(law.form)
    names = [f"law_{i}" for i, _ in enumerate(forms, start=1)]
    shown = [len(form.coefficients) <= MAX_PARAMETERS for form in forms]
    functions = [law_functions(*fn, tunable=t) for *fn, t in zip(forms, names, shown, strict=True)]
    constants, rows, before = [], [], 0
    for joint, law in enumerate(model.laws, start=1):
        name = names[forms.index(law.form)]
        place = _place(law, joint)
        if not exposed(law):
            values = ", ".join(literal(v) for v in law.values.values())
            constants.append(f"static const double constants_{joint}[] = {{{values}}};")
        states = (*place.states, *place.derivatives)
        bends = switches(law.form)
        row = (
            str(len(place.states)),
            str(table.first(states) if states else 0),
            str(table.first(place.parameters) if place.parameters else 0),
            "NULL" if exposed(law) else f"constants_{joint}",
            str(len(bends)),
            str(before),
            f"{name}_names",
            *(f"{name}_{function}" for function in _FUNCTIONS),
        )
        rows.append(f"    {{{', '.join(row)}}},")
        before += len(bends)
    return _LAWS.format(
        functions="\n".join(functions),
        names="\n".join(map(_names, forms, names)),
        constants="\n".join([*constants, ""]) if constants else "",
        rows="\n".join(rows),
        joints=len(model.laws),
        inputs=len(INPUTS),
        dq=table.references[f"{DQ.name}[1]"],
        q=table.references[f"{Q.name}[1]"],
        tau_load=table.references["tau_load[1]"],
        tau=table.references["tau[1]"],
        dtau_ddq=table.references["dtau_ddq[1]"],
        discretisation=table.references["discretisation"],
        states=max(1, *(len(form.relaxations) for form in forms)),
        switches=max(1, *(len(switches(form)) for form in forms)),
        coefficients=max(1, *(len(form.coefficients) for form in forms)),
    )


_FUNCTIONS = ("switches", "relaxations", "torque", "relaxations_tangent", "torque_tangent")


def _names(form: LawForm, name: str) -> str:
    """Return what the held signs are signs of, for messages; C knows no empty arrays."""
    texts = ", ".join(f'"{bend}"' for bend in switches(form))
    return f"static const char *const {name}_names[] = {{{texts or 'NULL'}}};"


_LAWS = """\
/* Generated: the friction laws of the joints. */
#ifndef LAWS_H
#define LAWS_H

#include <stdbool.h>
#include <stddef.h>

#include "law_math.h"

/* Where the first variable of each kind stands; the other joints follow it. */
enum {{ DQ = {dq}, Q = {q}, TAU_LOAD = {tau_load}, TAU = {tau}, DTAU_DDQ = {dtau_ddq} }};
enum {{ DISCRETISATION = {discretisation} }};
enum {{ JOINTS = {joints}, INPUTS_OF_JOINT = {inputs} }};
enum {{ MAX_STATES = {states}, MAX_SWITCHES = {switches}, MAX_COEFFICIENTS = {coefficients} }};
enum {{ EXACT = 1, EULER = 2 }}; /* values of the discretisation */

typedef struct {{
    int states;               /* how many; their derivatives follow them */
    int first_state;          /* among the variables */
    int first_parameter;      /* coefficients, or the scale if these are constants */
    const double *constants;  /* coefficients, or NULL if these are parameters */
    int switches_of_joint;    /* how many signs are held */
    int first_switch;         /* among those of all joints */
    const char *const *names; /* of what they are signs */
    void (*switches)(const double *k, const double *u, double *z);
    void (*relaxations)(const double *k, const double *u, const double *s, double *drive,
                        double *rate);
    double (*torque)(const double *k, const double *u, const double *s, const double *x,
                     const double *dx);
    void (*relaxations_tangent)(const double *k, const double *u, const double *s,
                                const double *dk, const double *du, double *drive, double *rate);
    double (*torque_tangent)(const double *k, const double *u, const double *s, const double *x,
                             const double *dx, const double *dk, const double *du,
                             const double *tx, const double *tdx);
}} Joint;

/* Direction along which no coefficient changes. */
static const double no_change[MAX_COEFFICIENTS] = {{0.0}};

{functions}
{names}

{constants}static const Joint joints[JOINTS] = {{
{rows}
}};

#endif
"""
