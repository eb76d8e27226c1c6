"""Process that runs commands in forks of itself, in which one call of the system fails.

Each line of its input is a request in JSON, each line of its output the answer. It is started with
the library of `faulty_calls.c`, whose file is the first argument.
"""

import ctypes
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import cosim.study.law_choice
import cosim.workflow.export
import cosim.workflow.fit
import cosim.workflow.identify
import hesr.cli
from hesr.cli.console import report_errors
from hesr_model.support.result_folder import folder_written_whole

# Commands import them slowly, and start processes that would import them again.
PRELOADED = (
    cosim.study.law_choice,
    cosim.workflow.export,
    cosim.workflow.fit,
    cosim.workflow.identify,
)
os.cpu_count = lambda: 1


def replay_run(recorded: str, results: str) -> None:
    """Write the recorded files of a run as a run does."""
    with report_errors(), folder_written_whole(Path(results)) as folder:
        shutil.copytree(recorded, folder, dirs_exist_ok=True, copy_function=shutil.copyfile)
    sys.exit(0)


def run_in_fork(request: dict[str, Any], arm: Any) -> int:
    """Run the request with its fault in a fork; return the exit code, negative for a signal."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code = 3
    try:
        for number, name in ((1, "output"), (2, "errors")):
            os.dup2(os.open(request[name], os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        record = -1
        if request["record"]:
            record = os.open(request["record"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.chdir(request["folder"])
        arm(os.fsencode(request["watched"]), request["point"], request["code"], record)
        if request["command"][0] == "replay":
            replay_run(*request["command"][1:])
        sys.argv = ["hesr", *request["command"]]
        hesr.cli.main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    finally:
        sys.stdout.flush()
        os._exit(code)


def answer(data: object) -> None:
    """Write an answer."""
    sys.stdout.write(json.dumps(data) + "\n")
    sys.stdout.flush()


def serve() -> None:
    """Answer requests until the input ends."""
    arm = ctypes.CDLL(sys.argv[1]).arm_fault
    arm.argtypes = ctypes.c_char_p, ctypes.c_long, ctypes.c_int, ctypes.c_int
    answer("ready")
    for line in sys.stdin:
        answer(run_in_fork(json.loads(line), arm))


if __name__ == "__main__":
    serve()
