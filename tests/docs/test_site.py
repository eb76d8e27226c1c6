"""Names and pages missing from the site, which its strict build does not detect."""

import re
import runpy
import tomllib
from fnmatch import fnmatch

from documents import ROOT

DOCS = ROOT / "docs"


def test_every_page_is_in_the_contents() -> None:
    listed = set(re.findall(r"^([\w./-]+)$", (DOCS / "index.md").read_text(), re.MULTILINE))
    pages = [*DOCS.glob("*.md"), *DOCS.glob("*.ipynb"), *DOCS.glob("gallery/*.md")]
    found = {page.relative_to(DOCS).with_suffix("").as_posix() for page in pages}
    assert found - {"index"} == {name for name in listed if not name.startswith(("../", "```"))}


def test_every_listed_page_is_built() -> None:
    """Pages outside docs are built only where the settings of the site include them."""
    settings = runpy.run_path(str(DOCS / "site" / "conf.py"))
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    outside = re.findall(r"^\.\./([\w./-]+)$", index, re.MULTILINE)
    assert len(outside) > 3
    for name in outside:
        assert (ROOT / f"{name}.md").is_file()
        patterns = settings["include_patterns"]
        assert any(fnmatch(f"{name}.md", pattern) for pattern in patterns), name


def test_links_lead_to_pages_of_the_site() -> None:
    """A link of a page to a Markdown file is to one that the site has."""
    settings = runpy.run_path(str(DOCS / "site" / "conf.py"))
    for page in DOCS.glob("**/*.md"):
        for target in re.findall(r"\]\(([\w./-]+\.md)(?:#[\w-]+)?\)", page.read_text("utf-8")):
            name = (page.parent / target).resolve().relative_to(ROOT).as_posix()
            patterns = settings["include_patterns"]
            assert any(fnmatch(name, pattern) for pattern in patterns), (page.name, target)
            assert name.split("/")[0] not in settings["exclude_patterns"], (page.name, target)


def test_the_gallery_has_claims_and_no_outputs() -> None:
    for page in DOCS.glob("gallery/*.md"):
        text = page.read_text(encoding="utf-8")
        assert text.count("```{code-cell}") > 2
        assert "\nassert " in text
        assert "data:image" not in text


def test_every_dependency_is_justified() -> None:
    """One row for each package of the base install, one for each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    rows = re.findall(r"^\| ([\w, `-]+?) \|(.+)\|$", (DOCS / "dependencies.md").read_text(), re.M)
    listed = {name.strip("` ") for names, _ in rows for name in names.split(",")}
    needed = {re.split(r"[<>=\[; ]", text)[0] for text in project["dependencies"]}
    assert needed | set(project["optional-dependencies"]) == listed - {"package", "extra"}
    assert all(cell.strip() for _, cells in rows for cell in cells.split("|"))
