"""User-visible sentences of the product, by module: `make messages` writes them for reading.

Messages are errors, warnings and the output of commands; findings are about logs, laws and FMUs;
descriptions are those of variables and options, and texts of pages.
"""

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KINDS = ("messages", "findings", "descriptions")
PACKAGES = ("hesr", "hesr_model", "fmu_src", "cosim")
# Modules by kind of their sentences, except those of errors and log records.
FINDINGS = re.compile(
    r"cosim/study/verdict|fmu_src/check/|hesr_model/(audit/(attack|certificate)|health/)"
    r"|hesr/extras/(hostile/|properties/|mjcf/parts)"
)
DESCRIPTIVE = re.compile(
    r"cosim/report/|cosim/loop/closed_loop|hesr/extras/(reports/|ssp/ssp_results|studies/robustness)"
    r"|fmu_src/(blocks|export|friction|pages)/|fmu_src/arm/(table|truth)"
    r"|fmu_src/run/reference_|hesr_model/(audit|friction|laws)/|hesr/cli/(app|derive)"
    r"|hesr/extras/(drive|laws|modelica|one_file)/|hesr/extras/\w+/(component|figures|monitor|page|result|tables)"
)
LOGGED = {"debug", "info", "warning", "error"}
# Literals that are code, markup or patterns, not sentences.
NOT_PROSE = re.compile(
    r"</?[a-z!]|/>|->|;\n|\(\?|\\[ndsbw(]|^\s*[\[(/#*]|==|&&|\bdouble\b|\breturn\b|[a-z]\(.*\);"
)


def literal(node: ast.AST) -> str | None:
    """Return a string with its placeholders as `{name}`, or `{}` for longer expressions."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_part, node.values))
    return None


def _part(part: ast.expr) -> str:
    if isinstance(part, ast.FormattedValue):
        name = ast.unparse(part.value)
        return f"{{{name}}}" if name.replace(".", "_").isidentifier() else "{}"
    return str(ast.literal_eval(part))


def _is_error(node: ast.AST) -> bool:
    """Tell whether a node raises or logs its strings."""
    if not isinstance(node, ast.Call):
        return isinstance(node, ast.Raise)
    name = ast.unparse(node.func)
    return name.endswith("Error") or name.rpartition(".")[2] in LOGGED


def _strings(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the kind and text of each sentence."""
    source = path.read_text(encoding="utf-8")
    name = str(path.relative_to(ROOT))
    kind = "descriptions" if DESCRIPTIVE.match(name) else "messages"
    kind = "findings" if FINDINGS.match(name) else kind
    if path.suffix != ".py":
        literals = re.findall(r'"((?:[^"\\\n]|\\.)*)"', source)
        yield from ((kind, text) for text in literals if is_sentence(text))
        return
    tree = ast.parse(source)
    inner = {
        child
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr | ast.Expr)
        for child in ast.walk(node)
        if child is not node and (isinstance(node, ast.JoinedStr) or child is node.value)
        if isinstance(child, ast.Constant | ast.JoinedStr)
    }
    listed = {  # several names in one string, such as columns
        node.args[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "_words"
    }
    raised = {c for n in ast.walk(tree) if _is_error(n) for c in ast.walk(n)}
    for node in ast.walk(tree):
        text = None if node in inner or node in listed else literal(node)
        if text and is_sentence(text, 2 if node in raised else 3):
            yield "messages" if node in raised else kind, text


def is_sentence(text: str, least: int = 3) -> bool:
    words = re.findall(r"(?<!\S)[A-Za-z'(][a-z’'-]*[,.;:)']*(?!\S)", text)
    return len(words) >= least and not NOT_PROSE.search(text)


@cache
def sentences() -> dict[str, dict[str, list[str]]]:
    """Sentences by kind and module, in alphabetical order."""
    found: dict[str, dict[str, list[str]]] = {kind: {} for kind in KINDS}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.*")):
            if path.suffix in {".py", ".c", ".h"}:
                for kind, text in sorted({(k, " ".join(t.split())) for k, t in _strings(path)}):
                    found[kind].setdefault(str(path.relative_to(ROOT)), []).append(text)
    return found


def listed(kind: str) -> str:
    parts = (f"# {module}\n" + "\n".join(texts) for module, texts in sentences()[kind].items())
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    for kind in KINDS:
        sys.stdout.write(f"== {kind}\n\n{listed(kind)}\n")
