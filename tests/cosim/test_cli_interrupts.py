"""Ctrl-C and SIGTERM sent to the real process: no partial files, one sentence, checkpoints kept.

test_bad_input.py tests an interrupt while many processes fit laws.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from containing import Containing
from processes import HANG, running, started, wait_for, wait_for_line
from small_study import contents, uf850, write_study
from small_twin import GAINS

from hesr.cli.console import interrupt_on_signals
from hesr_model.support import result_folder
from hesr_model.support.progress import deferred

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX"),
]

STOPPED = "hesr: interrupted; no file is half-written"
ENDED = "hesr: ended by another program; no file"
LOOP = """
[tracking]
seeds = [11, 12, 13]
duration = 1.0
harmonics = 3
peak_velocity = [0.3, 0.3, 0.3]
offset = [0.0, 0.3, -1.9]
Kx = 5.0
drift = 1.0
"""


def ended(process: "subprocess.Popen[str]", number: int, folder: Path) -> str:
    """Send a signal to the group, as a terminal does; return the output after it."""
    os.killpg(process.pid, number)
    out, err = process.communicate(timeout=HANG)
    assert process.returncode == 128 + number, (out, err)
    assert out == ""
    assert "Traceback" not in err
    assert not list((folder / "tmp").iterdir())
    return str(err)


def one_sentence(text: str, beginning: str) -> None:
    assert len(text.splitlines()) == 1, text
    assert text.startswith(beginning)
    assert text.endswith(".\n")


@pytest.mark.parametrize(
    ("number", "moment"),
    [(signal.SIGINT, "import"), (signal.SIGTERM, "source"), (signal.SIGINT, "compiler")],
)
def test_interrupts_work_from_the_first_import_to_the_build(
    number: signal.Signals, moment: str, tmp_path: Path, empty_cache: Path
) -> None:
    """The command builds for all platforms and has not yet finished the first."""
    output = tmp_path / "Friction.fmu"
    output.write_text("old", encoding="utf-8")
    arguments = ("export", "uf850-table1", "--platform", "all", "-o", output, "--verbose")
    with started(*arguments, folder=tmp_path) as process:
        wait_for_line(process, lambda line: "building Friction.fmu" in line)
        if moment == "source":
            wait_for(lambda: list((tmp_path / "tmp").rglob("*.c")), process)
        elif moment == "compiler":
            wait_for(lambda: "zig cc" in " ".join(running(process.pid).values()), process)
        err = ended(process, number, tmp_path)
    one_sentence(err.splitlines(keepends=True)[-1], ENDED if number == signal.SIGTERM else STOPPED)
    assert output.read_text(encoding="utf-8") == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"Friction.fmu", "tmp"}


def test_interrupts_work_while_the_arm_runs(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    before = contents(tmp_path)
    with started("run", study, "-o", "results", folder=tmp_path) as process:
        wait_for(lambda: list(tmp_path.glob(".hesr-*/files/results/logs/*")), process)
        one_sentence(ended(process, signal.SIGINT, tmp_path), STOPPED)
    assert contents(tmp_path) == before
    assert not list(tmp_path.glob(".*"))


class Freed:
    """An object that receives a signal in its finaliser, where exceptions are ignored."""

    def __init__(self, number: signal.Signals) -> None:
        self.number = number

    def __del__(self) -> None:
        signal.raise_signal(self.number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_a_finaliser_is_not_lost(number: signal.Signals) -> None:
    kept = [Freed(number)]

    def work() -> None:
        kept.clear()
        time.sleep(30.0)

    with interrupt_on_signals(), pytest.raises(KeyboardInterrupt) as raised:
        work()
    assert (raised.type is KeyboardInterrupt) == (number == signal.SIGINT)


def test_an_interrupted_closed_loop_names_its_checkpoint(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    text = study.read_text(encoding="utf-8").replace(
        'laws = ["stribeck", "parfam_h"]', 'laws = ["stribeck"]'
    )
    signals = f'[twin]\nsignals = "{uf850("arm.toml")}"'
    study.write_text(text.replace("[twin]", signals) + LOOP + GAINS, encoding="utf-8")
    before = contents(tmp_path)
    kept = tmp_path / ".results-unfinished"
    command = ("run", study, "-o", tmp_path / "results")
    with started(*command, folder=tmp_path) as process:
        wait_for(lambda: len(list(kept.glob("[!.]*.json"))) >= 2, process)  # no partial files
        said = ended(process, signal.SIGINT, tmp_path)
    one_sentence(said, STOPPED)
    found = re.search(r"(\d+) finished rows of the closed loop are kept in (\S+): ", said)
    assert found, said
    assert said.endswith("repeat the command to continue.\n")
    assert found[2] == str(kept)
    rows = int(found[1])
    assert rows == len(list(kept.glob("*.json"))) >= 2
    # Also those of the folds, by which laws are judged.
    laws = len(list(kept.glob("laws/*.json")))
    assert f", and {laws} laws of joints, " in said
    assert laws >= 3
    assert {p.suffix for p in kept.rglob("*") if p.is_file()} == {".json"}
    assert not list(kept.rglob(".*"))  # no partial files among them
    assert contents(tmp_path, without=[p.name for p in kept.rglob("*")]) == before
    # The next run does resume from there.
    with started(*command, "--verbose", folder=tmp_path) as process:
        assert process.stderr
        known: dict[str, int] = {}
        for line in process.stderr:
            progress = re.search(r"(tracking.*|robustness): (\d+) of (\d+)$", line.strip())
            if progress and progress[1] not in known:
                known[progress[1]] = int(progress[2])
                if progress[2] != progress[3]:
                    break
        assert sum(known.values()) == rows
        said = ended(process, signal.SIGTERM, tmp_path)
    assert said.splitlines()[-1] == Containing(ENDED, ", and ")


def test_a_command_that_ignores_interrupts_completes(tmp_path: Path) -> None:
    """Like a background command of a script."""
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "print('ignored', file=sys.stderr, flush=True)\n"
        "from hesr.cli import main; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, "fit", "--list", "--verbose"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for_line(process, lambda line: line == "ignored")
    while process.poll() is None:  # interrupts at all moments; the output fits into its pipe
        process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    out, _ = process.communicate()
    assert process.returncode == 0
    assert "ParFam-H" in out


# --- atomic blocks -----------------------------------------------------------------------------


def test_an_interrupt_waits_until_the_block_is_done() -> None:
    done = []

    def work() -> None:
        with deferred():
            signal.raise_signal(signal.SIGINT)
            done.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_received_by_another_thread_also_waits() -> None:
    """Threads of BLAS or of a process pool receive it while the main thread blocks it."""
    done = []
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()

    def work() -> None:
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            done.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        over.set()
        other.join()
    assert done


def test_a_process_starts_with_interrupts_blocked() -> None:
    """Otherwise Ctrl-C could end it before it leaves the signal to its parent."""
    program = (
        "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()),"
        " signal.SIGTERM in signal.pthread_sigmask(signal.SIG_BLOCK, ()))"
    )

    def begun() -> str:
        return subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        ).stdout

    with deferred():
        assert begun() == "True False\n"
    assert begun() == "False False\n"


def test_results_are_replaced_all_or_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C arrives just before old and new files are exchanged."""
    exchange = result_folder.exchange

    def interrupted(*names: Any) -> bool:
        signal.raise_signal(signal.SIGINT)
        return exchange(*names)

    monkeypatch.setattr(result_folder, "exchange", interrupted)

    def work(text: str) -> None:
        with result_folder.folder_written_whole(tmp_path / "results") as folder:
            for name in "abc":
                (folder / name).write_text(text, encoding="utf-8")

    work("old")
    with pytest.raises(KeyboardInterrupt):
        work("new")
    found = contents(tmp_path, without=[result_folder.LIST])
    assert found == {f"results/{name}": b"new" for name in "abc"}
