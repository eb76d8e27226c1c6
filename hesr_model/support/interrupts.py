"""Ctrl-C and SIGTERM, put off until what must not be torn apart is done."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def deferred() -> Iterator[None]:
    """Let a signal that would end the program wait until the block is done.

    The block must be short. Processes that are started in it begin with Ctrl-C held back, so that
    they can say what it does to them. In another thread than the main one, where no such signal
    arrives, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        # Processes inherit this. It does not do for the handlers: it holds for this thread only,
        # and a signal that another one takes is still answered in this one.
        with _held_back_here():
            yield
    finally:
        for number, handler in before.items():
            if handler is not None:  # one that C code has set cannot be set again
                signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextmanager
def _held_back_here() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):  # not on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interrupted(KeyboardInterrupt):
    """Interrupt of work that can be continued.

    Parameters
    ----------
    kept : what is kept and how to continue; the end of a sentence.
    interrupt : the original interrupt.
    """

    def __init__(self, kept: str, interrupt: KeyboardInterrupt) -> None:
        super().__init__(kept)
        self.kept, self.interrupt = kept, interrupt
