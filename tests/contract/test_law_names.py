"""Facts about a law are attributes of its estimator: no other module lists law names."""

import ast
from collections import defaultdict

from documents import ROOT

from hesr_model.fitting.estimator import registry, select_laws

WITH_DEFAULTS = {
    "cosim/regressor.py",  # default of `FrictionRegressor(law=..)`
    "cosim/report/tables/loop.py",  # tables of the paper
    "cosim/report/sections/prediction.py",  # comparison with Fig. 5 of the paper
    "cosim/study/proposal.py",  # relaxed variants of LuGre as references
    "cosim/study/scores.py",  # reference and baseline
    "hesr_model/inference/choice.py",  # baselines, and laws that are proven by construction
    "hesr/extras/fleet/study.py",  # default of the key `laws`
    # Not laws: a parameter of an alternative plant and an attribute of MuJoCo.
    "fmu_src/arm/truth.py",
    "hesr/extras/mjcf/mjcf_file.py",
}
"""Modules that may name laws, apart from the study of the paper."""
ALSO_WORDS = {"constant", "none"}
"""Laws whose names are also words of FMI, messages and choices."""


def test_law_names_appear_only_as_documented_defaults() -> None:
    found = defaultdict(set)
    for layer in ("hesr_model", "fmu_src", "cosim", "hesr"):
        for file in sorted((ROOT / layer).rglob("*.py")):
            if "laws" in file.parts or "paper" in file.parts:
                continue
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and node.value in set(registry()) - ALSO_WORDS:
                    found[file.relative_to(ROOT).as_posix()].add(node.value)
    assert set(found) <= WITH_DEFAULTS, {file: found[file] for file in set(found) - WITH_DEFAULTS}


def test_facts_about_a_law_are_not_inherited() -> None:
    parent = registry()["lugre"]
    child = type("Child", (parent,), {"name": "child", "title": "Child"})
    baseline = registry()["constant"]
    assert baseline.baseline
    assert not type("Child", (baseline,), {"name": "child", "title": "Child"}).baseline
    assert (parent.quick, parent.proposed, parent.paper, parent.order) == (True, True, 2, 30)
    assert (child.quick, child.proposed, child.paper, child.order) == (False, False, 0, 1000)
    assert child.classic


def test_laws_are_in_table_order() -> None:
    orders = [law.order for law in registry().values()]
    assert orders == sorted(orders)
    assert len(set(orders)) == len(orders)
    assert set(select_laws("quick")) | set(select_laws("proposed")) <= set(registry())
    assert select_laws("quick")
    assert select_laws("proposed")
