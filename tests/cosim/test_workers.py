"""Real worker processes: fresh, killed, interrupted, orphaned; none is left behind."""

import os
import re
import signal
from pathlib import Path

import pytest
from containing import OneSentence
from processes import (
    HANG,
    assert_nothing_left,
    assert_nothing_runs,
    started,
    wait_for,
    workers,
)

from hesr_model.support.files import models_folder

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are found in /proc"),
]

TABLE_1 = models_folder() / "uf850" / "table1.json"
LOST = "hesr: a worker process was killed"

FITS = """
import sys
from pathlib import Path

import numpy as np

from hesr_model import FrictionRecord, fit

print("imported", file=sys.stderr)


def record(joint):
    t = np.arange(400) * 0.005
    dq = np.sin(9.0 * t + joint)
    return FrictionRecord(
        log="run", joint=f"j{joint}", t=t, q=-np.cos(9.0 * t + joint) / 9.0, dq=dq,
        tau=(2.0 + joint) * np.sign(dq) + 0.5 * dq, tau_load=np.zeros(400),
    )


log = [record(joint) for joint in range(3)]
alone, shared = (fit("stribeck", log, workers=n) for n in (1, 2))
print(alone.laws == shared.laws, [law.values["F_c"] for law in shared.laws])
"""

JOBS = """
import os, sys, time
from hesr_model.support.parallel import results_of

class Mine:  # of this script, which workers do not import
    def __init__(self, k):
        self.k = k

    def __call__(self):
        from threadpoolctl import threadpool_info
        import scipy.linalg
        return self.k, {pool["num_threads"] for pool in threadpool_info()}, os.getpid()

"""

SLEEPERS = """
def sleep():
    open(f"asleep-{os.getpid()}", "w").close()
    time.sleep(600)

with results_of([sleep] * 4, 2) as results:
    for result in results:
        pass
"""


def script(folder: Path, text: str) -> tuple[str, ...]:
    (folder / "script.py").write_text(text, encoding="utf-8")
    return ("script.py",)


def output_of(text: str, folder: Path) -> str:
    """Return the output of a script that succeeds without standard error."""
    with started(folder=folder, program=script(folder, text)) as process:
        out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    return out


def test_a_script_needs_no_main_guard(tmp_path: Path) -> None:
    with started(folder=tmp_path, program=script(tmp_path, FITS)) as process:
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert err == "imported\n"  # once: workers do not rerun the script
    same, *levels = re.findall(r"True|False|[0-9.]+", out)
    assert same == "True"
    assert [round(float(level)) for level in levels] == [2, 3, 4]
    assert_nothing_left(process.pid, tmp_path)


def test_jobs_run_in_fresh_processes_with_one_thread_each(tmp_path: Path) -> None:
    """One thread for every library, including those imported later."""
    text = JOBS + (
        "for _ in range(2):\n"
        "    with results_of([Mine(k) for k in range(5)], 2) as results:\n"
        "        print(*results, os.getpid(), sep='; ')\n"
    )
    program = script(tmp_path, text)
    with started(folder=tmp_path, program=program, OMP_NUM_THREADS="7") as process:
        out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    blocks = [[eval(part) for part in line.split("; ")] for line in out.splitlines()]
    assert len(blocks) == 2
    for *results, parent in blocks:
        assert [k for k, _, _ in results] == [0, 1, 2, 3, 4]
        assert all(threads == {1} for _, threads, _ in results)
        assert parent not in {number for _, _, number in results}
    one, other = ({number for _, _, number in results} for *results, _ in blocks)
    assert not one & other


def test_blocks_share_processes_until_one_fails(tmp_path: Path) -> None:
    text = JOBS + (
        "from hesr_model.support.parallel import one_pool\n"
        "def fail(): raise ZeroDivisionError\n"
        "def block():\n"
        "    with results_of([Mine(k) for k in range(6)]) as results:\n"
        "        return {number for _, _, number in results}\n"
        "with one_pool():\n"
        "    first = block() | block()\n"
        "    try:\n"
        "        with results_of([fail, fail]) as results:\n"
        "            list(results)\n"
        "    except ZeroDivisionError:\n"
        "        later = block()\n"
        "alone = block()\n"
        "print(len(first) <= os.cpu_count(), first & later, (first | later) & alone)\n"
    )
    with started(folder=tmp_path, program=script(tmp_path, text)) as process:
        out, err = process.communicate(timeout=120)
    assert (process.returncode, out, err) == (0, "True set() set()\n", "")
    assert_nothing_left(process.pid, tmp_path)


def test_workers_import_while_their_parent_works(tmp_path: Path) -> None:
    text = JOBS + (
        "import sys\n"
        "from hesr_model.support.parallel import one_pool\n"
        "def loaded(): return 'wave' in sys.modules\n"
        "with one_pool('colorsys', 'wave'):\n"
        "    with results_of([loaded] * 4) as results:\n"
        "        print(list(results), loaded())\n"
    )
    assert output_of(text, tmp_path) == "[True, True, True, True] False\n"


def test_the_first_job_runs_before_its_result_is_requested(tmp_path: Path) -> None:
    text = JOBS + (
        "from pathlib import Path\n"
        "from hesr_model.support.parallel import one_pool\n"
        "def mark(): Path('mark').touch()\n"
        "def fail(): raise ZeroDivisionError\n"
        "def last():\n"
        "    for _ in range(600):  # another process may still be at it\n"
        "        if Path('mark').exists():\n"
        "            return 'done'\n"
        "        time.sleep(0.1)\n"
        "with one_pool('colorsys', first=[fail, mark]):\n"
        "    with results_of([last] * 4) as results:\n"
        "        print(list(results))\n"
    )
    assert output_of(text, tmp_path) == f"{['done'] * 4}\n"


@pytest.mark.quiet
def test_expensive_jobs_start_first_and_results_keep_their_order(tmp_path: Path) -> None:
    text = JOBS + (
        "from functools import partial\n"
        "def timed(k):\n"
        "    now = time.monotonic()\n"
        "    time.sleep(1.0)  # longer than a busy machine keeps a process waiting\n"
        "    return k, now\n"
        "jobs = [partial(timed, k) for k in range(6)]\n"
        "with results_of(jobs, 2, [1.0, 5.0, 2.0, 6.0, 4.0, 3.0]) as results:\n"
        "    found = list(results)\n"
        "order = [k for k, _ in sorted(found, key=lambda pair: pair[1])]\n"
        "print([k for k, _ in found], set(order[:2]), set(order[2:4]))\n"
    )
    assert output_of(text, tmp_path) == "[0, 1, 2, 3, 4, 5] {1, 3} {4, 5}\n"


def test_a_worker_within_the_memory_limit_is_kept(tmp_path: Path) -> None:
    """Imports alone may take 600 MB, and a new worker needs seconds for them."""
    text = JOBS + (
        "def grown(k):\n"
        "    import gc, builtins\n"
        "    builtins.kept = [getattr(builtins, 'kept', None), b'x' * (200 << 20)]\n"
        "    return os.getpid(), gc.get_threshold()[0]\n"
        "from functools import partial\n"
        "with results_of([partial(grown, k) for k in range(6)], 2) as results:\n"
        "    found = list(results)\n"
        "print(len({number for number, _ in found}), {often for _, often in found})\n"
    )
    assert output_of(text, tmp_path) == "2 {100000}\n"


@pytest.mark.quiet
def test_a_worker_beyond_the_memory_limit_is_replaced(tmp_path: Path) -> None:
    text = JOBS + (
        "def grow():\n"
        "    import builtins\n"
        "    builtins.kept = b'x' * (1100 << 20)\n"
        "    return os.getpid(), False\n"
        "def small():\n"
        "    import builtins\n"
        "    time.sleep(0.2)\n"
        "    return os.getpid(), hasattr(builtins, 'kept')\n"
        "with results_of([grow] + [small] * 20, 2) as results:\n"
        "    (grown, _), *later = results\n"
        "print(grown in dict(later), any(kept for _, kept in later))\n"
    )
    assert output_of(text, tmp_path) == "True False\n"


def test_a_job_may_print_and_read(tmp_path: Path) -> None:
    """Neither disturbs the pipes that carry the jobs."""
    text = JOBS + (
        "def talk():\n"
        "    os.write(1, b'by a library\\n')\n"
        "    return sys.stdin.read(), Mine(3).k\n"
        "with results_of([talk] * 3, 2) as results:\n"
        "    print(list(results))\n"
    )
    with started(folder=tmp_path, program=script(tmp_path, text)) as process:
        out, err = process.communicate(timeout=60)
    assert (out, err) == (f"{[('', 3)] * 3}\n", "by a library\n" * 3)


def test_an_error_of_a_job_keeps_its_traceback(tmp_path: Path) -> None:
    text = JOBS + (
        "class Odd(Exception):\n"
        "    def __reduce__(self): raise TypeError\n"
        "def fail(): raise ZeroDivisionError('of a job')\n"
        "def fail_oddly(): raise Odd('of a job')\n"
        "for job in (fail, fail_oddly):\n"
        "    try:\n"
        "        with results_of([job] * 2, 2) as results:\n"
        "            list(results)\n"
        "    except Exception as error:\n"
        "        print(repr(error), 'in fail' in ''.join(getattr(error, '__notes__', '')))\n"
    )
    assert output_of(text, tmp_path) == (
        "ZeroDivisionError('of a job') True\nRuntimeError(\"Odd('of a job')\") False\n"
    )


def test_a_killed_worker_is_one_sentence(tmp_path: Path) -> None:
    answer = tmp_path / "answer.json"
    command = ("test", "uf850-table1", TABLE_1, "--kind", "properties", "-o", answer)
    with started(*command, folder=tmp_path) as process:
        # Some compile and some already run FMUs; both have files and possibly processes.
        wait_for(lambda: list((tmp_path / "tmp").glob("hesr-*/files/hesr-*")), process)
        os.kill(workers(process.pid)[0], signal.SIGKILL)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert (out, err) == ("", OneSentence(LOST))
    assert {path.name for path in tmp_path.iterdir()} == {"tmp"}
    assert_nothing_left(process.pid, tmp_path)


@pytest.mark.parametrize("crash", ["os.abort()", "os._exit(0)"])
def test_a_crashed_worker_prints_nothing(crash: str, tmp_path: Path) -> None:
    text = JOBS + (
        f"def crash(): {crash}\n"
        "try:\n"
        "    with results_of([Mine(0), crash, Mine(2)], 2) as results:\n"
        "        list(results)\n"
        "except Exception as error:\n"
        "    sys.exit(f'hesr: {error}')\n"
    )
    with started(folder=tmp_path, program=script(tmp_path, text)) as process:
        _, err = process.communicate(timeout=60)
    assert err == OneSentence(LOST)
    assert_nothing_left(process.pid, tmp_path)


@pytest.mark.parametrize(
    ("number", "pattern"),
    [
        (signal.SIGINT, "hesr-*"),  # of the workers, which start
        (signal.SIGINT, "hesr-*/files/jobs*"),  # and import
        (signal.SIGINT, "hesr-*/files/hesr-*"),  # and work
        (signal.SIGTERM, "hesr-*/files/hesr-*"),
    ],
)
def test_signals_to_the_group_are_handled_once(
    number: signal.Signals, pattern: str, tmp_path: Path
) -> None:
    """Also during the start of workers, before they handle signals."""
    with started(
        "test", "uf850-table1", TABLE_1, "--kind", "properties", folder=tmp_path
    ) as process:
        wait_for(lambda: workers(process.pid), process)
        wait_for(lambda: list((tmp_path / "tmp").glob(pattern)), process)
        os.killpg(process.pid, number)
        out, err = process.communicate(timeout=HANG)
    who = "interrupted" if number == signal.SIGINT else "ended by another program"
    assert (out, err) == ("", f"hesr: {who}; no file is half-written.\n")
    assert process.returncode == 128 + number
    assert_nothing_left(process.pid, tmp_path)


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    """They sleep for minutes and get no signal."""
    with started(folder=tmp_path, program=script(tmp_path, JOBS + SLEEPERS)) as process:
        wait_for(lambda: len(list(tmp_path.glob("asleep-*"))) == 2, process)
        assert len(workers(process.pid)) == 2
        os.kill(process.pid, signal.SIGKILL)
        process.communicate(timeout=60)
    assert_nothing_left(process.pid, tmp_path)


def test_a_failing_job_stops_the_others_and_its_error_is_raised(tmp_path: Path) -> None:
    text = JOBS + (
        "def fail(): raise ZeroDivisionError('of a job')\n"
        "def sleep(): time.sleep(600)\n"
        "try:\n"
        "    with results_of([Mine(0), fail, sleep, sleep], 3) as results:\n"
        "        for result in results:\n"
        "            print(result[0])\n"
        "except ZeroDivisionError as error:\n"
        "    print(error)\n"
    )
    with started(folder=tmp_path, program=script(tmp_path, text)) as process:
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "0\nof a job\n", "")
    assert_nothing_runs(process.pid)
