"""Friction laws: memory and an output map as SymPy expressions.

    x_i' = b_i - r_i x_i                    relaxations: drive b, rate r >= 0
    x_i+ = clip(x_i + v dt / w_i, -s_i, s_i)    stops: deflection w, bound s >= 0
    tau  = f(v, x, x', u)

v is the joint velocity, u are the other inputs (`inputs.INPUTS`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import Any

import sympy

from hesr_model.equations.component import Component, Equation, Quantity
from hesr_model.equations.functions import absolute, clip
from hesr_model.equations.low_pass import build_low_pass
from hesr_model.equations.memory import (
    DT,
    Discretisation,
    Element,
    MemoryElement,
    Relaxation,
    Stop,
    find_read_symbols,
    to_expression,
)
from hesr_model.errors import ArtifactError
from hesr_model.friction.band import Band
from hesr_model.friction.expressions import (
    INTERVAL,
    CoefficientRow,
    LawExpressions,
    format_latex,
)
from hesr_model.friction.inputs import DQ, MOVING, QUANTITIES, TORQUE
from hesr_model.inference.covariance import Covariance
from hesr_model.units import unit_of_joint


def build_settling(steady_speed: float) -> sympy.Expr:
    """Return the share of the steady state in a start: 0 at rest, 1 from `steady_speed` on."""
    speed = clip(absolute(DQ) / sympy.Float(steady_speed), 1)
    return speed**2 * (3 - 2 * speed)


SETTLING = build_settling(MOVING)  # of joints of usual speed

_MAX_COEFFICIENT = 1e100  # largest allowed coefficient; a product of three stays finite


@dataclass(frozen=True, kw_only=True)
class Coefficient(Quantity):
    """Constant of a law; ArtifactError without a name or unit.

    Attributes
    ----------
    name : letters, digits and underscores, the symbol in expressions.
    unit : SI unit as text, such as "N.m.s/rad" or "1".
    description : what it is, for tables and FMUs.
    """

    unit: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ArtifactError(
                f"coefficient '{self.name}': 'name' must be letters, digits and underscores.",
                code="law.class.name",
                key="name",
            )
        if not self.unit:
            raise ArtifactError(
                f"coefficient '{self.name}' has no 'unit'; give it in SI, such as 'N.m' or "
                "'rad/s', or '1' for a pure number.",
                code="law.class.unit",
                key=f"{self.name}.unit",
            )


@dataclass(frozen=True, kw_only=True)
class LawForm:
    """Expressions of a law, without numbers; ArtifactError for unknown or repeated symbols.

    Attributes
    ----------
    coefficients : constants, in the order of tables and FMUs.
    memory : states, each of which may use earlier ones.
    output : friction torque [N.m] or force [N] of one joint.
    steady_speed : a motion that starts at this speed [rad/s, m/s] or faster starts in the steady
        state; at rest the history is unknown. Slow joints have a lower one.
    """

    coefficients: tuple[Coefficient, ...]
    memory: tuple[Element, ...] = ()
    output: sympy.Expr
    steady_speed: float = MOVING

    def __post_init__(self) -> None:
        if not (isfinite(self.steady_speed) and self.steady_speed > 0.0):
            raise ArtifactError(
                f"friction law: the speed of a steady start is {self.steady_speed}; expected a "
                "positive number.",
                code="law.steady_speed",
                key="steady_speed",
            )
        self._require_kinds()
        self._require_known_symbols()
        try:
            self.component  # noqa: B018 - raises what is wrong
        except ArtifactError as error:
            reason = str(error).removeprefix("equations: ")
            raise ArtifactError(
                f"friction law: {reason}", code=error.code, key=error.key
            ) from error

    def _require_kinds(self) -> None:
        """Raise ArtifactError for attributes of other kinds or shapes."""
        coefficients = _require_items("coefficients", self.coefficients, Quantity, "Coefficient")
        memory = _require_items("memory", self.memory, MemoryElement, "Relaxation or Stop")
        object.__setattr__(self, "coefficients", coefficients)
        object.__setattr__(self, "memory", memory)
        object.__setattr__(self, "output", to_expression("friction law", "output", self.output))

    def _require_known_symbols(self) -> None:
        """Raise ArtifactError for a symbol that only looks like one of the law."""
        known_symbols = {quantity.symbol for quantity in (*QUANTITIES, *self.coefficients)} | {DT}
        for element in self.memory:
            known_symbols |= {element.state, element.derivative}
        known_names = {str(symbol) for symbol in known_symbols}
        parts: dict[str, tuple[sympy.Expr, ...]] = {"output": (self.output,)}
        parts |= {f"memory.{element.name}": element.parts for element in self.memory}
        for attribute, expressions in parts.items():
            symbols = sympy.Tuple(*expressions).free_symbols
            for symbol in sorted(symbols - known_symbols, key=str):
                if str(symbol) in known_names:
                    remedy = (
                        "is another symbol than that of its quantity; use the 'symbol' of a "
                        "coefficient, the 'state' of a memory, or DQ, Q and TAU_LOAD"
                    )
                else:
                    remedy = (
                        "is neither an input, a coefficient nor a state; add it to 'coefficients'"
                    )
                raise ArtifactError(
                    f"friction law: symbol '{symbol}' of '{attribute}' {remedy}.",
                    code="law.class.symbol",
                    key=attribute,
                )

    @cached_property
    def component(self) -> Component:
        """Equations of a joint with this law."""
        torque = Equation(
            name=TORQUE,
            unit="N.m",
            description="friction {effort} of {joint}, delivered by the drive; a plant "
            "subtracts it",
            expression=sympy.S.Zero + self.output,
            output=True,
        )
        return Component(
            inputs=QUANTITIES,
            parameters=self.coefficients,
            memory=self.memory,
            equations=(torque,),
            reversing=(DQ,),
            settling=build_settling(self.steady_speed),
        )

    @property
    def relaxations(self) -> tuple[Relaxation, ...]:
        """Relaxations of the memory."""
        return tuple(element for element in self.memory if isinstance(element, Relaxation))

    @property
    def stops(self) -> tuple[Stop, ...]:
        """Stops of the memory."""
        return tuple(element for element in self.memory if isinstance(element, Stop))

    @cached_property
    def inputs(self) -> tuple[sympy.Symbol, ...]:
        """Inputs that the law uses, in the order of `INPUTS`."""
        read_symbols = self.output.free_symbols | find_read_symbols(self.memory)
        return tuple(quantity.symbol for quantity in QUANTITIES if quantity.symbol in read_symbols)

    @cached_property
    def sliding(self) -> "LawForm":
        """The same equations in the units of a prismatic joint."""
        coefficients = []
        for quantity in self.coefficients:
            unit = unit_of_joint(quantity.unit, is_prismatic=True)
            coefficients.append(replace(quantity, unit=unit))
        memory = []
        for element in self.memory:
            unit = unit_of_joint(element.unit, is_prismatic=True)
            memory.append(replace(element, unit=unit))
        return replace(self, coefficients=tuple(coefficients), memory=tuple(memory))


def _require_items(attribute: str, items: object, kind: type, expected: str) -> tuple[Any, ...]:
    """Return the items of an attribute as a tuple; ArtifactError if one is of another kind."""
    if isinstance(items, tuple | list):
        wrong_items = [item for item in items if not isinstance(item, kind)]
        if not wrong_items:
            return tuple(items)
        wrong_kind = type(wrong_items[0]).__name__
    else:
        wrong_kind = type(items).__name__
    raise ArtifactError(
        f"friction law: '{attribute}' is or contains {wrong_kind}; expected a tuple of {expected}.",
        code="law.class.kind",
        key=attribute,
    )


@dataclass(frozen=True, kw_only=True)
class FrictionLaw:
    """Frozen law of one joint; ArtifactError if values are missing, unknown or not finite.

    Attributes
    ----------
    name, structure : law in the registry, and JSON data that select one form of
        its family.
    values : value of every coefficient of `form`, in its order and unit.
    discretisation : "exact" integrates each relaxation exactly for inputs held
        over a step; "euler" is eq. 10 and requires 0 <= rate * dt < 1.
    start : initial states at rest, zero by default; in motion they are steady
        (`SETTLING`).
    start_samples : first torques of a log that can replace the start
        (`predict.record_start`).
    """

    name: str
    structure: Mapping[str, Any] = field(default_factory=dict)
    form: LawForm
    values: Mapping[str, float]
    discretisation: Discretisation = "exact"
    start: tuple[float, ...] = ()
    start_samples: int = 0
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    covariance: Covariance | None = None
    band: Band | None = None

    def __post_init__(self) -> None:
        coefficient_names = [quantity.name for quantity in self.form.coefficients]
        missing_names = sorted(set(coefficient_names) - set(self.values))
        unknown_names = sorted(set(self.values) - set(coefficient_names))
        if missing_names or unknown_names:
            # A mistyped name is both missing and unknown.
            defects = [f"'{name}' is missing" for name in missing_names[:1]]
            defects += [f"'{name}' is unknown" for name in unknown_names[:1]]
            wrong_name = sorted([*missing_names, *unknown_names])[0]
            raise ArtifactError(
                f"law '{self.name}': coefficient {' and '.join(defects)}; expected "
                f"{', '.join(coefficient_names)}.",
                code="law.coefficient",
                key=f"coefficients.{wrong_name}",
            )
        object.__setattr__(
            self, "values", {name: float(self.values[name]) for name in coefficient_names}
        )
        for name, value in self.values.items():
            self._require_number(f"coefficient '{name}'", value, f"coefficients.{name}")
        if not self.start:
            object.__setattr__(self, "start", (0.0,) * len(self.form.memory))
        if len(self.start) != len(self.form.memory):
            raise ArtifactError(
                f"law '{self.name}': {len(self.start)} start values for "
                f"{len(self.form.memory)} states.",
                code="law.start",
                key="start",
            )
        for element, value in zip(self.form.memory, self.start, strict=True):
            self._require_number(f"start value of '{element.name}'", value, "start")

    def __repr__(self) -> str:
        return f"FrictionLaw('{self.name}', {len(self.values)} coefficients)"

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def equation(self) -> str:
        """Return torque, derivatives x' and moved stops x+ as text, one a line, to four digits."""
        return "\n".join(equations(self))

    def latex(self) -> str:
        """Return the equations in LaTeX, aligned, to four digits."""
        return format_latex(self.form.output, self.form.memory, _round_values(self))

    def coefficient_rows(self, joint: str) -> tuple[CoefficientRow, ...]:
        """Return the table of coefficients, with the name of the joint."""
        held_names = find_held(self)
        rows = []
        for quantity in self.form.coefficients:
            value = self.values[quantity.name]
            error = self.standard_errors.get(quantity.name)
            lower = None
            upper = None
            if error is not None:
                lower = value - INTERVAL * error
                upper = value + INTERVAL * error
            rows.append(
                CoefficientRow(
                    joint=joint,
                    name=quantity.name,
                    value=value,
                    unit=quantity.unit,
                    standard_error=error,
                    lower=lower,
                    upper=upper,
                    at_bound=quantity.name in held_names,
                    description=quantity.description,
                )
            )
        return tuple(rows)

    def to_expressions(self) -> LawExpressions:
        """Return the equations as SymPy expressions with named symbols, values and units."""
        units = {quantity.symbol: quantity.unit for quantity in QUANTITIES}
        units |= {quantity.symbol: quantity.unit for quantity in self.form.coefficients}
        units |= {element.state: element.unit for element in self.form.memory}
        derivatives = {element.state: element.express_derivative() for element in self.form.memory}
        values = {
            quantity.symbol: self.values[quantity.name] for quantity in self.form.coefficients
        }
        return LawExpressions(
            torque=self.form.output, derivatives=derivatives, values=values, units=units
        )

    def _require_number(self, label: str, value: float, key: str) -> None:
        if not isfinite(value):
            raise ArtifactError(
                f"law '{self.name}': {label} is {value}.", code="law.number", key=key
            )
        if abs(value) > _MAX_COEFFICIENT:
            raise ArtifactError(
                f"law '{self.name}': {label} is {value:g}; numbers up to {_MAX_COEFFICIENT:g} "
                "can be used.",
                code="law.too_large",
                key=key,
            )


def add_low_pass(law: FrictionLaw, cutoff: float) -> FrictionLaw:
    """Return a law whose velocity passes a causal low pass with a cutoff [Hz]; not for files."""
    speed = build_low_pass(DQ, cutoff, "rad/s")
    replacements = {DQ: speed.state}
    memory = [element.subs(replacements) for element in law.form.memory]
    output = law.form.output.xreplace(replacements)
    form = replace(law.form, memory=(speed, *memory), output=output)
    return replace(law, form=form, start=(0.0, *law.start))


_DIGITS = 4


def equations(law: FrictionLaw) -> list[str]:
    """Return torque, derivatives x' and moved stops x+ of a law as text, to four digits."""
    return form_lines(law.form, _round_values(law))


def _round_values(law: FrictionLaw) -> dict[sympy.Symbol, sympy.Expr]:
    """Return the values of coefficients by symbol, to four digits."""
    return {
        quantity.symbol: sympy.Float(f"{law.values[quantity.name]:.{_DIGITS}g}", _DIGITS)
        for quantity in law.form.coefficients
    }


def form_lines(form: LawForm, numbers: dict[sympy.Symbol, sympy.Expr] | None = None) -> list[str]:
    """Return the lines of a form, coefficients without numbers by name."""
    names = {element.derivative: sympy.Symbol(f"{element.name}'") for element in form.memory}

    def format_part(expression: sympy.Expr) -> str:
        return format_expression(expression.xreplace(numbers or {}).xreplace(names))

    lines = [f"tau = {format_part(form.output)}"]
    for element in form.memory:
        first, second = (format_part(part) for part in element.parts)
        if isinstance(element, Relaxation):
            lines.append(f"{element.name}' = {first} - ({second})*{element.name}")
        else:
            lines.append(f"{element.name}+ = clip({element.name} + ({first})*{DT}, {second})")
    return lines


def format_expression(expression: sympy.Expr) -> str:
    """Return an expression as text, numbers to four digits."""
    rounded = expression.xreplace(
        {number: sympy.Float(number, _DIGITS) for number in expression.atoms(sympy.Float)}
    )
    return str(sympy.sstr(rounded)).replace("absolute(", "abs(")


def coefficient_lines(law: FrictionLaw) -> list[str]:
    """Return each coefficient with unit and, if known, 95 % interval; held ones are marked."""
    held_names = find_held(law)
    lines = []
    for quantity in law.form.coefficients:
        error = law.standard_errors.get(quantity.name)
        interval = "" if error is None else f" +- {1.96 * error:.2g}"
        unit = "" if quantity.unit == "1" else f" {quantity.unit}"
        mark = " (held)" if quantity.name in held_names else ""
        lines.append(f"{quantity.name} = {law.values[quantity.name]:.5g}{interval}{unit}{mark}")
    return lines


def find_held(law: FrictionLaw) -> tuple[str, ...]:
    """Return the coefficients at a bound of the search, on which all intervals are conditional.

    Empty for a law without intervals: a chosen structure, or unknown errors.
    """
    if not law.standard_errors:
        return ()
    return tuple(name for name in law.values if name not in law.standard_errors)
