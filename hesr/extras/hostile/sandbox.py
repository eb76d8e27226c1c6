"""Check of the sandbox: tries on this machine what foreign code must not be able to do."""

import logging
from pathlib import Path

from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription
from fmu_src.check.rules import Problem
from hesr_model.support.process import DiedError
from hesr_model.support.self_test import find_holes
from hesr_model.support.text import join_with_and

_log = logging.getLogger(__name__)


def problems(
    model_description: ParsedDescription, contents: Contents, folder: Path
) -> tuple[list[Problem], list[str]]:
    """Return a finding for each deed that succeeds in a child process of this machine."""
    del model_description, contents, folder  # the machine is tested, not the file
    try:
        holes = find_holes()
    except DiedError as error:
        return [], [f"Sandbox: not tried; its process {error}."]
    prevented = [deed for deed, succeeds in holes.items() if not succeeds]
    _log.info("foreign code cannot %s here.", join_with_and(prevented))
    return [
        ("sandbox", f"foreign code can {deed} on this machine; see SECURITY.md.")
        for deed, succeeds in holes.items()
        if succeeds
    ], []
