"""Damaged files of every kind are read or refused in one sentence, without crash, hang or flood.

Damage k of a reader has the seed k, so a failure is reproduced by
`python tests/fuzz/read_damaged.py READER k 1 FOLDER`.
"""

import json
import os
import subprocess
import sys
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


def read_damaged(name: str, first: int, count: int, folder: Path) -> None:
    if needed := NEEDS.get(READERS[name].suffix):
        pytest.importorskip(needed, reason=f"{needed} is not installed")
    sys.stdout.write(f"seeds {first} to {first + count - 1}\n")
    child = subprocess.run(
        [sys.executable, str(CHILD), name, str(first), str(count), str(folder)],
        capture_output=True,
        text=True,
        check=False,
        errors="replace",
    )
    lines = [json.loads(line) for line in child.stdout.splitlines() if line.startswith("{")]
    wrong = [line for line in lines if "wrong" in line]
    assert not wrong, "\n".join(f"seed {line['seed']}: {line['wrong']}" for line in wrong[:5])
    assert child.returncode == 0, f"after {lines[-1:]}: {child.stderr[-3000:]}"
    end = lines[-1]
    assert 0.3 * count < end["refused"] <= count  # most damage does matter
    share, more = MOST_MEMORY
    assert end["memory"] <= share * end["longest"] + more


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused(name: str, tmp_path: Path) -> None:
    read_damaged(name, 0, 200, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    read_damaged(name, 200, MANY, tmp_path)
