"""Facts about a law are attributes of its estimator: no other module lists law names."""

import ast
from collections import defaultdict

from documents import ROOT

from hesr_model.fitting.estimator import laws_with, registry

DEFAULTS = {
    "cosim/regressor.py": {"lugre"},  # default of `FrictionRegressor(law=..)`
    "cosim/report/tables/loop.py": {
        "lugre",
        "parfam_h",
        "parfam_v",
        "rbfnn_h",
        "stribeck",
    },  # its tables
    "cosim/report/sections/prediction.py": {"rbfnn_h"},  # comparison with Fig. 5 of the paper
    "cosim/study/scores.py": {"lugre", "stribeck"},  # REFERENCE and BASELINE
    "hesr/extras/fleet/study.py": {"lugre"},  # default of the key `laws`
    # Study of the paper: its truth, and the fits of LuGre and ParFam-H that it compares.
    "hesr/extras/paper/evidence.py": {"lugre", "stribeck"},
    "hesr/extras/paper/measures.py": {"lugre"},
    "hesr/extras/paper/report.py": {"lugre", "lugre_static_first"},
    # Not laws: a parameter of an alternative plant and an attribute of MuJoCo.
    "fmu_src/arm/truth.py": {"stribeck"},
    "hesr/extras/mjcf/mjcf_file.py": {"lugre"},
}
"""Documented defaults by module."""


def test_law_names_appear_only_as_documented_defaults() -> None:
    found = defaultdict(set)
    for layer in ("hesr_model", "fmu_src", "cosim", "hesr"):
        for file in sorted((ROOT / layer).rglob("*.py")):
            if "laws" in file.parts:
                continue
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and node.value in registry():
                    found[file.relative_to(ROOT).as_posix()].add(node.value)
    assert found == DEFAULTS


def test_facts_about_a_law_are_not_inherited() -> None:
    parent = registry()["lugre"]
    child = type("Child", (parent,), {"name": "child", "title": "Child"})
    assert (parent.quick, parent.proposed, parent.paper, parent.order) == (True, True, 2, 30)
    assert (child.quick, child.proposed, child.paper, child.order) == (False, False, 0, 1000)
    assert child.classic


def test_laws_are_in_table_order() -> None:
    orders = [law.order for law in registry().values()]
    assert orders == sorted(orders)
    assert len(set(orders)) == len(orders)
    assert laws_with("quick") == ("stribeck", "lugre", "parfam_h")
    assert laws_with("proposed") == (
        *("stribeck", "lugre", "lugre_load", "lugre_load_ripple", "parfam_hx"),
        *("parfam_s", "parfam_s_v"),
    )
