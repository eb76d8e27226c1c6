"""Names of `import hesr`: lazy import, documentation, type stub and help."""

import ast
import inspect
import math
import pydoc
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

import hesr
from hesr.cli.app import app, find_workflow, help_sections
from hesr.cli.derive import Docstring, Function
from hesr_model.support import signatures as shown_signatures
from hesr_model.support.lazy import lazy


def test_every_name_exists_and_is_documented() -> None:
    for name in dir(hesr):
        assert inspect.getdoc(getattr(hesr, name)), name
    with pytest.raises(AttributeError, match="module 'hesr' has no attribute 'fitt'"):
        _ = hesr.fitt


def test_every_verb_is_a_function() -> None:
    with app.make_context("hesr", [], resilient_parsing=True) as context:
        verbs = app.list_commands(context)
    assert set(verbs) <= set(dir(hesr))
    for verb in verbs:
        assert getattr(hesr, verb) is find_workflow(verb)


def test_the_stub_contains_only_imports() -> None:
    stub = Path(hesr.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    body = ast.parse(stub).body
    imported = [node for node in body if isinstance(node, ast.ImportFrom)]
    assert len(imported) == len(body)
    names = {node.names[0].asname for node in imported if len(node.names) == 1} - {None}
    assert names == set(dir(hesr))


def descriptions_of_options(function: Function) -> dict[str, str]:
    """Return the options that a function takes as further keywords, with one of their texts."""
    return {
        option.name: option.description
        for section in help_sections(function)
        for option in section.options
    }


def test_command_line_options_match_the_functions() -> None:
    """Arguments and options of each verb are the parameters of its function, and vice versa."""
    common = {"json_file", "fail_on", "quiet", "verbose"}
    with app.make_context("hesr", [], resilient_parsing=True) as context:
        for verb in app.list_commands(context):
            function = find_workflow(verb)
            command = app.get_command(context, verb)
            assert command is not None
            given = {param.name for param in command.params} - common
            taken = {
                name
                for name, one in inspect.signature(function).parameters.items()
                if one.kind is not one.VAR_KEYWORD
            }
            taken |= descriptions_of_options(function).keys()
            # `--list` is `hesr.laws()`.
            assert given - {"listing"} == taken - {"progress"}, verb


def test_flags_are_off_unless_given() -> None:
    """A flag on the command line can only switch on."""
    for verb in app.list_commands(click.Context(app)):
        for one in inspect.signature(find_workflow(verb)).parameters.values():
            if one.annotation == "bool":
                assert one.default is False, (verb, one.name)


SECTIONS = ("Parameters", "Returns", "Raises", "Examples")


def test_every_function_has_a_full_docstring_used_as_help() -> None:
    with app.make_context("hesr", [], resilient_parsing=True) as context:
        for verb in app.list_commands(context):
            function = find_workflow(verb)
            text = inspect.getdoc(function) or ""
            assert [s for s in SECTIONS if f"\n{s}\n{'-' * len(s)}\n" not in text] == [], verb
            told = Docstring.from_function(function)
            own = {
                one.name
                for one in inspect.signature(function).parameters.values()
                if one.kind is not one.VAR_KEYWORD
            }
            assert set(told.parameters) == own, verb
            command = app.get_command(context, verb)
            assert command is not None
            shown = " ".join(command.get_help(click.Context(command, info_name=verb)).split())
            texts = told.parameters | descriptions_of_options(function)
            for name in texts.keys() - {"progress"}:
                text = " ".join(texts[name].split())[:40].removesuffix(".")
                assert text in shown, (verb, name)


def test_help_fits_a_screen_and_names_everything() -> None:
    lines = pydoc.render_doc(hesr).splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 110
    assert [name for name in dir(hesr) if name not in str(hesr.__doc__)] == []


FUNCTIONS = [name for name in dir(hesr) if inspect.isfunction(getattr(hesr, name))]
SYMBOLS = ("absolute", "sgn")  # classes of SymPy, with its methods
CLASSES = [
    name for name in dir(hesr) if inspect.isclass(getattr(hesr, name)) and name not in SYMBOLS
]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_of_functions_fits_a_terminal(name: str) -> None:
    """The first line of `help` names the module."""
    lines = pydoc.plain(pydoc.render_doc(getattr(hesr, name))).splitlines()[1:]
    assert [line for line in lines if len(line) > 80] == []


def is_python(member: object) -> bool:
    return inspect.isfunction(member) or inspect.ismethod(member)


def signatures(name: str) -> Iterator[str]:
    """Yield the signature of a function, or of a class and its methods, as `help` shows them."""
    value = getattr(hesr, name)
    yield str(inspect.signature(value))
    members = inspect.getmembers(value, is_python) if inspect.isclass(value) else ()
    for member, function in members:
        if not member.startswith("_") and str(function.__module__).startswith(PACKAGES):
            yield str(inspect.signature(function))


PACKAGES = ("hesr", "hesr_model", "cosim", "fmu_src")
# Of types that a reader cannot import from `hesr`, of objects by address, and of quoted types.
PRIVATE = re.compile(
    r"\b_|Annotated|Validator|<|\b(numpy|collections|hesr_model|cosim|fmu_src|typing)\.|: '|-> '"
)


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_signatures_show_no_private_object(name: str) -> None:
    shown = list(signatures(name))
    assert [text for text in shown if PRIVATE.search(text)] == []
    aliases = shown_signatures._WORDS.keys()
    words = {word for text in shown for word in re.findall(r"\w+", text)}
    assert words.isdisjoint(aliases)


def test_notebooks_show_the_same_signatures() -> None:
    module = pytest.importorskip("IPython.core.oinspect")
    inspector = module.Inspector(theme_name="nocolor")
    shown = inspector.info(hesr.fit, oname="hesr.fit")["definition"]
    assert "logs: Log | path | Iterable[Log | path]" in shown
    assert not PRIVATE.search(shown)


def test_the_import_loads_no_modules() -> None:
    code = "import sys; before = set(sys.modules); import hesr; print(*set(sys.modules) - before)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    ours = {name for name in loaded if name.startswith(("hesr", "cosim", "fmu_src"))}
    assert ours == {"hesr", "hesr_model", "hesr_model.support", "hesr_model.support.lazy"}
    assert not {"numpy", "sympy", "scipy", "pinocchio"} & set(loaded)


def test_a_lazy_name_is_resolved_once(tmp_path: Path) -> None:
    (tmp_path / "names.pyi").write_text(
        "from time import sleep as sleep\nfrom math import pi as pi"
    )
    module = type(sys)("lazy_names")
    sys.modules[module.__name__] = module
    try:
        find, names = lazy(module.__name__, str(tmp_path / "names.py"))
        assert find("sleep") is vars(module)["sleep"] is time.sleep
        assert find("pi") == math.pi
        assert names() == ["pi", "sleep"]
        with pytest.raises(AttributeError, match="module 'lazy_names' has no attribute 'wake'"):
            find("wake")
    finally:
        del sys.modules[module.__name__]
