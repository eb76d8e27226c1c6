"""Signatures of public names for readers: types in a few words, one parameter a line if long.

The types are for reading only; annotations stay as they are.
"""

import inspect
import re
from collections.abc import Mapping
from os import PathLike
from types import FunctionType, NoneType, UnionType
from typing import Annotated, Any, ForwardRef, Literal, Self, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

_WIDTH = 76  # of a line of `help()` within an indent of 4

_ONE = {
    "PathArg": "path",
    "RobotArg": "Robot | path",
    "RobotLike": "Robot | path",
    "_LogRobot": "Robot | path | None",
    "LogArg": "Log | path",
    "LogSource": "Log | path",
    "BodyArg": "RigidBody | path",
    "LawArg": "FrictionModel | path",
    "FittedLawArg": "str | type[Estimator] | FrictionModel | path",
}
_SEVERAL = {"Names": "str", "Paths": "path", "PerJoint": "float"}
_SEVERAL |= {"Logs": _ONE["LogArg"], "Laws": _ONE["LawArg"]}
_WORDS = _ONE | {name: f"{item} | Iterable[{item}]" for name, item in _SEVERAL.items()}
_WORDS |= {
    "NamedLaws": f"{_ONE['LawArg']} | Iterable | Mapping",
    "Progress": "Callable",
    "Stages": "Callable",
    "Registered": "type[Estimator]",
    "Array": "ndarray",
    "OptionType": "str",
    "Platforms": "str",
    "Purpose": "str",
    "Method": "str",
    "Body": "str",
    "BenchKind": "str",
    "StatedSource": "str",
}
"""Words for the names of types that only our sources know."""


def describe_type(annotation: Any) -> str:
    """Return an annotation in the words of users, such as ``Log | path``."""
    if annotation is ArrayLike:
        return "array"
    if isinstance(annotation, ForwardRef):
        annotation = annotation.__forward_arg__
    if isinstance(annotation, str):
        return _describe_text(annotation)
    if get_origin(annotation) is not None:
        return _describe_generic(annotation)
    if annotation is NoneType:
        return "None"
    if annotation is Ellipsis:
        return "..."
    name = getattr(annotation, "__name__", None) or str(annotation)
    return _WORDS.get(name, name)


def _describe_text(annotation: str) -> str:
    """Return the words for an annotation that is a text, without modules and quotes."""
    text = re.sub(r"\b[a-z_]+\.(?=\w)", "", annotation.replace('"', ""))
    return re.sub(r"\w+", lambda match: _WORDS.get(match[0], match[0]), text)


def _describe_generic(annotation: Any) -> str:
    """Return the words for a type with arguments."""
    origin: Any = get_origin(annotation)
    if origin is Annotated:
        return describe_type(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return _describe_union(get_args(annotation))
    if origin is Literal:
        return "str"
    # NumPy's array types are aliases with a value from 2.5 on.
    if origin is np.ndarray or origin.__name__ == "NDArray":
        return "ndarray"
    if origin.__name__ == "Callable":
        return "Callable"
    arguments = ", ".join(describe_type(argument) for argument in get_args(annotation))
    return f"{origin.__name__}[{arguments}]"


def _describe_union(kinds: tuple[Any, ...]) -> str:
    """Return the words for a union; text or a path object is a path."""
    remaining = list(kinds)
    words = []
    array_kinds = get_args(ArrayLike) or (ArrayLike,)  # an alias from NumPy 2.5 on
    for parts, word in ((array_kinds, "array"), ((str, PathLike[str]), "path")):
        if all(kind in remaining for kind in parts):
            remaining = [kind for kind in remaining if kind not in parts]
            words.append(word)
    described = [describe_type(kind) for kind in remaining]
    names = [word for word in described if word != "None"]
    if "Robot" in names:  # its description is a robot, too
        names.remove("RobotDescription")
    names += words
    if "None" in described:
        names.append("None")
    return " | ".join(dict.fromkeys(names))


class _Words(str):
    """Words for a type that show without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class _Parameter(inspect.Parameter):
    """Parameter whose text names types in words."""

    def __str__(self) -> str:
        if self.kind is self.VAR_KEYWORD:
            return f"**{self.name}"
        text = self.name
        if self.kind is self.VAR_POSITIONAL:
            text = f"*{text}"
        if self.annotation is not self.empty:
            text += f": {describe_type(self.annotation)}"
        if self.default is self.empty:
            return text
        default = repr(self.default)
        if default.startswith("<"):
            # A function, or a default that a data class makes for each object, has no short text.
            default = "..."
        return f"{text} = {default}"


class _Signature(inspect.Signature):
    """Signature whose text has one parameter a line if it is long."""

    @classmethod
    def from_signature(cls, signature: inspect.Signature) -> Self:
        """Return the same signature with texts for readers."""
        parameters = [
            _Parameter(
                parameter.name,
                parameter.kind,
                default=parameter.default,
                annotation=parameter.annotation,
            )
            for parameter in signature.parameters.values()
        ]
        result = signature.return_annotation
        if result is not signature.empty:
            result = _Words(describe_type(result))
        return cls(parameters, return_annotation=result)

    def __str__(self) -> str:
        return self.format()

    def format(self, **_: object) -> str:
        """Return the text; `help()` of newer versions of Python states a width."""
        parts = []
        previous = None
        for parameter in self.parameters.values():
            is_first_keyword = parameter.kind is parameter.KEYWORD_ONLY and previous not in (
                parameter.KEYWORD_ONLY,
                parameter.VAR_POSITIONAL,
            )
            if is_first_keyword:
                parts.append("*")
            parts.append(str(parameter))
            previous = parameter.kind
        result = ""
        if self.return_annotation is not self.empty:
            result = f" -> {self.return_annotation}"
        line = f"({', '.join(parts)}){result}"
        if len(line) <= _WIDTH:
            return line
        rows = "".join(f"    {part},\n" for part in parts)
        return f"(\n{rows}){result}"


def show_signatures(value: object) -> None:
    """Give a public function, or the methods of a public class, a signature for readers."""
    if isinstance(value, FunctionType):
        _show_signature(value)
    elif isinstance(value, type):
        if "__signature__" in vars(value):  # made by Pydantic
            _set_signature(value, inspect.signature(value))
        for kind in value.__mro__:
            if kind.__module__.partition(".")[0] in ("hesr", "hesr_model", "cosim", "fmu_src"):
                _show_methods(vars(kind))


def _show_methods(members: Mapping[str, object]) -> None:
    for name, member in members.items():
        function = getattr(member, "__func__", member)
        is_shown = not name.startswith("_") or name == "__init__"
        if is_shown and isinstance(function, FunctionType):
            _show_signature(function)


def _show_signature(function: FunctionType) -> None:
    signature = inspect.signature(function)
    if not isinstance(signature, _Signature):
        _set_signature(function, signature)


def _set_signature(value: Any, signature: inspect.Signature) -> None:
    value.__signature__ = _Signature.from_signature(signature)  # what `inspect.signature` returns
