"""Templates: pages of HTML, and files of code."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

TEMPLATES = Path(__file__).parent / "templates"


def rendered(template: str, /, folders: Sequence[Path] = (TEMPLATES,), **values: Any) -> str:
    """Return HTML; what it is given is escaped but for markup, a name that it lacks is an error."""
    return _environment(folders, autoescape=True).get_template(template).render(**values)


def code_templates(**options: str) -> jinja2.Environment:
    """Return the templates of files of code, which is no HTML; options are those of Jinja."""
    return _environment((TEMPLATES,), autoescape=False, keep_trailing_newline=True, **options)


def _environment(folders: Sequence[Path], **options: Any) -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        **options,
    )
