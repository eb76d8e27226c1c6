"""Templates of HTML pages and code files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

TEMPLATES = Path(__file__).parent / "templates"


def rendered(template: str, /, folders: Sequence[Path] = (TEMPLATES,), **values: Any) -> str:
    """Return HTML from a template; values are escaped unless markup, missing names are errors."""
    return _environment(folders, autoescape=True).get_template(template).render(**values)


def code_templates(folder: Path, **options: str) -> jinja2.Environment:
    """Return the environment of code templates, without HTML escaping; options are Jinja's."""
    return _environment((folder,), autoescape=False, keep_trailing_newline=True, **options)


def _environment(folders: Sequence[Path], **options: Any) -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        **options,
    )
