"""The documentation as a site: pages, docstrings and notebooks that are executed.

`make docs` builds it. It is strict: a link without an end or a cell that fails ends the build.
"""

import importlib.metadata

project = "HESR"
author = "HESR contributors"
release = version = importlib.metadata.version("hesr")
copyright = author  # noqa: A001  # as Sphinx calls it

extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "myst_nb"]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "models/uf850/README.md",
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
nb_execution_timeout = 120  # [s] only stops a kernel that hangs
nb_execution_in_temp = True
nb_merge_streams = True

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # signatures have them
numpydoc_class_members_toctree = False
numpydoc_show_class_members = False
numpydoc_attributes_as_param_list = False
