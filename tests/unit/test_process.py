"""Exit statuses of processes in words."""

import pytest

from hesr_model.support.process import how_it_ended


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0, "ended its process with exit code 0"),
        (1, "ended its process with exit code 1"),
        (-11, "crashed with signal 11 (SIGSEGV)"),
    ],
)
def test_exit_status_in_words(code: int, text: str) -> None:
    assert how_it_ended(code) == text
