"""The table of variables: names, arrays, dependencies and what it refuses."""

import pytest

from fmu_src.export.interface import Interface, Role, Variable, extract_numbers, to_c
from hesr_model.errors import ExportError


def table(*names: str, role: Role = "input", unit: str = "1") -> tuple[Variable, ...]:
    return tuple(Variable(name=name, role=role, description="any", unit=unit) for name in names)


@pytest.mark.parametrize(
    "name", ["x", "_x1", "x[1]", "x[1,12]", "a.b", "a[1].b[2,3]", "der(x)", "der(a.b[1])"]
)
def test_structured_names_are_accepted(name: str) -> None:
    assert Interface(variables=table(name)).places[name] == 0


@pytest.mark.parametrize(
    "name",
    ["", "1x", "x[]", "x[a]", "x[1,]", "a.", ".a", "a..b", "der(x", "der()", "x y", "é", "x[1][2]"],
)
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(ExportError, match="not a structured name"):
        Interface(variables=table("a", name))


def test_names_are_distinct() -> None:
    with pytest.raises(ExportError, match="'b' is used twice"):
        Interface(variables=table("a", "b", "c", "b"))


def shapes(*variables: Variable, connected: frozenset[str] = frozenset()) -> dict[str, object]:
    own = Interface(variables=variables, connected=connected)
    assert [v for part in own.parts for v in part.elements] == list(variables)
    for part in own.parts:
        assert variables[part.place : part.place + len(part.elements)] == part.elements
        assert own.places[part.name] == part.place
        assert all(own.part_of[v.name] is part for v in part.elements)
    return {part.name: part.shape for part in own.parts}


def test_whole_arrays_are_grouped() -> None:
    assert shapes(*table("a", "x[1]", "x[2]", "m[1,1]", "m[1,2]", "m[2,1]", "m[2,2]", "b")) == {
        "a": (), "x": (2,), "m": (2, 2), "b": (),
    }  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [
        ("x[1]", "x[3]"),  # a gap
        ("x[2]", "x[1]"),  # another order
        ("x[0]", "x[1]"),  # from zero
        ("x[1]", "a", "x[2]"),  # apart
        ("x[1]", "x[2]", "a", "x[3]"),
        ("m[1,1]", "m[2,1]", "m[1,2]", "m[2,2]"),
        ("m[1,1]", "m[1,2]", "m[2,1]"),
    ],
)
def test_other_elements_remain_scalars(names: tuple[str, ...]) -> None:
    assert shapes(*table(*names)) == dict.fromkeys(names, ())


def test_elements_of_an_array_are_alike() -> None:
    assert shapes(*table("x[1]"), *table("x[2]", unit="m")) == {"x[1]": (), "x[2]": ()}
    assert shapes(*table("x[1]"), *table("x[2]", role="fixed")) == {"x[1]": (), "x[2]": ()}


def test_states_and_members_of_terminals_remain_scalars() -> None:
    variables = (
        *table("h[1]", "h[2]", role="state"),
        *table("x[1]", "x[2]"),
        *table("y[1]", "y[2]"),
    )
    assert shapes(*variables, connected=frozenset({"x"})) == {
        "h[1]": (), "h[2]": (), "x[1]": (), "x[2]": (), "y": (2,),
    }  # fmt: skip


def test_the_first_of_consecutive_variables_is_found() -> None:
    own = Interface(variables=table("a", "b", "c", "d"))
    assert own.first(["b", "c"]) == 1
    for names in (["b", "d"], ["c", "b"], ["d", "a"]):
        with pytest.raises(ValueError, match="not consecutive"):
            own.first(names)


DEPENDENT = Interface(
    variables=(
        *table("u"),
        *table("p", "p2", role="fixed"),
        Variable("h", "state", "state", unit="1", initial_dependencies=("g", "p")),
        Variable("g", "state", "state", unit="1", initial_dependencies=("h", "p2")),
        Variable("dh", "local", "its rate", unit="1", derivative_of="h", dependencies=("h", "u")),
        Variable("y", "output", "any", unit="1", dependencies=("h",), initial_dependencies=("u",)),
    )
)  # fmt: skip


def test_outputs_depend_initially_on_what_determines_states() -> None:
    y = DEPENDENT.variables[-1]
    assert DEPENDENT.initially(y) == ("u", "p", "p2")
    assert DEPENDENT.find_dependencies(y, ("state",)) == ["h"]
    assert DEPENDENT.find_dependencies(y, ("input", "fixed")) == []
    assert DEPENDENT.find_dependencies(y, ("fixed",), initially=True) == ["p", "p2"]
    assert [v.name for v in DEPENDENT.derivatives] == ["dh"]


def test_values_that_must_stay_finite_are_watched() -> None:
    """All that is computed between events, and derivatives behind the others."""
    text = to_c(DEPENDENT, "guid", 0.01)
    assert "watched[] = {3, 4, 6, 5};" in text
    assert "WATCHED = 3, SLOPES = 1 " in text
    assert "VARIABLES = 7, STATES = 1, INDICATORS = 0 " in text
    assert "static const int states[] = {3};" in text
    assert "static const int derivatives[] = {5};" in text


def test_numbers_are_separated_only_from_this_version() -> None:
    text = to_c(DEPENDENT, "guid", 0.01)
    zeros, content = extract_numbers(text)
    assert '"guid"' not in zeros
    assert zeros.count("{0.0, 0.0, 0.0}") == len(DEPENDENT.variables)
    assert content.startswith(b"guid\0")
    assert len(content) == 40 + 3 * 8 * len(DEPENDENT.variables)
    for part in ("} numbers = ", "#define MODEL_GUID"):
        with pytest.raises(ValueError, match="no interface"):
            extract_numbers(text.replace(part, "other"))
