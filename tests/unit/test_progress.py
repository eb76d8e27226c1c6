import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from hesr_model.support import parallel
from hesr_model.support.progress import (
    listed_in,
    make_file_progress,
    report_progress,
    silent,
    step,
    steps_told,
    watched,
)


def test_items_are_counted_before_each_and_after_the_last() -> None:
    told: list[object] = []

    def work() -> Iterator[str]:
        for item in report_progress("ab", lambda done, total: told.append((done, total))):
            told.append(item)
            yield item

    assert list(work()) == ["a", "b"]
    assert told == [(0, 2), "a", (1, 2), "b", (2, 2)]


def test_items_are_listed_while_in_progress() -> None:
    names: list[str] = []
    with listed_in(names):
        seen = [(item, names.copy()) for item in report_progress([1, 2], silent, str)]
    assert (seen, names) == ([(1, ["1"]), (2, ["2"])], [])


@pytest.mark.parametrize("workers", [1, 2])
def test_jobs_are_listed_while_they_run(workers: int) -> None:
    class Names(list[str]):
        def append(self, name: str) -> None:
            super().append(name)
            most.append(len(self))

    most: list[int] = []
    names, jobs = Names(), [partial(time.sleep, 0.05)] * 5
    with listed_in(names), parallel.results_of(jobs, workers, names=list("abcde")) as results:
        assert list(results) == [None] * 5
    assert (names, len(most), max(most)) == ([], 5, workers)


def test_progress_without_a_listener_is_dropped() -> None:
    assert list(report_progress([1, 2, 3], silent)) == [1, 2, 3]


def test_steps_of_a_job_reach_its_listener(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    step(1, 2)
    with steps_told(lambda *now: told.append(now)):
        step(1, 2)
    step(2, 2)
    assert told == [(1, 2)]


def test_shares_of_jobs_in_other_processes_are_summed(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    files = [tmp_path / "a", tmp_path / "b"]
    with watched(files, lambda *now: told.append(now)):
        tell = make_file_progress(files[0])
        tell(1, 4)
        tell(1, 8)  # a second search within the fit restarts
        assert files[0].read_text() == "25"
        while (25, 200) not in told:
            time.sleep(0.01)
    assert told[0] == (0, 200)
    assert told[-1] == (200, 200)
