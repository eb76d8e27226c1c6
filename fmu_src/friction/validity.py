"""Checks before an export: the coefficients of a law must give a finite torque."""

import sympy

from hesr_model.errors import ExportError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

_LONGEST = 60


def require_numbers(model: FrictionModel) -> None:
    """Reject a model with a law that has no value for any input.

    Only causes in the coefficients are found, such as a division by one that is 0.
    """
    for law, joint in zip(model.laws, model.joints, strict=True):
        part = _undefined(law)
        if part is not None:
            at = ", ".join(
                f"{quantity.name} = {law.values[quantity.name]:g}"
                for quantity in law.form.coefficients
                if quantity.symbol in part.free_symbols
            )
            raise ExportError(
                f"law '{model.law}' of joint '{joint}' cannot be run: {shown(part)} in it is not "
                f"finite with {at}."
            )


def require_exportable(
    model: FrictionModel, form: str, *, coupled: bool = True, thermal: bool = False
) -> None:
    """Reject a model that `form`, another format than an FMU, cannot express.

    `coupled` formats support coupled motors, `thermal` ones temperature.
    """
    if model.coupling and not coupled:
        raise ExportError(
            f"law '{model.law}': motors of '{model.robot}' turn with several joints, which {form} "
            "does not support; use --format fmu or drive."
        )
    if model.thermal and not thermal:
        raise ExportError(
            f"law '{model.law}' depends on temperature, which {form} does not support; use "
            "--format fmu, or a model without temperature."
        )
    require_numbers(model)


def discretisation_of(model: FrictionModel) -> str:
    """Return the integration of the states of all joints, "exact" or "euler"; it must be one."""
    found = {law.discretisation for law in model.laws if law.form.relaxations}
    if len(found) > 1:
        raise ExportError(
            f"friction model '{model.law}': its joints use both exact and Euler integration; "
            "expected one for all joints."
        )
    return found.pop() if found else "exact"


def shown(expression: sympy.Expr) -> str:
    """Return a readable expression, truncated if long."""
    text = str(sympy.sstr(expression)).replace("absolute(", "abs(")
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _undefined(law: FrictionLaw) -> sympy.Expr | None:
    values = {
        quantity.symbol: sympy.Float(law.values[quantity.name])
        for quantity in law.form.coefficients
    }
    known: dict[sympy.Basic, sympy.Basic] = {}
    # Functions of undefined values get one arbitrary value each.
    opaque: dict[tuple[sympy.Basic, ...], sympy.Basic] = {}
    form = law.form
    for whole in (*(part for element in form.memory for part in element.parts), form.output):
        # Parts before the expressions that contain them.
        for part in sympy.postorder_traversal(whole):
            if part not in known:
                arguments = tuple(known[argument] for argument in part.args)
                if isinstance(part, sympy.Function) and not all(a.is_number for a in arguments):
                    known[part] = opaque.setdefault((part.func, *arguments), sympy.Dummy(real=True))
                else:
                    known[part] = part.func(*arguments) if part.args else values.get(part, part)
                if isinstance(part, sympy.Expr) and _no_number(known[part]):
                    return part
    return None


def _no_number(value: sympy.Basic) -> bool:
    infinite = value.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo)
    return bool(infinite or (value.is_number and value.is_real is False))
