"""The page of the Python interface: up to date, short, with all public names and no others."""

import importlib.util
import re
import tomllib
from types import ModuleType

import pytest
from documents import ROOT

import hesr

PAGE = ROOT / "docs" / "api.md"
MAX_LINES = 600


@pytest.fixture(scope="module")
def writer() -> ModuleType:
    """Return the script that writes the page."""
    specification = importlib.util.spec_from_file_location(
        "api_page", ROOT / "docs" / "site" / "api_page.py"
    )
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(writer: ModuleType) -> None:
    """Run docs/site/api_page.py after a change of a signature or docstring."""
    text = PAGE.read_text(encoding="utf-8")
    assert text == writer.write_page()
    assert len(text.splitlines()) <= MAX_LINES
    assert not re.search(r"@[A-Z]+@", text)


def test_the_page_has_every_public_name_and_no_other(writer: ModuleType) -> None:
    assert sorted(writer.ALL) == sorted(dir(hesr))
    text = PAGE.read_text(encoding="utf-8")
    assert set(re.findall(r"\bhesr\.(\w+)", text)) <= set(dir(hesr))
    for name in dir(hesr):
        assert re.search(rf"^### {name}$|^- `{name}\(|`hesr\.{name}\b", text, re.M), name


def test_every_verb_has_an_example(writer: ModuleType) -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in writer.COMMANDS:
        section = text.partition(f"\n### {name}\n")[2].partition("\n### ")[0]
        [block] = re.findall(r"(?ms)^```pycon\n(.*?)^```$", section)
        assert f"hesr.{name}(" in block


def test_docs_import_only_public_modules() -> None:
    """Pages show `import hesr`; other modules are for those who change HESR."""
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    internal = re.compile(r"(?m)^ *(?:>>> )?(?:from|import) (?:hesr_model|cosim|fmu_src)\b.*$")
    found = {page.name: internal.findall(page.read_text(encoding="utf-8")) for page in pages}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_the_wheel_contains_the_page() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included["docs/api.md"] == "hesr/llms.txt"
