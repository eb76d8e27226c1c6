"""Damaged files of every kind are read or refused in one sentence, without crash, hang or flood.

Damage k of a reader has the seed k, so a failure is reproduced by
`python tests/fuzz/read_damaged.py READER k 1 FOLDER`.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from readers import READERS

CHILD = Path(__file__).with_name("read_damaged.py")
MOST_MEMORY = (20, 500 * 2**20)
"""Memory limit: multiple of the input, plus bytes."""

MANY = int(os.environ.get("DAMAGED", "2000"))  # files of each kind

NEEDS = {
    ".xlsx": "openpyxl",
    ".h5": "h5py",
    ".mat": "h5py",
    ".bag": "rosbags",
    ".db3": "rosbags",
    ".mcap": "rosbags",
}


Ask = Callable[[str, int, int, Path], int]


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    """Return a function that reads in a fork of one process, and returns its exit code."""
    command = [sys.executable, str(CHILD)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        given, said = process.stdin, process.stdout
        assert given is not None
        assert said is not None

        def answer(name: str, first: int, count: int, folder: Path) -> int:
            given.write(json.dumps([name, first, count, str(folder)]) + "\n")
            given.flush()
            return int(json.loads(said.readline())["code"])

        yield answer


def read_damaged(ask: Ask, name: str, first: int, count: int, folder: Path) -> None:
    if needed := NEEDS.get(READERS[name].suffix):
        pytest.importorskip(needed, reason=f"{needed} is not installed")
    sys.stdout.write(f"seeds {first} to {first + count - 1}\n")
    code = ask(name, first, count, folder)
    out, err = (Path(f"{folder}{kind}").read_text(errors="replace") for kind in (".out", ".err"))
    lines = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    wrong = [line for line in lines if "wrong" in line]
    assert not wrong, "\n".join(f"seed {line['seed']}: {line['wrong']}" for line in wrong[:5])
    assert code == 0, f"after {lines[-1:]}: {err[-3000:]}"
    end = lines[-1]
    assert 0.3 * count < end["refused"] <= count  # most damage does matter
    share, more = MOST_MEMORY
    assert end["memory"] <= share * end["longest"] + more


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused(ask: Ask, name: str, tmp_path: Path) -> None:
    read_damaged(ask, name, 0, 200, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files_are_read_or_refused(ask: Ask, name: str, tmp_path: Path) -> None:
    read_damaged(ask, name, 200, MANY, tmp_path)
