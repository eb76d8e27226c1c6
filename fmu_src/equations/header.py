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
    counts = [_count(joint.component, joint.gathered, "prepared") for joint in joints]
    return max(1, *counts), _count_lanes(len(joints))


def _count_lanes(joint_count: int) -> int:
    """Return the number of joints, rounded up to whole vectors."""
    length = 2
    if joint_count > 2:
        length = 4
    return -(-joint_count // length) * length


def indicators(joints: Sequence[Joint]) -> int:
    """Return the total number of signs that are held between events."""
    return sum(_count_indicators(Functions(joint.component, "")) for joint in joints)


def _count_indicators(functions: Functions) -> int:
    if not functions.component.events:
        return 0
    return len(functions.jumps.expressions)


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
    functions = _number_components(joints)
    texts, names = _print_functions(functions.values(), calls)
    together = ""
    if steps_together and calls == FRICTION and coupling is None:
        together = _print_joint_lanes(joints, interface, functions[joints[0].component], texts)
    constants = _constants(joints, interface, coupling)
    for name, variable in places.items():
        constants[name] = interface.places[variable]
    if calls[0] == "attempts":
        constants["PREPARED"], constants["LANES"] = prepared_size(joints)
        constants["ALIKE"] = int(len({law_functions[1] for law_functions in names.values()}) == 1)
    if together:
        constants["LANES"] = _count_lanes(len(joints))
    widths = ""
    if together or "attempts" in calls:
        widths = '#include "wide.h"\n'
    arrays, rows = _print_joints(joints, interface, functions, names)
    return _HEADER.format(
        widths=widths,
        constants=",\n".join(f"    {name} = {value}" for name, value in constants.items()),
        members="\n".join(map(_member, calls)),
        functions="\n".join(texts),
        names="\n".join(map(_print_names, functions.values())),
        arrays="\n".join(arrays),
        rows="\n".join(rows),
        coupling=_coupling(coupling, len(joints)),
        together=together,
        each=_print_joint_macro(
            joints, interface, functions, names, calls, coupled=coupling is not None
        ),
    )


def _number_components(joints: Sequence[Joint]) -> dict[Component, Functions]:
    """Return the functions of each distinct component; the first joint that has it counts."""
    functions: dict[Component, Functions] = {}
    for joint in joints:
        if joint.component not in functions:
            functions[joint.component] = Functions(
                joint.component,
                f"law_{len(functions) + 1}",
                tunable=not joint.constants,
                gathered=joint.gathered,
            )
    return functions


def _constants(
    joints: Sequence[Joint], interface: Interface, coupling: Coupling | None
) -> dict[str, int]:
    """Return the constants of equations.h that every component has."""
    first = joints[0].component
    sample_time_place = 0
    if first.sample_time:
        sample_time_place = interface.places[first.sample_time]
    output_names = [equation.name for equation in first.outputs]
    band = 0
    if LOWER in output_names:
        band = output_names.index(LOWER)
    return _sizes(joints) | {
        "DISCRETISATION": -1,
        "START_MODE": -1,
        "SAMPLED": int(bool(first.sample_time)),
        "SAMPLE_TIME_PLACE": sample_time_place,
        "EXACT": 1,
        "EULER": 2,
        "STEADY": 1,
        "HOLDS": int(any(joint.component.holds for joint in joints)),
        "COUPLED": int(coupling is not None),
        "BAND": band,
    }


def _print_joints(
    joints: Sequence[Joint],
    interface: Interface,
    functions: Mapping[Component, Functions],
    names: Mapping[str, Sequence[str]],
) -> tuple[list[str], list[str]]:
    """Return the arrays of all joints, and their rows of the table of joints."""
    arrays = []
    rows = []
    first_switch = 0
    for i, joint in enumerate(joints, start=1):
        printer = functions[joint.component]
        row = [*_row(joint, i, printer, interface, first_switch), *names[printer.name]]
        rows.append(f"    {{{', '.join(row)}}},")
        arrays += _arrays(joint, i, printer, interface)
        first_switch += len(printer.jumps.expressions)
    return arrays, rows


def _print_names(functions: Functions) -> str:
    """Return the names of a component's signs, and its function that refuses parameters."""
    text = _signs(functions)
    if _has_function("refused", functions):
        text += functions.print_refusal()
    return text


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
        reads = []
        for j, quantity in enumerate(printer.gathers):
            read = f"v[{interface.places[joint.names[quantity.name]]}]"
            if coupled:
                read = f"input_of(v, {i}, {j})"
            reads.append(f"u[{j}] = {read}")
        lines.append(f"    DO({', '.join((str(i), *c_names))}, ({', '.join(reads)}))")
    return " \\\n".join(["#define EACH_JOINT(DO)", *lines])


def _print_joint_lanes(
    joints: Sequence[Joint], interface: Interface, functions: Functions, texts: Sequence[str]
) -> str:
    """Return the step of three or more joints with short equal equations, and indices of its lanes.

    Lanes hide latencies; those without a joint repeat the first. Previous values, constants and
    angles are not supported. `texts` are the written functions.
    """
    if not _can_share_lanes(joints, functions, texts):
        return ""
    text = _texts(functions, ("together",))["together"]
    if "far |=" in text:
        return ""
    order = [i if i < len(joints) else 0 for i in range(_count_lanes(len(joints)))]
    padded = [joints[i] for i in order]
    size = _sizes(joints)["MAX_INVARIANTS"]
    indices = {
        "k_at[LANES]": str([_first_place(interface, joint.parameters) for joint in padded]),
        "x_at[LANES]": str([_first_place(interface, joint.states) for joint in padded]),
        "c_at[LANES]": str([size * i for i in order]),
        "u_at[][LANES]": str(_input_places(padded, interface, functions)),
    }
    lines = [
        f"static const ptrdiff_t {name} = {places.translate(_BRACES)};"
        for name, places in indices.items()
        if f"{name[:4]}[" in text
    ]
    return "\n".join([*lines, text, f"#define TOGETHER {functions.name}_together\n"])


def _can_share_lanes(joints: Sequence[Joint], functions: Functions, texts: Iterable[str]) -> bool:
    """Return whether there are three or more joints with the same short, supported equations."""
    component = functions.component
    if len(joints) < 3 or any(joint.component != component for joint in joints):
        return False
    if component.remembered or component.sample_time or component.holds:
        return False
    if functions.gathered or not functions.tunable:
        return False
    # Only short functions are `QUICK`.
    return any(text.startswith(f"QUICK void {functions.name}_step(") for text in texts)


def _first_place(interface: Interface, names: Sequence[str]) -> int:
    """Return the index of the first of consecutive variables, 0 without any."""
    if not names:
        return 0
    return interface.first(names)


def _input_places(
    joints: Sequence[Joint], interface: Interface, functions: Functions
) -> list[list[int]]:
    """Return the indices of the inputs: a row per input, with an entry per joint."""
    rows = []
    for quantity in functions.gathers:
        names = [joint.names[quantity.name] for joint in joints]
        rows.append([interface.places[name] for name in names])
    return rows


_BRACES = str.maketrans("[]", "{}")


def _member(function: str) -> str:
    result = "void"
    if "LANES(" in SIGNATURES[function]:
        result = "bool"
    return f"    {result} (*{function})({declare_arguments(SIGNATURES[function])});"


def _print_functions(
    components: Iterable[Functions], calls: Sequence[str]
) -> tuple[list[str], dict[str, list[str]]]:
    """Return the texts of the functions, and the names of `refused` and of `calls` by component."""
    texts: dict[str, str] = {}
    by_body: dict[str, str] = {}
    names: dict[str, list[str]] = {}
    for functions in components:
        c_functions = _texts(functions, calls)
        for function, text in c_functions.items():
            name = f"{functions.name}_{function}"
            # A function with the same body as one before serves both components.
            c_functions[function] = by_body.setdefault(text.replace(name, "", 1), name)
            if c_functions[function] == name:
                texts[name] = text
        refused = "NULL"
        if _has_function("refused", functions):
            refused = f"{functions.name}_refused"
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
    forward = np.eye(joints)
    backward = np.eye(joints)
    if coupling is not None:
        forward = coupling.forward
        backward = coupling.backward
    lines = []
    for name, matrix in (("forward", forward), ("backward", backward)):
        lines.append(f"static const double {name}[JOINTS][JOINTS] = {{")
        lines += [f"    {{{', '.join(map(literal, row))}}}," for row in matrix.tolist()]
        lines.append("};")
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
    count = len(component.inputs) + len(component.shared)
    if joint.gathered:
        count += len(component.parameters)
    return count


def _row(
    joint: Joint, i: int, functions: Functions, interface: Interface, first_switch: int
) -> list[str]:
    """Return the first members of a row of the table of joints, as in its type `Joint`."""
    component = joint.component
    constants = "NULL"
    if joint.constants:
        constants = f"constants_{i}"
    slope = -1
    if joint.slope:
        slope = interface.places[joint.slope]
    row = (
        *(len(functions.gathers), f"inputs_{i}", len(component.outputs), f"outputs_{i}"),
        len(component.memory),
        _first_place(interface, (*joint.states, *joint.derivatives)),
        _first_place(interface, joint.starts),
        *(len(component.parameters), _first_place(interface, joint.parameters), constants),
        *(len(component.remembered), slope),
        *(len(functions.jumps.expressions), _count_indicators(functions), first_switch),
        f"{functions.name}_names",
    )
    return list(map(str, row))


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
