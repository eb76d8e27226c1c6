"""Jobs in worker processes: their output and input do not disturb the answers."""

import os
import sys

from hesr_model.support.parallel import results_of


def noisy() -> tuple[str, str]:
    print("a job prints")  # noqa: T201
    os.write(1, b"and writes")
    return sys.stdin.read(), os.read(0, 9).decode()


def test_jobs_may_print_and_read() -> None:
    for workers in (1, 2):
        jobs = [lambda k=k: k for k in range(6)]
        jobs[2:4] = [noisy, noisy] if workers > 1 else []
        with results_of(jobs, workers) as results:
            found = list(results)
        assert found == ([0, 1, ("", ""), ("", ""), 4, 5] if workers > 1 else [0, 1, 4, 5])
