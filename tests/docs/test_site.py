"""Names and pages missing from the site, which its strict build does not detect."""

import re
import tomllib

from documents import ROOT

DOCS = ROOT / "docs"


def test_every_page_is_in_the_contents() -> None:
    listed = set(re.findall(r"^([\w./-]+)$", (DOCS / "index.md").read_text(), re.MULTILINE))
    pages = [*DOCS.glob("*.md"), *DOCS.glob("*.ipynb"), *DOCS.glob("gallery/*.md")]
    found = {page.relative_to(DOCS).with_suffix("").as_posix() for page in pages}
    assert found - {"index"} == {name for name in listed if not name.startswith(("../", "```"))}


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
