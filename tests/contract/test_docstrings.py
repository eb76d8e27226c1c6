"""Docstrings of everything public in the three packages: there, true to the code, with units.

What cannot be judged by a machine is left to readers. No name is excepted by hand:

- every public module, class, function and method has a docstring;
- parameters and attributes that a docstring describes exist;
- errors under `Raises` exist, and every `HesrError` that a function raises itself stands there
  (commands of the command line apart, whose docstrings are their help);
- a function that takes or gives arrays names each array that it takes, at least one shape and at
  least one unit, in its own docstring or in the one that it refers to ("see `X.f`", "as in `X`");
- names in backquotes after "see" or "as in" exist.
"""

import ast
import builtins
import pydoc
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

import cosim
import fmu_src
import hesr_model
from hesr_model import errors

ROOT = Path(hesr_model.__file__).parents[1]

MODULES = [
    path.relative_to(ROOT)
    for package in (hesr_model, fmu_src, cosim)
    for path in sorted(Path(package.__file__).parent.rglob("*.py"))
]

NUMBERS = re.compile(r"\b(Array|NDArray|ArrayLike|ndarray)\b")
ARRAY = re.compile(rf"{NUMBERS.pattern}|\b(Rows|Mask)\b")
"""Masks of rows have a shape, but no unit."""

SHAPE = re.compile(
    r"\((?=[^()]*,)(?=[^()]*(\b[A-Z]\b|\bn\b|\d|len))(?:[^()]|\([^()]*\))*\)"  # (N,), (N, 3), ..
    r"|\((?:joints|samples|rows|searched|parameters|coordinates|inputs|outputs|decays|count|blocks"
    r"|steps \+ 1|nq|len\(\w+\))(?:, [\w ]+)?,?\)"
    r"|\bshapes?\b"
)
UNIT = re.compile(
    r"\[[^\]]*[A-Za-z%1][^\]]*\]|\bunits?\b|\bdimensionless\b|\bstandardised\b|\brelative\b"
)
REFERENCE = re.compile(r"\b(?:[Ss]ee|[Aa]s in|those of|that of) `([\w.]+)`")
SECTION = re.compile(r"(?m)^(\w[\w ]*)\n-{3,}\n")


@dataclass(frozen=True, kw_only=True)
class Documented:
    """A public class, function or method of a module."""

    module: Path
    name: str
    node: ast.ClassDef | ast.FunctionDef

    def __str__(self) -> str:
        return f"{self.module}:{self.node.lineno} {self.name}"

    @property
    def text(self) -> str:
        """Its docstring."""
        return ast.get_docstring(self.node) or ""

    @property
    def parameters(self) -> dict[str, str]:
        """Annotation of each parameter of a function, or of what makes an object of a class."""
        function = self.node
        if isinstance(function, ast.ClassDef):
            makers = [n for n in function.body if isinstance(n, ast.FunctionDef)]
            return {
                name: annotation
                for maker in makers
                if maker.name == "__init__"
                for name, annotation in _parameters(maker).items()
            }
        return _parameters(function)

    @property
    def given(self) -> str:
        """Return annotation of a function."""
        node = self.node
        returns = node.returns if isinstance(node, ast.FunctionDef) else None
        return ast.unparse(returns) if returns is not None else ""

    @property
    def gives_arrays(self) -> bool:
        """Whether a function returns an array, alone or among others."""
        return bool(ARRAY.search(self.given))

    @property
    def has_numbers(self) -> bool:
        """Whether one of the arrays that a function takes or gives is more than a mask."""
        return any(NUMBERS.search(text) for text in (self.given, *self.parameters.values()))

    @property
    def is_command(self) -> bool:
        """Whether this is a command of the command line, whose docstring is its help."""
        return any("app.command" in ast.unparse(d) for d in self.node.decorator_list)


def _parameters(function: ast.FunctionDef) -> dict[str, str]:
    every = function.args
    listed = [*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg]
    return {
        a.arg: ast.unparse(a.annotation) if a.annotation else ""
        for a in listed
        if a is not None and a.arg not in ("self", "cls")
    }


@cache
def tree(module: Path) -> ast.Module:
    return ast.parse((ROOT / module).read_text(encoding="utf-8"))


def _within(
    node: ast.AST, prefix: str = ""
) -> Iterator[tuple[str, ast.ClassDef | ast.FunctionDef]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            yield prefix + child.name, child
            if isinstance(child, ast.ClassDef):
                yield from _within(child, f"{prefix}{child.name}.")


def _is_overload(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and any(
        "overload" in ast.unparse(decorator) for decorator in node.decorator_list
    )


PUBLIC = [
    Documented(module=module, name=name, node=node)
    for module in MODULES
    if not any(part.startswith("_") for part in module.with_suffix("").parts[:-1])
    and (not module.stem.startswith("_") or module.stem == "__init__")
    for name, node in _within(tree(module))
    if not _is_overload(node)
]


@cache
def by_name() -> dict[str, list[Documented]]:
    """Everything public by its name, and by the last part of that."""
    found: dict[str, list[Documented]] = {}
    for one in PUBLIC:
        for name in {one.name, one.name.rpartition(".")[2]}:
            found.setdefault(name, []).append(one)
    return found


@cache
def fields(node: ast.ClassDef) -> frozenset[str]:
    """Names of the attributes and properties of a class and of its bases in the packages."""
    found = set()
    for child in ast.walk(node):
        if isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            found.add(child.target.id)
        elif isinstance(child, ast.Assign):
            found |= {t.id for t in child.targets if isinstance(t, ast.Name)}
        elif isinstance(child, ast.FunctionDef):
            found.add(child.name)
        elif isinstance(child, ast.Attribute) and isinstance(child.ctx, ast.Store):
            found.add(child.attr)
    for base in node.bases:
        for one in by_name().get(ast.unparse(base), ()):
            if isinstance(one.node, ast.ClassDef):
                found |= fields(one.node)
    return frozenset(found)


def section(text: str, *titles: str) -> str:
    """The text under the first of these headings of a docstring, empty where there is none."""
    parts = SECTION.split(text)
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        if title in titles:
            return body
    return ""


def entries(body: str) -> list[str]:
    """Names that a section describes: `a, b : text`, or `a, b` with text below it."""
    heads = [line for line in body.splitlines() if line and not line.startswith(" ")]
    names = []
    for head in heads:
        listed = head.partition(" : ")[0]
        assert re.fullmatch(r"\*{0,2}[\w.]+(, \*{0,2}[\w.]+)*", listed), f"no names in {head!r}"
        names += [name.strip("* ") for name in listed.split(",")]
    return names


def test_there_is_much_to_read() -> None:
    assert len(PUBLIC) > 500
    assert sum(bool(section(one.text, "Parameters")) for one in PUBLIC) > 100
    assert sum(bool(section(one.text, "Raises")) for one in PUBLIC) > 100


def test_everything_public_has_a_docstring() -> None:
    assert [str(m) for m in MODULES if not ast.get_docstring(tree(m))] == []
    assert [str(one) for one in PUBLIC if not one.text] == []


def test_parameters_and_attributes_that_are_described_exist() -> None:
    wrong = []
    for one in PUBLIC:
        known = set(one.parameters)
        if isinstance(one.node, ast.ClassDef):
            known |= fields(one.node)
        for title in ("Parameters", "Attributes", "Class attributes"):
            described = entries(section(one.text, title))
            wrong += [f"{one}: '{name}'" for name in described if name not in known]
    assert wrong == []


def error_names() -> set[str]:
    """Errors of Python, of HESR, and of the classes that the packages derive from these."""
    known = {n for n in dir(builtins) if n.endswith(("Error", "Exception", "Interrupt"))}
    known |= {n for n in vars(errors) if n.endswith("Error")}
    return known | {
        one.name.rpartition(".")[2]
        for one in PUBLIC
        if isinstance(one.node, ast.ClassDef)
        and any(ast.unparse(base).endswith(("Error", "Exception")) for base in one.node.bases)
    }


def test_errors_that_are_described_exist() -> None:
    known = error_names()
    wrong = [
        f"{one}: '{name}'"
        for one in PUBLIC
        for name in entries(section(one.text, "Raises"))
        if name not in known and pydoc.locate(name) is None
    ]
    assert wrong == []


def _raised(node: ast.AST) -> Iterator[str]:
    """Errors that a function raises in its own body, not in functions inside it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            continue
        if isinstance(child, ast.Raise) and isinstance(child.exc, ast.Call):
            yield ast.unparse(child.exc.func)
        yield from _raised(child)


def test_errors_that_a_function_raises_itself_are_described() -> None:
    hesr = {name for name, value in vars(errors).items() if isinstance(value, type)}
    wrong = []
    for one in PUBLIC:
        if isinstance(one.node, ast.FunctionDef):
            parts = [one, *referred(one)]
            told = {name for part in parts for name in entries(section(part.text, "Raises"))}
            if "HesrError" not in told and not one.is_command:
                wrong += [
                    f"{one}: {name}"
                    for name in dict.fromkeys(_raised(one.node))
                    if name in hesr and name not in told
                ]
    assert wrong == []


def referred(one: Documented) -> Iterator[Documented]:
    """What a docstring refers to; the neighbours in a class go by their own name."""
    for name in REFERENCE.findall(one.text):
        inside = f"{one.name.rpartition('.')[0]}.{name}"
        last = ".".join(name.split(".")[-2:])
        candidates = by_name().get(inside) or by_name().get(name) or by_name().get(last)
        yield from candidates or by_name().get(name.rpartition(".")[2], ())


def test_names_that_are_referred_to_exist() -> None:
    wrong = []
    for one in PUBLIC:
        for name in REFERENCE.findall(one.text):
            last = name.rpartition(".")[2]
            modules = {module.stem for module in MODULES}
            known = (
                last in by_name()
                or last in modules
                or re.search(rf"\b{re.escape(last)}\b", ast.unparse(tree(one.module)))
            )
            if not known:
                wrong.append(f"{one}: `{name}`")
    assert wrong == []


def described(one: Documented, depth: int = 2) -> str:
    """The docstring of one and of what it refers to; of a method also that of its class."""
    texts = [one.text]
    if depth:
        texts += [described(other, depth - 1) for other in referred(one)]
    return "\n".join(texts)


def lacking(one: Documented) -> Iterator[str]:
    """What the docstring of a function does not say of its arrays."""
    arrays = [name for name, annotation in one.parameters.items() if ARRAY.search(annotation)]
    if not arrays and not one.gives_arrays:
        return
    text = described(one)
    for name in arrays:
        if not re.search(rf"\b{name}\b", text):
            yield f"'{name}' is not described"
    if not SHAPE.search(text):
        yield "no shape"
    if one.has_numbers and not UNIT.search(text):
        yield "no unit"


def test_arrays_have_shapes_and_units() -> None:
    functions = [one for one in PUBLIC if isinstance(one.node, ast.FunctionDef)]
    assert sum(one.gives_arrays for one in functions) > 80
    assert [f"{one}: {lack}" for one in functions for lack in lacking(one)] == []


def test_fields_that_are_arrays_are_described() -> None:
    wrong = []
    for one in PUBLIC:
        if not isinstance(one.node, ast.ClassDef):
            continue
        body = one.node.body
        for k, field in enumerate(body):
            if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
                continue
            below = body[k + 1] if k + 1 < len(body) else None
            own = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            name = field.target.id
            if (
                ARRAY.search(ast.unparse(field.annotation))
                and not name.startswith("_")
                and not (own or re.search(rf"\b{name}\b", one.text))
            ):
                wrong.append(f"{one}: '{name}'")
    assert wrong == []


@pytest.mark.parametrize(
    ("text", "has_shape", "has_unit"),
    [
        ("(N, n) [rad/s]", True, True),
        ("Return the (N,) torque [N.m].", True, True),
        ("Ten parameters (10,) of a link, in SI units.", True, True),
        ("Return the torque (of a joint, say).", False, False),
        ("x+ = a x + c, called with (a, c) of [joint]", False, True),
        ("of the broadcast shape, without unit", True, True),
        ("(len(base), P)", True, False),
    ],
)
def test_shapes_and_units_are_told_apart_from_prose(
    text: str, has_shape: bool, has_unit: bool
) -> None:
    assert bool(SHAPE.search(text)) is has_shape
    assert bool(UNIT.search(text)) is has_unit
