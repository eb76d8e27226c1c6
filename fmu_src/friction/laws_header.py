"""laws.h: the functions of a model's laws in C, and where each joint's variables stand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fmu_src.friction.codegen import switches
from fmu_src.friction.place import exposed, place
from fmu_src.interface import Interface, literal
from hesr_model.friction.functions import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a component needs of the laws.

    Attributes
    ----------
    functions : text of the C functions of a form, given a prefix for their names.
    members : of the C struct of a joint, besides those that every component needs: a function's
        name, `first_switch` or `names`, with the C declaration.
    more : further C.
    """

    functions: Callable[[LawForm, str], str]
    members: Mapping[str, str]
    more: str = ""


def laws_header(
    model: FrictionModel, table: Interface, first: Mapping[str, str], needs: Needs
) -> str:
    """Return laws.h.

    Parameters
    ----------
    model : whose laws they are; each distinct form is written once.
    table : the variables of the component.
    first : name in C of a kind of variable to the name of the first one.
    needs : of the component.
    """
    # C knows no units, in which the forms of joints that turn and that slide differ alone.
    shapes = [law.form.sliding for law in model.laws]
    forms = list(dict.fromkeys(shapes))
    names = {form: f"law_{i}" for i, form in enumerate(forms, start=1)}
    rows, before = [], 0
    for joint, (law, shape) in enumerate(zip(model.laws, shapes, strict=True), start=1):
        cells = _cells(law, joint, table, names[shape], before)
        wanted = [*_COMMON, *needs.members]
        rows.append(f"    {{{', '.join(cells.get(m, f'{names[shape]}_{m}') for m in wanted)}}},")
        before += len(switches(law.form))
    constants = [
        f"static const double constants_{joint}[] = "
        f"{{{', '.join(literal(v) for v in law.values.values())}}};\n"
        for joint, law in enumerate(model.laws, start=1)
        if not exposed(law)
    ]
    texts = [_names(form, name) for form, name in names.items()] if "names" in needs.members else []
    return _LAWS.format(
        places=",\n".join(f"    {name} = {table.references[v]}" for name, v in first.items()),
        joints=len(model.laws),
        inputs=len(INPUTS),
        states=max(1, *(len(form.relaxations) for form in forms)),
        switches=max(1, *(len(switches(form)) for form in forms)),
        coefficients=max(1, *(len(form.coefficients) for form in forms)),
        members="\n".join(f"    {line}" for line in (*_COMMON.values(), *needs.members.values())),
        more=needs.more,
        functions="\n".join(needs.functions(form, name) for form, name in names.items()),
        names="\n".join([*texts, ""]) if texts else "",
        constants="".join(constants),
        rows="\n".join(rows),
    )


def _cells(
    law: FrictionLaw, joint: int, table: Interface, name: str, before: int
) -> dict[str, str]:
    """Return the members of a joint's row that are no functions of its form."""
    own = place(law, joint)
    states = (*own.states, *own.derivatives)
    return {
        "states": str(len(own.states)),
        "first_state": str(table.first(states) if states else 0),
        "first_parameter": str(table.first(own.parameters) if own.parameters else 0),
        "constants": "NULL" if exposed(law) else f"constants_{joint}",
        "switches_of_joint": str(len(switches(law.form))),
        "first_switch": str(before),
        "names": f"{name}_names",
    }


def _names(form: LawForm, name: str) -> str:
    """Return what the held signs are signs of, for messages; C knows no empty arrays."""
    texts = ", ".join(f'"{bend}"' for bend in switches(form))
    return f"static const char *const {name}_names[] = {{{texts or 'NULL'}}};"


_COMMON = {
    "states": "int states;               /* how many; their derivatives follow them */",
    "first_state": "int first_state;          /* among the variables */",
    "first_parameter": "int first_parameter;      "
    "/* coefficients, or the scale if these are constants */",
    "constants": "const double *constants;  /* coefficients, or NULL if these are parameters */",
    "switches_of_joint": "int switches_of_joint;    /* how many signs the law has */",
    "switches": "void (*switches)(const double *k, const double *u, double *z);",
}

_LAWS = """\
/* Generated: the friction laws of the joints. */
#ifndef LAWS_H
#define LAWS_H

#include <stdbool.h>
#include <stddef.h>

#include "law_math.h"

/* Where the first variable of each kind stands; the other joints follow it. */
enum {{
{places},
}};
enum {{ JOINTS = {joints}, INPUTS_OF_JOINT = {inputs} }};
enum {{ MAX_STATES = {states}, MAX_SWITCHES = {switches}, MAX_COEFFICIENTS = {coefficients} }};
enum {{ EXACT = 1, EULER = 2 }}; /* values of the discretisation */

typedef struct {{
{members}
}} Joint;
{more}
{functions}
{names}
{constants}static const Joint joints[JOINTS] = {{
{rows}
}};

#endif
"""
