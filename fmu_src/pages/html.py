"""Templates of HTML pages and code files."""

import base64
import hashlib
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

_POLICY = "script-src 'none'"  # in the template of pages
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
TEMPLATES = Path(__file__).parent / "templates"


def render_template(template: str, /, folders: Sequence[Path] = (TEMPLATES,), **values: Any) -> str:
    """Return HTML from a template; values are escaped unless markup, missing names are errors.

    Whole pages run only their own scripts and those in `injected`, and load nothing.
    """
    text = _environment(tuple(folders), autoescape=True).get_template(template).render(**values)
    if _POLICY not in text:
        return text
    scripts = [*_SCRIPT.findall(text), *values.get("injected", ())]
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return text.replace(_POLICY, f"script-src 'wasm-unsafe-eval' {allowed}")


def code_templates(folder: Path, **options: str) -> jinja2.Environment:
    """Return the environment of code templates, without HTML escaping; options are Jinja's."""
    return _environment((folder,), autoescape=False, keep_trailing_newline=True, **options)


@cache  # with its compiled templates
def _environment(folders: tuple[Path, ...], **options: Any) -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        **options,
    )
