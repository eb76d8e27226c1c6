"""Read damaged files in a separate process, which may crash, and print one line of JSON each.

Run as `python read_damaged.py READER FIRST COUNT FOLDER`; damage k has the seed k. Without
arguments it reads them, as JSON, from each line of its input, forks with the imports done, lets
the fork write to FOLDER.out and FOLDER.err, and answers with its exit code.
"""

import faulthandler
import importlib
import json
import logging
import os
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from readers import READERS

from hesr_model.errors import HesrError
from hesr_model.logs import parsed_file
from hesr_model.support.child import Child

IN_CHILD = 50  # every so many damages a log's parser runs in its child, as for users
LONGEST = 60.0  # [s] after which reading a file has hung
LONGEST_SENTENCE = 3000


def memory() -> int:
    """Peak memory of this process [B]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def say(**found: object) -> None:
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()


class ChildHere:
    """A child without a process: what its limits would hide is seen, and it costs nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def iterate(self, function: str, *arguments: Any, limit: int) -> Iterator[Any]:
        """Yield items as `Child.iterate`."""
        module, _, name = function.partition(":")
        for data, buffers in getattr(importlib.import_module(module), name)(*arguments):
            assert sum(map(len, buffers)) <= limit
            yield json.loads(json.dumps(data)), list(map(bytearray, buffers))

    def kill(self) -> None:
        """Do nothing."""


def damaged(name: str, first: int, count: int, folder: Path) -> None:
    reader = READERS[name]
    path = folder / f"file{reader.suffix}"
    reader.write(path)
    original = path.read_bytes()
    reader.read(path)  # an undamaged file
    logging.disable()
    warnings.simplefilter("ignore")
    before, longest = memory(), len(original)
    refused, slowest = 0, 0.0
    for seed in range(first, first + count):
        content = reader.damage(original, np.random.default_rng(seed))
        path.write_bytes(content)
        longest = max(longest, len(content))
        say(seed=seed)
        parsed_file.Child = Child if seed % IN_CHILD == 0 else ChildHere
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        start = time.monotonic()
        try:
            reader.read(path)
        except HesrError as error:
            refused += 1
            if "\n" in str(error) or len(str(error)) > LONGEST_SENTENCE:
                say(seed=seed, wrong=f"not a sentence: {str(error)[:500]}")
        except BaseException:
            say(seed=seed, wrong=traceback.format_exc())
        faulthandler.cancel_dump_traceback_later()
        slowest = max(slowest, time.monotonic() - start)
        if time.monotonic() - start > LONGEST:
            say(seed=seed, wrong="took too long")
    say(refused=refused, memory=memory() - before, longest=longest, slowest=slowest)


def serve() -> None:
    for line in sys.stdin:
        name, first, count, folder = json.loads(line)
        child = os.fork()
        if not child:
            for suffix, own in ((".out", sys.stdout), (".err", sys.stderr)):
                os.dup2(os.open(folder + suffix, os.O_WRONLY | os.O_CREAT), own.fileno())
            damaged(name, first, count, Path(folder))
            return
        say(code=os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


if len(sys.argv) > 1:
    damaged(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
else:
    serve()
