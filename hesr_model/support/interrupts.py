"""Deferral of Ctrl-C and SIGTERM during short critical blocks."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def deferred() -> Iterator[None]:
    """Defer signals that would end the program; new processes begin with Ctrl-C blocked."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        # Child processes inherit the mask. It cannot replace the handlers, because another thread
        # may take the signal.
        with _held_back_here():
            yield
    finally:
        for number, handler in before.items():
            if handler is not None:  # None if set by C code
                signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextmanager
def _held_back_here() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interrupted(KeyboardInterrupt):
    """Interrupt of work that can be continued; `kept` describes how."""

    def __init__(self, kept: str, interrupt: KeyboardInterrupt) -> None:
        super().__init__(kept)
        self.kept, self.interrupt = kept, interrupt
