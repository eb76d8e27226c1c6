"""Every kind of wrong answer of a sandboxed process ends it with one sentence."""

import base64
import json
import socket
import sys
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmu_src.run.instance import CallError, LoadError, UnpackedFmu
from fmu_src.run.sandbox import Sandbox, SandboxedInstance
from hesr_model.support.child import INVALID_ANSWER
from hesr_model.support.child_main import LENGTH
from hesr_model.support.process import DiedError

MOST = 64
"""Size of the longest answer that is accepted [bytes]."""


def packed(*values: float) -> str:
    return base64.b64encode(np.array(values).tobytes()).decode()


def good(*results: Any) -> dict[str, Any]:
    return {"results": list(results), "ahead": [], "messages": []}


class AnsweringSandbox(Sandbox):
    """A sandbox without a process: `answer` is the next one; `ended` counts its ends."""

    def __init__(self) -> None:
        self.tells, self.buffers, self.seconds = [], 0, 1.0
        self.ended = 0
        self.requests: list[Any] = []
        self.answer: Any = good(None)

    def begin(self) -> None:
        pass

    def progress(self) -> tuple[int, int, int]:
        return 0, 0, 0

    def ask(self, request: Any, limit: int = 0, *, stepping: bool = False) -> Any:
        self.requests.append(request)
        self.limit = limit
        return self.answer

    def end_process(self, reason: str) -> DiedError:
        self.ended += 1
        return DiedError(reason)


def instance(sandbox: Sandbox, told: list[tuple[int, str]] | None = None) -> SandboxedInstance:
    fmu = UnpackedFmu(folder="f", guid="g", identifier="i", name="n")
    messages = [] if told is None else told

    def tell(status: int, text: str) -> None:
        messages.append((status, text))

    return SandboxedInstance(fmu, tell, lambda error: error, sandbox)


JUNK: tuple[Any, ...] = (
    None, 0, 3.5, True, "text", [], [1], {}, {"results": []}, {"messages": []},
    good(),  # no result
    {**good(None), "messages": [[0, 0]]},
    {**good(None), "messages": [[7, 0, "no such instance"]]},
    {**good(None), "messages": [[0, float("nan"), "status"]]},
    {**good(None), "messages": [[0, "status", "text"]]},
    {**good(None), "messages": [["0", 0, "text"]]},
    {**good(None), "messages": 5},
    {**good(None), "ahead": None},
    {**good(None), "results": None},
    {**good(None), "results": {}},
)  # fmt: skip
"""Answers that fit no call."""


@pytest.mark.parametrize("junk", JUNK, ids=repr)
def test_answers_of_another_form_end_the_process(junk: Any) -> None:
    sandbox = AnsweringSandbox()
    fmu = instance(sandbox)
    buffer = fmu.buffer([4, 5])
    for use in (lambda: fmu.step(0.0, 0.1), buffer.read, lambda: fmu.get("Integer", [1])):
        sandbox.answer, ended = junk, sandbox.ended
        with pytest.raises(DiedError, match=INVALID_ANSWER):
            use()
        assert sandbox.ended == ended + 1


@pytest.mark.parametrize(
    "text",
    [packed(), packed(1.0), packed(1.0, 2.0, 3.0), packed(1.0, 2.0)[:-1], "?", "", None, 5, [1.0]],
    ids=repr,
)
@pytest.mark.parametrize("ahead", [False, True])
def test_numbers_of_another_size_end_the_process(text: Any, ahead: bool) -> None:
    sandbox = AnsweringSandbox()
    fmu = instance(sandbox)
    buffer = fmu.buffer([4, 5])
    sandbox.answer = good(packed(0.5, np.nan))
    np.testing.assert_array_equal(buffer.read(), [0.5, np.nan])
    sandbox.answer = good(None) | {"ahead": [text]}
    if not ahead:
        sandbox.answer = good(None)
        fmu.step(0.0, 0.1)  # which makes them unknown
        sandbox.answer = good(text)
    use = (lambda: fmu.step(0.0, 0.1)) if ahead else buffer.read
    with pytest.raises(DiedError, match=INVALID_ANSWER):
        use()
    assert sandbox.ended == 1
    np.testing.assert_array_equal(buffer.values, [0.5, np.nan])


@pytest.mark.parametrize(
    ("kind", "found", "fits"),
    [
        ("Integer", [1, 2], True),
        ("Boolean", [True, False], True),
        ("String", ["a", ""], True),
        ("Integer", [1], False),
        ("Integer", [1, 2, 3], False),
        ("Integer", [1, 2.0], False),
        ("Integer", [1, float("nan")], False),
        ("Integer", [1, "2"], False),
        ("Integer", [1, None], False),
        ("Boolean", [True, []], False),
        ("String", ["a", 1], False),
        ("String", ["a", None], False),
        ("String", "a", False),
        ("Integer", None, False),
    ],
)
def test_values_of_another_type_or_number_end_the_process(
    kind: str, found: Any, fits: bool
) -> None:
    sandbox = AnsweringSandbox()
    fmu = instance(sandbox)
    sandbox.answer = good(found)
    if fits:
        assert fmu.get(kind, [1, 2]) == found
    else:
        with pytest.raises(DiedError, match=f"fmi2Get{kind} {INVALID_ANSWER}"):
            fmu.get(kind, [1, 2])
    assert sandbox.ended == (not fits)


@pytest.mark.parametrize(("key", "kind"), [("unloadable", LoadError), ("failed", CallError)])
def test_failures_and_messages_are_passed_on(key: str, kind: type[Exception]) -> None:
    sandbox = AnsweringSandbox()
    told: list[tuple[int, str]] = []
    fmu = instance(sandbox, told)
    sandbox.answer = {**good(), key: "no reason", "messages": [[0, 3, "first"], [0, 1, "last"]]}
    with pytest.raises(kind, match="no reason"):
        fmu.step(0.0, 0.1)
    assert told == [(3, "first"), (1, "last")]
    assert not sandbox.ended


def test_what_was_read_is_asked_for_with_the_next_step() -> None:
    """A write makes values read before it unknown."""
    sandbox = AnsweringSandbox()
    fmu = instance(sandbox)
    buffer = fmu.buffer([4, 5])
    sandbox.answer = good(packed(1.0, 2.0))
    buffer.read()
    sandbox.answer = good(None) | {"ahead": [packed(3.0, 4.0)]}
    fmu.step(0.0, 0.1)
    assert sandbox.requests[-1]["ahead"] == [buffer.number]
    requests = len(sandbox.requests)
    assert buffer.read().tolist() == [3.0, 4.0]
    assert len(sandbox.requests) == requests
    buffer.write()
    sandbox.answer = good(None, packed(5.0, 6.0))
    assert buffer.read().tolist() == [5.0, 6.0]
    assert [call[0] for call in sandbox.requests[-1]["calls"]] == ["write", "read"]


class ConnectedSandbox(Sandbox):
    """A sandbox whose process is this one, at the other end of a connection."""

    def __init__(self, seconds: float = 20.0, total: float = 20.0) -> None:
        self._socket, self.theirs = socket.socketpair()
        self._socket.settimeout(0.01)
        self.seconds, self._total = seconds, total
        self._run_deadline = time.monotonic() + total
        self._size, self._ended = 0, False
        self._has_reported = True
        process = SimpleNamespace(poll=lambda: None, wait=lambda _seconds: 3)
        self._child: Any = SimpleNamespace(process=process)

    def read_shared(self, begin: int, size: int) -> bytes:
        return bytes(size)

    def kill(self) -> None:
        self._ended = True
        self._socket.close()


@pytest.fixture
def connect() -> Iterator[Callable[..., ConnectedSandbox]]:
    """Return a function that makes sandboxes; all are closed at the end."""
    sandboxes: list[ConnectedSandbox] = []

    def make(**options: float) -> ConnectedSandbox:
        sandboxes.append(ConnectedSandbox(**options))
        return sandboxes[-1]

    yield make
    for sandbox in sandboxes:
        sandbox.kill()
        sandbox.theirs.close()


Connect = Callable[..., ConnectedSandbox]


def framed(content: bytes, size: int | None = None) -> bytes:
    return LENGTH.pack(len(content) if size is None else size) + content


@pytest.mark.parametrize(
    "data",
    [
        framed(b"[1]", 2),  # more than stated
        framed(b"[1]") + b"x",
        framed(b"1" * (MOST + 1)),
        framed(b"", 2**32 - 1),
        framed(b""),
        framed(b"[1"),
        framed(b"\xff\xfe"),
        framed(b"nonsense"),
        framed(b"[" * MOST),
    ],
)
def test_bytes_that_are_no_answer_end_the_process(data: bytes, connect: Connect) -> None:
    sandbox = connect()
    sandbox.theirs.sendall(data)
    with pytest.raises(DiedError, match=INVALID_ANSWER):
        sandbox.ask("request", MOST)
    assert sandbox._ended


def test_answers_nested_without_end_end_the_process(connect: Connect) -> None:
    nested = b"[" * (10 * sys.getrecursionlimit())
    sandbox = connect()
    sandbox.theirs.sendall(framed(nested))
    with pytest.raises(DiedError, match=INVALID_ANSWER):
        sandbox.ask("request", len(nested))
    assert sandbox._ended


@pytest.mark.parametrize("data", [b"", b"\0", framed(b"[1]", 4), framed(b"[1]", 4)[:4]])
@pytest.mark.parametrize("closed", [False, True])
def test_answers_that_end_early_end_the_process(
    data: bytes, closed: bool, connect: Connect
) -> None:
    sandbox = connect(seconds=0.05)
    sandbox.theirs.sendall(data)
    if closed:
        sandbox.theirs.shutdown(socket.SHUT_WR)
    said = "exit code 3" if closed else "no answer within 0.05 s"
    with pytest.raises(DiedError, match=said):
        sandbox.ask("request", MOST)
    assert sandbox._ended


def test_answers_up_to_the_longest_are_read(connect: Connect) -> None:
    for content in (b'"' + b"x" * (MOST - 2) + b'"', b"[NaN]", b"0"):
        sandbox = connect()
        sandbox.theirs.sendall(framed(content))
        assert repr(sandbox.ask({"who": 1}, MOST)) == repr(json.loads(content))
        request = sandbox.theirs.recv(100)
        assert request == framed(b'{"who": 1}')


@pytest.mark.parametrize("answer", [5, None, [], {}, {"results": 1}, "raised"])
def test_functions_that_answer_otherwise_end_the_process(answer: Any) -> None:
    sandbox = AnsweringSandbox()
    sandbox.answer = answer
    with pytest.raises(DiedError):
        sandbox.run("module:function")
    assert sandbox.ended == 1
