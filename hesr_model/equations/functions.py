"""Real functions with derivatives almost everywhere, unlike SymPy's, and NumPy counterparts."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy
from sympy.printing.latex import LatexPrinter
from sympy.printing.numpy import NumPyPrinter

_SERIES_BELOW = 1e-3  # argument below which series are exact to double precision, unlike quotients


class _Real(sympy.Function):  # type: ignore[misc] # SymPy is not typed
    """Function of real arguments, evaluated for numbers only."""

    latex_form: ClassVar[str]
    exact: ClassVar[Any] = None

    @classmethod
    def eval(cls, *arguments: sympy.Expr) -> sympy.Expr | None:
        if not all(a.is_number for a in arguments):
            return None
        if cls.exact is not None:
            return cls.exact(*arguments)
        return sympy.Float(float(NUMPY[cls.__name__](*(float(a) for a in arguments))))

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        slopes = _SLOPES.get(type(self).__name__)
        if slopes is None:
            return super().fdiff(argindex)
        return slopes(*self.args)[argindex - 1]

    def _latex(self, printer: LatexPrinter, exp: str | None = None) -> str:
        power = f"^{{{exp}}}" if exp else ""
        text = self.latex_form.format(*(printer.doprint(a) for a in self.args), power=power)
        return text if "{power}" in self.latex_form else text + power


def _define_function(name: str, nargs: int, latex: str, exact: Any = None) -> Any:
    namespace = {"nargs": nargs, "latex_form": latex, "exact": exact, "__module__": __name__}
    metaclass: Any = type(_Real)
    return metaclass(name, (_Real,), namespace)


sgn = _define_function(
    "sgn", 1, r"\operatorname{{sgn}}{power}\left({}\right)", sympy.sign
)  # 0 at 0
absolute = _define_function("absolute", 1, r"\left|{}\right|", sympy.Abs)  # absolute value
positive = _define_function("positive", 1, r"\max\left({}, 0\right)")  # max(x, 0), 0 for NaN
larger = _define_function("larger", 2, r"\max\left({}, {}\right)")  # maximum of two numbers
clip = _define_function("clip", 2, r"\operatorname{{clip}}\left({}, \pm {}\right)")
"""x clipped to -b and b, for b >= 0."""
exceeds = _define_function("exceeds", 2, r"\left[{} > {}\right]")  # 1 if a > b, else 0
over = _define_function("over", 3, r"\left({0}\right) / \left({1}\right)")
"""a / b for b > 0, else the third argument."""
decay = _define_function("decay", 2, r"\left(e^{{-{0}}} - 1\right)")
"""Relative change exp(-z) - 1 of a state over a step, -z by Euler; z = rate * dt, 1 for Euler."""
share = _define_function("share", 3, r"\varphi\left({}\right)")
"""(1 - exp(-z)) / z, continued by 1 at 0; arguments are z, `decay` and 1 for Euler."""
share_slope = _define_function(
    "share_slope", 3, r"\varphi'\left({}\right)"
)  # derivative of `share` by z
cardinal_sine = _define_function("cardinal_sine", 1, r"\operatorname{{sinc}}{power}\left({}\right)")
"""sin(x) / x, continued by 1 at 0: mean of a wave over a step relative to its middle value."""
cardinal_slope = _define_function("cardinal_slope", 1, r"\operatorname{{sinc}}'\left({}\right)")
"""Derivative of `cardinal_sine`."""
_ZERO = sympy.S.Zero
_SLOPES: Mapping[str, Callable[..., tuple[Any, ...]]] = {
    "sgn": lambda _: (_ZERO,),
    "absolute": lambda x: (sgn(x),),
    "positive": lambda x: (exceeds(x, 0),),
    "larger": lambda a, b: (exceeds(a, b), 1 - exceeds(a, b)),
    "clip": lambda x, b: (exceeds(b, absolute(x)), (1 - exceeds(b, absolute(x))) * sgn(x)),
    "exceeds": lambda *_: (_ZERO, _ZERO),
    "over": lambda a, b, _: (over(1, b, 0), -over(over(a, b, 0), b, 0), 1 - exceeds(b, 0)),
    "decay": lambda z, euler: (-1 - (1 - euler) * decay(z, euler), _ZERO),
    "share": lambda *arguments: (share_slope(*arguments), _ZERO, _ZERO),
    "cardinal_sine": lambda x: (cardinal_slope(x),),
}  # derivatives by each argument, almost everywhere


def _cardinal_sine(x: Any) -> Any:
    is_small = np.abs(x) < _SERIES_BELOW
    series = 1.0 - x**2 / 6.0 * (1.0 - x**2 / 20.0)
    return np.where(is_small, series, np.sin(x) / np.where(is_small, 1.0, x))


def _cardinal_slope(x: Any) -> Any:
    is_small = np.abs(x) < _SERIES_BELOW
    series = -x / 3.0 * (1.0 - x**2 / 10.0)
    quotient = (np.cos(x) - _cardinal_sine(x)) / np.where(is_small, 1.0, x)
    return np.where(is_small, series, quotient)


def _share(z: Any, e: Any, euler: Any) -> Any:
    is_small = np.abs(z) < _SERIES_BELOW
    if euler is False and not np.any(is_small):  # most rows of most logs
        return -e / z
    series = 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)))
    return np.where(euler, 1.0, np.where(is_small, series, -e / np.where(is_small, 1.0, z)))


def _share_slope(z: Any, e: Any, euler: Any) -> Any:
    is_small = np.abs(z) < _SERIES_BELOW
    series = -1.0 / 2.0 + z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)))
    quotient = (1.0 + e - _share(z, e, False)) / np.where(is_small, 1.0, z)
    return np.where(euler, 0.0, np.where(is_small, series, quotient))


def _divide_or_default(a: Any, b: Any, otherwise: Any) -> Any:
    is_positive = np.greater(b, 0.0)
    return np.where(is_positive, a / np.where(is_positive, b, 1.0), otherwise)


NUMPY: Mapping[str, Callable[..., Any]] = {
    "sgn": np.sign,
    "absolute": np.abs,
    # np.maximum would propagate NaN.
    "positive": lambda x: np.where(np.greater(x, 0.0), x, 0.0),
    "larger": np.maximum,
    "clip": lambda x, b: np.minimum(np.maximum(x, -b), b),
    "exceeds": lambda a, b: np.where(np.greater(a, b), 1.0, 0.0),
    "over": _divide_or_default,
    "decay": lambda z, euler: np.where(euler, -z, np.expm1(-z)),
    "share": _share,
    "share_slope": _share_slope,
    "cardinal_sine": _cardinal_sine,
    "cardinal_slope": _cardinal_slope,
}  # NumPy functions by name


def _scalar_share(z: float, e: float, euler: float) -> float:
    if euler:
        return 1.0
    if abs(z) < _SERIES_BELOW:
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)))
    return -e / z


def _scalar_cardinal_sine(x: float) -> float:
    if abs(x) < _SERIES_BELOW:
        return 1.0 - x * x / 6.0 * (1.0 - x * x / 20.0)
    return math.sin(x) / x


def _scalar_larger(a: float, b: float) -> float:
    # Like np.maximum, NaN if a or b is.
    if a > b or a != a:
        return a
    return b


def _scalar_clip(x: float, b: float) -> float:
    if x < -b:
        return -b
    if x > b:
        return b
    return x


SCALAR: Mapping[str, Callable[..., float]] = {
    "sgn": lambda x: float((x > 0.0) - (x < 0.0)),
    "absolute": abs,
    "positive": lambda x: x if x > 0.0 else 0.0,
    "larger": _scalar_larger,
    "clip": _scalar_clip,
    "exceeds": lambda a, b: 1.0 if a > b else 0.0,
    "over": lambda a, b, otherwise: a / b if b > 0.0 else otherwise,
    "decay": lambda z, euler: -z if euler else math.expm1(-z),
    "share": _scalar_share,
    "cardinal_sine": _scalar_cardinal_sine,
}  # functions of one number by name, a hundred times as fast as NumPy


def to_numpy_function(arguments: Sequence[sympy.Symbol], expressions: Sequence[sympy.Expr]) -> Any:
    """Return a NumPy function of `arguments` for `expressions`."""
    options = {"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True}
    printer = NumPyPrinter({**options, "user_functions": {name: name for name in NUMPY}})
    # By the name "numpy", SymPy would import all of NumPy, such as its Fortran compiler.
    modules = [dict(NUMPY), vars(np)]
    return sympy.lambdify(
        list(arguments), list(expressions), modules=modules, printer=printer, cse=True
    )
