"""equations.h: C functions of a component's equations, and the indices of its variables."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from fmu_src.equations.c_functions import SIGNATURES, Functions
from fmu_src.equations.c_printer import declare_arguments
from fmu_src.export.cache import software
from fmu_src.export.interface import Interface, literal
from hesr_model.equations.component import Component
from hesr_model.friction.band import LOWER
from hesr_model.robots.transmission import Coupling
from hesr_model.support.cache import compute_once


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One joint of an FMU: its equations and the names of their variables.

    Those of states, derivatives, starts and parameters are consecutive. Parameters are variables,
    `constants`, or in `names`. `slope` is that of the first output over the first input.
    """

    component: Component
    names: Mapping[str, str]
    states: tuple[str, ...] = ()
    derivatives: tuple[str, ...] = ()
    starts: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    constants: tuple[float, ...] = ()
    slope: str = ""

    @property
    def gathered(self) -> bool:
        """Whether the parameters are gathered from arbitrary variables."""
        return bool(self.component.parameters) and not self.parameters and not self.constants


FRICTION = (
    *("switches", "rates", "read", "invariants", "step", "start"),
    *("begin", "begin_tangent", "tangent", "follow"),
)
"""Functions called by equations.c."""

SOLVER = ("rates", "begin", "attempt", "solved_derivatives")
"""Functions called by a solver inside an FMU."""

SOLVER_OF_ALL = ("attempts", "prepare", "attempt", "begin", "begin_tangent", "flow", "flow_tangent")
"""Functions called by a solver for all joints."""


def memory_size(joints: Sequence[Joint]) -> int:
    """Return the number of doubles in the own memory of equations.c."""
    sizes = _sizes(joints)
    array_names = ("INPUTS", "STATES", "REMEMBERED", "REMEMBERED", "INVARIANTS")
    joint_size = sum(sizes[f"MAX_{name}"] for name in array_names)
    signs = sum(len(Functions(joint.component, "").jumps.expressions) for joint in joints)
    return sizes["OWN_FIXED"] + len(joints) * joint_size + signs


def prepared_size(joints: Sequence[Joint]) -> tuple[int, int]:
    """Return the shape of a solver's memory for arguments of laws, in whole vectors of 2 or 4."""
    prepared_count = max(
        1, *(_count(joint.component, joint.gathered, "prepared") for joint in joints)
    )
    return prepared_count, _lanes(len(joints))


def _lanes(joints: int) -> int:
    length = 4 if joints > 2 else 2
    return -(-joints // length) * length


def indicators(joints: Sequence[Joint]) -> int:
    """Return the total number of signs that are held between events."""
    return sum(_count_indicators(Functions(joint.component, "")) for joint in joints)


def _count_indicators(functions: Functions) -> int:
    return len(functions.jumps.expressions) if functions.component.events else 0


def equations_header(
    joints: Sequence[Joint],
    interface: Interface,
    places: Mapping[str, str],
    *,
    calls: Sequence[str] = FRICTION,
    coupling: Coupling | None = None,
    steps_together: bool = True,
) -> str:
    """Return equations.h, with each distinct component written once.

    `places` has the variables of further C constants, `calls` the functions that a C file calls. A
    coupling maps the joints to the coordinates of the equations. `steps_together` is whether the C
    file steps equal joints at once.
    """
    distinct = list(dict.fromkeys(j.component for j in joints))
    first = {j.component: j for j in reversed(joints)}
    functions = {
        component: Functions(
            component,
            f"law_{i}",
            tunable=not first[component].constants,
            gathered=first[component].gathered,
        )
        for i, component in enumerate(distinct, start=1)
    }
    texts, names = _print_functions(functions.values(), calls)
    arrays = []
    rows = []
    before = 0
    for i, joint in enumerate(joints, start=1):
        printer = functions[joint.component]
        rows.append(
            f"    {{{', '.join(_row(joint, i, printer, interface, before, names[printer.name]))}}},"
        )
        arrays += _arrays(joint, i, printer, interface)
        before += len(printer.jumps.expressions)
    together = ""
    if steps_together and calls == FRICTION and coupling is None:
        together = _print_joint_lanes(joints, interface, functions[joints[0].component], texts)
    sample_time = joints[0].component.sample_time
    constants = _sizes(joints) | {
        "DISCRETISATION": -1,
        "START_MODE": -1,
        "SAMPLED": int(bool(sample_time)),
        "SAMPLE_TIME_PLACE": interface.places[sample_time] if sample_time else 0,
        "EXACT": 1,
        "EULER": 2,
        "STEADY": 1,
        "HOLDS": int(any(j.component.holds for j in joints)),
        "COUPLED": int(coupling is not None),
        "BAND": next(
            (k for k, equation in enumerate(joints[0].component.outputs) if equation.name == LOWER),
            0,
        ),
        **{name: interface.places[variable] for name, variable in places.items()},
    }
    if calls[0] == "attempts":
        constants["PREPARED"], constants["LANES"] = prepared_size(joints)
        constants["ALIKE"] = int(len({law_functions[1] for law_functions in names.values()}) == 1)
    if together:
        constants["LANES"] = _lanes(len(joints))
    return _HEADER.format(
        widths='#include "wide.h"\n' if together or "attempts" in calls else "",
        constants=",\n".join(f"    {name} = {value}" for name, value in constants.items()),
        members="\n".join(map(_member, calls)),
        functions="\n".join(texts),
        names="\n".join(
            _signs(f) + (f.print_refusal() if _has_function("refused", f) else "")
            for f in functions.values()
        ),
        arrays="\n".join(arrays),
        rows="\n".join(rows),
        coupling=_coupling(coupling, len(joints)),
        together=together,
        each=_print_joint_macro(
            joints, interface, functions, names, calls, coupled=coupling is not None
        ),
    )


def _print_joint_macro(
    joints: Sequence[Joint],
    interface: Interface,
    functions: Mapping[Component, Functions],
    names: Mapping[str, Sequence[str]],
    calls: Sequence[str],
    *,
    coupled: bool,
) -> str:
    """Return the macro that repeats code for each joint, with its functions and its inputs."""
    lines = []
    for i, joint in enumerate(joints):
        printer = functions[joint.component]
        c_names = [
            names[printer.name][1 + calls.index(n)] for n in ("step", "switches") if n in calls
        ]
        places = (interface.places[joint.names[quantity.name]] for quantity in printer.gathers)
        reads = (f"input_of(v, {i}, {j})" if coupled else f"v[{k}]" for j, k in enumerate(places))
        gather = ", ".join(f"u[{j}] = {read}" for j, read in enumerate(reads))
        lines.append(f"    DO({', '.join((str(i), *c_names))}, ({gather}))")
    return " \\\n".join(["#define EACH_JOINT(DO)", *lines])


def _print_joint_lanes(
    joints: Sequence[Joint], interface: Interface, functions: Functions, texts: Sequence[str]
) -> str:
    """Return the step of three or more joints with short equal equations, and indices of its lanes.

    Lanes hide latencies; those without a joint repeat the first. Previous values, constants and
    angles are not supported. `texts` are the written functions.
    """
    component = functions.component
    holds = component.remembered or component.sample_time or component.holds
    alike = len(joints) > 2 and all(joint.component == component for joint in joints)
    if not alike or holds or functions.gathered or not functions.tunable:
        return ""
    if not any(text.startswith(f"QUICK void {functions.name}_step(") for text in texts):
        return ""
    text = _texts(functions, ("together",))["together"]
    if "far |=" in text:
        return ""
    order = [i if i < len(joints) else 0 for i in range(_lanes(len(joints)))]
    padded = [joints[i] for i in order]
    size = _sizes(joints)["MAX_INVARIANTS"]
    reads = (
        [interface.places[joint.names[quantity.name]] for joint in padded]
        for quantity in functions.gathers
    )
    indices = {
        "k_at[LANES]": [
            interface.first(joint.parameters) if joint.parameters else 0 for joint in padded
        ],
        "x_at[LANES]": [interface.first(joint.states) if joint.states else 0 for joint in padded],
        "c_at[LANES]": [size * i for i in order],
        "u_at[][LANES]": list(reads),
    }
    lines = [
        f"static const ptrdiff_t {name} = {str(places).translate(_BRACES)};"
        for name, places in indices.items()
        if f"{name[:4]}[" in text
    ]
    return "\n".join([*lines, text, f"#define TOGETHER {functions.name}_together\n"])


_BRACES = str.maketrans("[]", "{}")


def _member(function: str) -> str:
    kind = "bool" if "LANES(" in SIGNATURES[function] else "void"
    return f"    {kind} (*{function})({declare_arguments(SIGNATURES[function])});"


def _print_functions(
    components: Iterable[Functions], calls: Sequence[str]
) -> tuple[list[str], dict[str, list[str]]]:
    texts: dict[str, str] = {}
    by_body: dict[str, str] = {}
    names: dict[str, list[str]] = {}
    for functions in components:
        c_functions = _texts(functions, calls)
        for function, text in c_functions.items():
            name = f"{functions.name}_{function}"
            c_functions[function] = by_body.setdefault(text.replace(name, "", 1), name)
            if c_functions[function] == name:
                texts[name] = text
        refused = f"{functions.name}_refused" if _has_function("refused", functions) else "NULL"
        names[functions.name] = [refused, *(c_functions.get(n, "NULL") for n in calls)]
    return list(texts.values()), names


def _texts(functions: Functions, needed: Sequence[str]) -> dict[str, str]:
    calls = [name for name in needed if _has_function(name, functions)]
    component_key = (
        functions.name,
        f"{functions.tunable} {functions.gathered}",
        repr(functions.component),
    )
    encoded_texts = compute_once(
        "functions",
        (software(), *calls, *component_key),
        lambda: json.dumps([getattr(functions, name)() for name in calls]).encode(),
    )
    return dict(zip(calls, json.loads(encoded_texts), strict=True))


def _coupling(coupling: Coupling | None, joints: int) -> str:
    lines = []
    for name in ("forward", "backward"):
        matrix = getattr(coupling, name) if coupling else np.eye(joints)
        rows = (f"    {{{', '.join(literal(float(x)) for x in row)}}}," for row in matrix)
        lines += [f"static const double {name}[JOINTS][JOINTS] = {{", *rows, "};"]
    return "\n".join(lines)


def _sizes(joints: Sequence[Joint]) -> dict[str, int]:
    def find_maximum(count: Callable[[Component], int]) -> int:
        return max([1, *(count(joint.component) for joint in joints)])

    return {
        "JOINTS": len(joints),
        "OWN_FIXED": 5,
        "MAX_INPUTS": max(1, *(_count_inputs(joint) for joint in joints)),
        "MAX_STATES": find_maximum(lambda component: len(component.memory)),
        "MAX_OUTPUTS": find_maximum(lambda component: len(component.outputs)),
        "MAX_REMEMBERED": max(len(joint.component.remembered) for joint in joints),
        "MAX_INVARIANTS": max(
            _count(joint.component, joint.gathered, "invariant") for joint in joints
        ),
        "MAX_SWITCHES": find_maximum(
            lambda component: len(Functions(component, "").jumps.expressions)
        ),
        "MAX_PARAMETERS": find_maximum(lambda component: len(component.parameters)),
    }


@cache
def _count(component: Component, gathered: bool, name: str) -> int:
    count = compute_once(
        "functions",
        (software(), name, str(gathered), repr(component)),
        lambda: str(len(getattr(Functions(component, "", gathered=gathered), name))).encode(),
    )
    return int(count)


def _count_inputs(joint: Joint) -> int:
    component = joint.component
    return (
        len(component.inputs)
        + len(component.shared)
        + (len(component.parameters) if joint.gathered else 0)
    )


def _row(
    joint: Joint,
    i: int,
    functions: Functions,
    interface: Interface,
    before: int,
    names: Sequence[str],
) -> list[str]:
    component = joint.component
    first_state, first_start, first_parameter = (
        interface.first(variables) if variables else 0
        for variables in ((*joint.states, *joint.derivatives), joint.starts, joint.parameters)
    )
    row = (
        *(len(functions.gathers), f"inputs_{i}", len(component.outputs), f"outputs_{i}"),
        *(len(component.memory), first_state, first_start),
        *(len(component.parameters), first_parameter),
        f"constants_{i}" if joint.constants else "NULL",
        len(component.remembered),
        interface.places[joint.slope] if joint.slope else -1,
        *(
            len(functions.jumps.expressions),
            _count_indicators(functions),
            before,
            f"{functions.name}_names",
        ),
    )
    return [*map(str, row), *names]


def _has_function(function: str, functions: Functions) -> bool:
    if function in ("rates", "follow", "tangent"):
        return not functions.component.sampled_memory
    if function == "start":
        return bool(functions.component.remembered)
    return function != "refused" or bool(functions.component.requirements)


def _arrays(joint: Joint, i: int, functions: Functions, interface: Interface) -> list[str]:
    reads = [interface.places[joint.names[quantity.name]] for quantity in functions.gathers]
    writes = [interface.places[joint.names[equation.name]] for equation in joint.component.outputs]
    lines = [_array("int", f"inputs_{i}", reads), _array("int", f"outputs_{i}", writes)]
    if joint.constants:
        lines.append(_array("double", f"constants_{i}", map(literal, joint.constants)))
    return lines


def _array(kind: str, name: str, values: Iterable[object]) -> str:
    return f"static const {kind} {name}[] = {{{', '.join(map(str, values))}}};"


def _signs(functions: Functions) -> str:
    names = ", ".join(f'"{e}"' for e in functions.jumps.expressions)
    return f"static const char *const {functions.name}_names[] = {{{names or 'NULL'}}};\n"


_HEADER = """\
/* Generated: equations of the joints, and indices of their variables. */
#ifndef EQUATIONS_H
#define EQUATIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "law_math.h"
{widths}
enum {{
{constants},
}};

typedef struct {{
    int inputs; /* shared parameters behind them */
    const int *input;
    int outputs;
    const int *output;
    int states;      /* their derivatives follow them */
    int first_state; /* among the variables */
    int first_start; /* the states' start values */
    int parameters;
    int first_parameter;
    const double *constants; /* parameters, or NULL if these are variables */
    int remembered;
    int slope; /* of the first output over the first input, or -1 */
    int switches_of_joint; /* number of signs whose changes are events */
    int held;              /* number of those with indicators: all, or 0 */
    int first_switch;      /* among those of all joints */
    const char *const *names; /* of the arguments of the signs */
    int (*refused)(const double *u, const char **needed);
{members}
}} Joint;

{functions}
{names}
{arrays}

static const Joint joints[JOINTS] = {{
{rows}
}};

/* Repeats code for each joint with its functions and the assignment of its inputs. */
{each}
{together}
/* If COUPLED: coordinates of the equations from motions of the joints, and torques. */
{coupling}

#endif
"""
