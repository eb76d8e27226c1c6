"""Rules for variables: one change of Table I gives one message that names the variable."""

import pytest
from containing import Containing
from rule_changes import PARAMETER, enumeration, new, of_type, own, sentences, var

VARIABLES = {
    "initial of an input": (
        var("dq[1]", initial="exact"),
        "variable 'dq[1]' has initial 'exact'",
    ),
    "independent twice": (
        lambda xml: [xml.add_variable("Real", {}, name=n, causality="independent",
                                      valueReference=r) for n, r in (("t1", "901"), ("t2", "902"))]
        + [xml.drop(v) for v in xml.variables() if v.get("name") == "time"],
        "variables 't1', 't2' are all independent",
    ),
    "below": (
        new("Real", {"start": "1", "min": "2"}, name="x", **PARAMETER),
        "the variable 'x' has the start value 1, outside its min 2.",
    ),
    "above": (
        new("Integer", {"start": "9", "min": "2", "max": "8"}, name="x", **PARAMETER),
        "the variable 'x' has the start value 9, outside its min 2 and max 8.",
    ),
    "above the type's": (
        of_type("Real", {"max": "3"}, {"start": "4"}),
        "the variable 'x' has the start value 4, outside its max 3.",
    ),
    "min above max": (
        new("Real", {"start": "1", "min": "2", "max": "1"}, name="x", **PARAMETER),
        "the variable 'x' has min 2, above its max 1.",
    ),
    "nominal": (
        new("Real", {"start": "1", "nominal": "0"}, name="x", **PARAMETER),
        "'x' has the nominal value 0",
    ),
    "item": (
        enumeration(("a", "1"), ("b", "2"), start="7"),
        "'choice' has the start value 7",
    ),
    "other type": (
        new("Real", {"start": "1", "declaredType": "Discretisation"}, name="x", **PARAMETER),
        "Real, but its declared type 'Discretisation'",
    ),
    "display unit alone": (
        own("tau[1]", displayUnit="furlong", unit=None),
        "the variable 'tau[1]' has the display",
    ),
    "derivative of a parameter": (
        lambda xml: xml.add_variable("Real", {"derivative": str(xml.index("joint[1].alpha"))},
                                     name="x", variability="discrete"),
        "'x' is the derivative of 'joint[1].alpha'",
    ),
}  # fmt: skip

ALIASES = {
    "settable": (
        {"start": "1"}, PARAMETER, {"start": "1"}, PARAMETER,
        "share value reference 7000, but more",
    ),
    "units": (
        {"unit": "rad"}, {"causality": "local"}, {"unit": "N.m"}, {"causality": "local"},
        "the variables 'a', 'b' share value reference 7000, but have different units.",
    ),
    "constants": (
        {"start": "1"}, {"variability": "constant"}, {"start": "2"}, {"variability": "constant"},
        "the variables 'a', 'b' share value reference 7000, but as constants have different "
        "values.",
    ),
    "some constant": (
        {"start": "1"}, {"variability": "constant"}, {}, {"causality": "local"},
        "share value reference 7000, but only",
    ),
    "fine": ({}, {"causality": "local"}, {}, {"causality": "local"}, None),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), VARIABLES.values(), ids=VARIABLES)
def test_each_change_gives_one_message(change, expected, xml):
    change(xml)
    expected_texts = [expected] if isinstance(expected, str) else expected
    assert sentences(xml) == [Containing(text) for text in expected_texts]


@pytest.mark.parametrize(("first", "a", "second", "b", "expected"), ALIASES.values(), ids=ALIASES)
def test_aliases_are_checked(first, a, second, b, expected, xml):
    xml.add_variable("Real", first, name="a", valueReference="7000", **a)
    xml.add_variable("Real", second, name="b", valueReference="7000", **b)
    assert sentences(xml) == ([Containing(expected)] if expected else [])
