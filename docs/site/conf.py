"""The documentation as a site: pages and notebooks that are executed.

`make docs` builds it. It is strict: a link without an end or a cell that fails ends the build.
"""

import importlib.metadata
import shutil
from pathlib import Path
from typing import Any

project = "HESR"
author = "HESR contributors"
release = version = importlib.metadata.version("hesr")
copyright = author  # noqa: A001  # as Sphinx calls it

extensions = ["myst_nb"]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "models/*/README.md",
]
exclude_patterns = [
    *(".*", "build", "dist", "site", "results", "tests", "cosim", "fmu_src", "hesr_model"),
    *("docs/site", "**/__pycache__"),
]
html_theme = "furo"
html_title = f"HESR {release}"
templates_path = ["templates"]
html_additional_pages = {"index": "to_docs.html"}
html_show_sourcelink = html_show_copyright = False

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
# Fences without a lexer are shown as they are.
suppress_warnings = ["misc.highlighting_failure"]

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # [s] only stops a kernel that hangs
nb_execution_in_temp = True
nb_merge_streams = True


def setup(app: Any) -> None:
    """Copy the page of the Python interface to the root of the site, for programs."""
    app.connect("build-finished", write_llms_text)


def write_llms_text(app: Any, exception: Exception | None) -> None:
    """Write `llms.txt` after a build without errors."""
    if exception is None:
        shutil.copy(Path(app.srcdir, "docs", "api.md"), Path(app.outdir, "llms.txt"))
