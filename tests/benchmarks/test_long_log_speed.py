"""Peak memory and CPU time of `identify` on long logs of six joints."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from long_logs import long_table, write_robot

CHILD = """
import resource, sys, hesr
body = hesr.identify(sys.argv[1], robot=sys.argv[2])
used = resource.getrusage(resource.RUSAGE_SELF)
print(body.rows, used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)
"""


@pytest.mark.parametrize("kind", ["npy", "parquet"])
def test_identify(kind: str, tmp_path: Path, tell: Callable[[str], None]) -> None:
    robot, found = write_robot(tmp_path, joints=6), {}
    for rows in (10**6, 10**7):
        log, table = tmp_path / f"log.{kind}", long_table(robot, rows)
        if kind == "npy":
            np.save(log, table)
        else:
            from pyarrow import parquet
            from pyarrow import table as columns

            parquet.write_table(
                columns(dict(zip("abcdefghijklmnopqrs", table.T, strict=True))), log
            )
        del table
        done = subprocess.run(
            [sys.executable, "-c", CHILD, log, robot], check=True, capture_output=True, text=True
        )
        count, memory, seconds = map(float, done.stdout.split()[-3:])
        assert count == rows
        tell(f"identify, {rows:.0e} rows of {kind}: {memory:.0f} MB, {seconds:.0f} CPU s")
        found[rows] = seconds
    tell(f"identify, {kind}: 10^7 rows take {found[10**7] / found[10**6]:.2f} times 10^6 rows")
