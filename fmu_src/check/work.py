"""Jobs of `worker.py`, each done in a process of its own."""

import json
import sys
from pathlib import Path
from typing import Any

from hesr_model.support.process import FailedError, run

_WORKER = Path(__file__).with_name("worker.py")


def work(job: str, file: Path, folder: Path, seconds: float) -> Any:
    """Do a job of `worker.py` in a process of its own.

    Raises
    ------
    FailedError
        If it crashes or takes too long.
    """
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    # -P: what lies in the current folder is not imported.
    command = (sys.executable, "-P", str(_WORKER), job, str(file), str(answer))
    ended = run(command, folder, seconds)
    if ended.code < 0:
        raise FailedError(f"it crashed with signal {-ended.code}")
    if ended.code or not answer.exists():
        lines = ended.text.strip().splitlines() or ["no message"]
        raise FailedError(f"it failed with '{lines[-1].rstrip('.')}'")
    return json.loads(answer.read_text(encoding="utf-8"))
