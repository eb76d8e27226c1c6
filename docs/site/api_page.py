"""Write docs/api.md, the public Python interface on one page, from signatures and docstrings.

    .venv/bin/python docs/site/api_page.py

Its introduction and recipes are in api.md.in. The page is also `llms.txt`, at the root of the site
and in the wheel.
"""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hesr
from cosim.workflow.export import help_sections
from hesr_model.friction import inputs

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "api.md"
TEMPLATE = Path(__file__).with_name("api.md.in")

COMMANDS = (
    *("new", "inspect", "excite", "identify", "fit", "laws", "test", "export", "check"),
    *("simulate", "run", "report", "monitor", "observe"),
)
OBJECTS = (
    *("Log", "Robot", "RigidBody", "FrictionModel", "FrictionRegressor", "Fmu", "System"),
    *("Signals", "HesrError"),
)
LAW_PARTS = (*("register", "LawForm", "Coefficient", "SearchSpace", "Relaxation", "Stop"),)
LAW_CLASSES = ("OneForm", "Estimator", "FrictionLaw")
PLUG_INS = {
    "add-a-log-format.md": ("FileFormat", "LogSamples", "RobotDescription", "LogError"),
    "add-an-export-format.md": ("Exporter", "ExportOption", "ExportError"),
    "add-a-component.md": (
        *("Component", "Quantity", "Parameter", "Equation", "Requirement", "previous", "DT"),
        *("block", "write_fmu"),
    ),
}
"""Names that only one page needs, which explains them."""

SYMBOLS = {"DQ": "dq", "Q": "q", "TAU_LOAD": "tau_load"}
ALL = (
    *(*COMMANDS, *OBJECTS, *LAW_PARTS, *LAW_CLASSES, *SYMBOLS, "absolute", "sgn", "__version__"),
    *(name for names in PLUG_INS.values() for name in names),
)

HIDDEN = {
    "Log": "is_checked dropped left_out left_over path sha256 rows split where longest_step "
    "jitter gaps period rate",
    "Robot": "follow reach tree bodies kinematics geometry under_gravity places links slides "
    "parameter_names inertial torque_limits doubts gravity nominal_parameters",
    "RigidBody": "base ridge condition gears sentence rows logs held covariance parameters_for "
    "torque_spread torque physical friction",
    "FrictionModel": "sample_time left_out_rmse from_json to_json require_band banded "
    "predict_band slides size sliding coupling thermal behind_low_pass records",
    "FrictionRegressor": "get_params set_params n_features_in_ equation sympy latex coefficients "
    "passivity",
    "Signals": "failure require_success end",
    "HesrError": "add_place format_for_command_line",
    "OneForm": "require_usable build_fitted_space core fit",
    "Estimator": "require_usable as_text typical order quick proposed paper adds baseline",
    "FrictionLaw": "structure discretisation start start_samples coefficient_rows",
}
"""Names that programs of users rarely need, by class."""


def write_page() -> str:
    """Return the text of the page."""
    parts = {
        "README": read_python_block("README.md"),
        "LAW": read_python_block("docs/add-a-law.md"),
        "COMMANDS": "".join(map(describe_function, COMMANDS)),
        "OBJECTS": "".join(map(describe_class, OBJECTS)),
        "PARTS": "".join([*map(describe_part, LAW_PARTS), describe_symbols()]),
        "PLUG_INS": "".join(map(describe_plug_in, PLUG_INS)),
        "CLASSES": "".join(map(describe_class, LAW_CLASSES)),
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"@{name}@\n", f"{part.strip()}\n")
    return text


def read_python_block(page: str) -> str:
    """Return the first Python block of a page, with its fence."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"(?ms)^```python\n.*?^```$", text)[0]


def describe_function(name: str) -> str:
    """Return the section of a command."""
    function = getattr(hesr, name)
    parts = split_sections(inspect.getdoc(function) or "")
    lines = [f"### {name}", join_lines(parts[""])]
    parameters = list_parameters(function)
    for parameter, text in read_entries(parts.get("Parameters", "")):
        if parameter not in ("progress", "**options"):
            lines.append(f"- `{parameters[parameter]}`: {text}")
    kind, _, result = parts["Returns"].partition("\n")
    lines.append(f"- Returns `{kind}`: {join_lines(result)}{describe_errors(parts)}")
    if name == "export":
        lines += describe_options()
    return "\n".join([*lines, *find_example(parts), "", ""])


def describe_errors(parts: dict[str, str]) -> str:
    """Return a sentence about the errors of a function."""
    errors = read_entries(parts.get("Raises", ""))
    return "".join(f" Raises {name} {text[0].lower()}{text[1:]}" for name, text in errors)


_SHORT = 160  # characters


def describe_options() -> Iterator[str]:
    """Yield the export formats and their options, short ones together."""
    short_texts = []
    for section in help_sections():
        formats = [f"{name} ({join_lines(title)})" for name, title in section.formats]
        options = [f"`{o.name}` ({join_lines(o.description)})" for o in section.options]
        text = f"{section.title}: {'; '.join(formats + options)}"
        if len(text) > _SHORT:
            yield f"- {text}"
        else:
            short_texts.append(text)
    if short_texts:
        yield f"- {'. '.join(short_texts)}"


def describe_class(name: str) -> str:
    """Return the section of a class: parameters, attributes and methods."""
    kind = getattr(hesr, name)
    hidden = HIDDEN.get(name, "").split()
    parts = split_sections(inspect.getdoc(kind) or "")
    lines = [f"### {name}", join_lines(parts[""])]
    parameters = list_parameters(kind)
    described: dict[str, str] = {}
    for title in ("Attributes", "Parameters"):
        described |= dict(read_entries(parts.get(title, "")))
    for attribute, text in described.items():
        if attribute not in hidden:
            lines.append(f"- `{parameters.get(attribute, attribute)}`: {text}")
    for member, value in list_members(kind):
        if member not in hidden:
            text = split_sections(inspect.getdoc(value) or "")[""]
            shown = format_signature(member, value) if callable(value) else member
            lines.append(f"- `{shown}`: {join_lines(text.partition(chr(10) * 2)[0])}")
    return "\n".join([*lines, *find_example(parts), "", ""])


def describe_part(name: str) -> str:
    """Return the line of a part of a law: its parameters, its summary and its attributes."""
    part = getattr(hesr, name)
    sections = split_sections(inspect.getdoc(part) or "")
    entries = read_entries(sections.get("Attributes", ""))
    texts = [f"`{names}`: {text}" for names, text in entries]
    return f"- `{format_signature(name, part)}`: {' '.join([join_lines(sections['']), *texts])}\n"


def describe_plug_in(page: str) -> str:
    """Return the line of the names that a page about plug-ins uses."""
    heading = (ROOT / "docs" / page).read_text(encoding="utf-8").partition("\n")[0]
    names = ", ".join(f"`hesr.{name}`" for name in PLUG_INS[page])
    return f"- [{heading.removeprefix('# ')}]({page}): {names}\n"


def describe_symbols() -> str:
    """Return the section of the symbols of expressions."""
    quantities = {str(quantity.symbol): quantity for quantity in inputs.QUANTITIES}
    lines = []
    for name, symbol in SYMBOLS.items():
        quantity = quantities[symbol]
        text = quantity.description.format(joint="the joint", effort="torque")
        lines.append(f"- `hesr.{name}`: {text} [{quantity.unit}]")
    lines.append("- `hesr.absolute(x)`, `hesr.sgn(x)`: magnitude and sign; not SymPy's own")
    return "\n".join(lines)


def list_parameters(function: Any) -> dict[str, str]:
    """Return each parameter with its type and default, by name."""
    parameters = inspect.signature(function).parameters
    return {name: str(parameter) for name, parameter in parameters.items()}


def format_signature(name: str, function: Any) -> str:
    """Return a signature on one line, without `self`."""
    text = re.sub(r"\s+", " ", f"{name}{inspect.signature(function)}")
    text = text.replace("( ", "(").replace(", )", ")").replace("(self, ", "(")
    return text.replace("(self)", "()").replace(" -> None", "")


def list_members(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield methods and properties of a class, in the order of its source."""
    for name, raw in vars(kind).items():
        is_property = isinstance(raw, property) or hasattr(raw, "attrname")
        is_method = callable(getattr(raw, "__func__", raw)) and not inspect.isclass(raw)
        if not name.startswith("_") and (is_property or is_method):
            yield name, raw if is_property else getattr(kind, name)


def split_sections(text: str) -> dict[str, str]:
    """Return the sections of a docstring by title; the part before the first has none."""
    head, *parts = re.split(r"(?m)\n*^(\w[\w ]*)\n-{3,}\n", text)
    return {"": head, **dict(zip(parts[::2], parts[1::2], strict=True))}


def read_entries(section: str) -> list[tuple[str, str]]:
    """Return names and texts of a section, whose texts are below a type or follow the name."""
    matches = re.findall(r"(?m)^(\S[^:\n]*?)(?: : (.*))?\n((?: {4}.*\n?)*)", f"{section}\n")
    has_types = all(rest for *_, rest in matches)
    entries = []
    for names, first, rest in matches:
        text = rest if has_types else f"{first} {rest}"
        entries.append((names, join_lines(text)))
    return entries


def find_example(parts: dict[str, str]) -> list[str]:
    """Return the Python example of a docstring as lines of a block."""
    lines = parts.get("Examples", "").split("\n")
    starts = [number for number, line in enumerate(lines) if line.startswith(">>> ")]
    if not starts:
        return []
    code = "\n".join(line for line in lines[starts[0] :] if line != ">>> import hesr")
    return ["```pycon", code.strip(), "```"]


def join_lines(text: str) -> str:
    """Return text on one line."""
    return " ".join(text.split())


if __name__ == "__main__":
    PAGE.write_text(write_page(), encoding="utf-8")
