"""Files and calls with which printed remedies are executed."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from small_study import Hesr

from hesr_model.errors import HesrError, RuleError
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Place:
    """A folder to write in, a bench, results of a study of the twin, and the command line."""

    folder: Path
    bench: Path
    results: Path
    results_robot: Path
    lag_fmu: Path
    run: Hesr
    arm: Robot
    arm_log: Log


def refuse(call: Callable[[], Any]) -> str:
    """Return the sentence of a call that is refused, or "" of one that is not."""
    try:
        call()
    except (HesrError, RuleError, TypeError) as error:
        return str(error)
    return ""


def read_quoted(sentence: str, after: str) -> list[str]:
    """Return the names in quotes that a sentence prints after a word."""
    _, _, remedy = sentence.partition(after)
    return re.findall(r"'([a-z_.]+)'", remedy)
