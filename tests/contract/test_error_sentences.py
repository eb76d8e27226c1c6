"""Coverage of error messages: some words of each appear in a test."""

import ast
import re
from pathlib import Path

import cosim
import fmu_src
import hesr_model
from hesr_model import errors

ROOT = Path(hesr_model.__file__).parents[1]
WORDS = 3


def sentences() -> dict[str, list[str]]:
    """Return the fixed parts of all error messages by place."""
    found = {}
    for package in (hesr_model, fmu_src, cosim):
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and ast.unparse(node.func) in vars(errors):
                    parts = [n for a in node.args[:1] for n in ast.walk(a)]
                    found[f"{path.relative_to(ROOT)}:{node.lineno}"] = [
                        n.value
                        for n in parts
                        if isinstance(n, ast.Constant) and isinstance(n.value, str)
                    ]
    return found


def test_every_error_message_appears_in_a_test() -> None:
    tests = (path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    # Join strings over several lines, and drop the escapes of regular expressions.
    shown = re.sub(r"[\"']\s*\n\s*[rf]*[\"']", "", "\n".join(tests)).replace("\\", "")
    missing = []
    for place, texts in sentences().items():
        rows = [part.strip(" :;,.'()").split() for part in texts]
        runs = [" ".join(r[k : k + WORDS]) for r in rows for k in range(len(r) - WORDS + 1)]
        if runs and not any(run in shown for run in runs):
            missing.append(f"{place} {texts}")
    assert len(sentences()) > 200
    assert missing == [], "\n".join(missing)
