"""Checks before an export: the coefficients of a law must give a finite torque."""

import sympy

from hesr_model.errors import ExportError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

_MAX_EXPRESSION_LENGTH = 60


def require_numbers(model: FrictionModel) -> None:
    """Reject a model with a law that has no value for any input.

    Only causes in the coefficients are found, such as a division by one that is 0.
    """
    for law, joint in zip(model.laws, model.joints, strict=True):
        part = _find_undefined_part(law)
        if part is not None:
            coefficient_texts = ", ".join(
                f"{quantity.name} = {law.values[quantity.name]:g}"
                for quantity in law.form.coefficients
                if quantity.symbol in part.free_symbols
            )
            raise ExportError(
                f"law '{model.law}' of joint '{joint}' cannot be run: {to_text(part)} in it is not "
                f"finite with {coefficient_texts}."
            )


def require_scale(model: FrictionModel) -> None:
    """Reject a model whose torques are known up to a factor only."""
    joints = [
        joint
        for joint, servo in zip(model.joints, model.servos, strict=False)
        if servo.scale == "none"
    ]
    if joints:
        raise ExportError(
            f"law '{model.law}': nothing fixes the size of the torques of {', '.join(joints)}; "
            "state servo.kp or servo.torque_limit in the robot file and fit again."
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
            "does not support; use the format fmu or drive."
        )
    if model.thermal and not thermal:
        raise ExportError(
            f"law '{model.law}' depends on temperature, which {form} does not support; use "
            "the format fmu, or a model without temperature."
        )
    require_scale(model)
    require_numbers(model)


def find_discretisation(model: FrictionModel) -> str:
    """Return the integration of the states of all joints, "exact" or "euler"; it must be one."""
    discretisations = {law.discretisation for law in model.laws if law.form.relaxations}
    if len(discretisations) > 1:
        raise ExportError(
            f"friction model '{model.law}': its joints use both exact and Euler integration; "
            "expected one for all joints."
        )
    if not discretisations:
        return "exact"
    return discretisations.pop()


def to_text(expression: sympy.Expr) -> str:
    """Return a readable expression, truncated if long."""
    text = str(sympy.sstr(expression)).replace("absolute(", "abs(")
    if len(text) > _MAX_EXPRESSION_LENGTH:
        text = f"{text[:_MAX_EXPRESSION_LENGTH]}..."
    return text


def _find_undefined_part(law: FrictionLaw) -> sympy.Expr | None:
    """Return the first part of a law without a finite value, whatever the inputs are."""
    evaluation = _Evaluation(law)
    expressions: list[sympy.Expr] = []
    for element in law.form.memory:
        expressions += element.parts
    for expression in (*expressions, law.form.output):
        # Parts before the expressions that contain them.
        for part in sympy.postorder_traversal(expression):
            if part in evaluation.values:
                continue
            value = evaluation.evaluate(part)
            if isinstance(part, sympy.Expr) and _is_undefined(value):
                return part
    return None


class _Evaluation:
    """Values of the parts of a law, for its coefficients; inputs and states stay symbols."""

    def __init__(self, law: FrictionLaw) -> None:
        self._coefficients = {
            quantity.symbol: sympy.Float(law.values[quantity.name])
            for quantity in law.form.coefficients
        }
        self.values: dict[sympy.Basic, sympy.Basic] = {}
        # Functions of undefined values get one arbitrary value each.
        self._opaque: dict[tuple[sympy.Basic, ...], sympy.Basic] = {}

    def evaluate(self, part: sympy.Basic) -> sympy.Basic:
        """Return and remember the value of an expression, whose arguments were evaluated before."""
        self.values[part] = self._compute(part)
        return self.values[part]

    def _compute(self, part: sympy.Basic) -> sympy.Basic:
        if not part.args:
            return self._coefficients.get(part, part)
        arguments = [self.values[argument] for argument in part.args]
        has_symbols = not all(argument.is_number for argument in arguments)
        if isinstance(part, sympy.Function) and has_symbols:
            return self._opaque.setdefault((part.func, *arguments), sympy.Dummy(real=True))
        return part.func(*arguments)


def _is_undefined(value: sympy.Basic) -> bool:
    infinite = value.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo)
    return bool(infinite or (value.is_number and value.is_real is False))
