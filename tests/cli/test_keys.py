"""Keys of a terminal come one by one, and the terminal is as before at any end."""

from __future__ import annotations

import io
import os
import pty
import signal
import sys
import termios
import time
from contextlib import suppress

import pytest

from candata_cli.keys import typed_keys


@pytest.fixture
def terminal(monkeypatch):
    """A pseudo-terminal on stdin; yields the end that a person types on, and the other's descriptor."""
    person, program = os.openpty()
    with os.fdopen(program, "r", closefd=False) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield person, program
    os.close(person)
    with suppress(OSError):
        os.close(program)


def read_until(typed, count):
    keys, until = [], time.monotonic() + 20
    while len(keys) < count and time.monotonic() < until:
        keys += typed()
        time.sleep(0.01)
    return keys


@pytest.mark.parametrize("fails", [False, True])
def test_keys_come_without_enter_and_the_terminal_is_put_back(terminal, fails):
    person, program = terminal
    before = termios.tcgetattr(program)
    with suppress(KeyboardInterrupt), typed_keys() as (typed, problem):
        assert problem == ""
        assert termios.tcgetattr(program) != before
        begun_ns = time.monotonic_ns()
        os.write(person, b" s")
        keys = read_until(typed, 2)
        assert [key for _, key in keys] == [" ", "s"]
        assert begun_ns <= keys[0][0] <= time.monotonic_ns()
        os.write(person, b"\x1b[D")  # an arrow is no drop
        time.sleep(0.2)
        os.write(person, b"x")
        assert [key for _, key in read_until(typed, 1)] == ["x"]
        if fails:
            raise KeyboardInterrupt
    assert termios.tcgetattr(program) == before


def test_without_a_terminal_there_are_no_keys_and_why_is_said(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(" s"))
    with typed_keys() as (typed, problem):
        assert (list(typed()), problem) == ([], "stdin is closed")
    read_end, write_end = os.pipe()
    with os.fdopen(read_end) as pipe:
        monkeypatch.setattr("sys.stdin", pipe)
        with typed_keys() as (typed, problem):
            assert (list(typed()), problem) == ([], "stdin is no terminal")
    os.close(write_end)


#: What the child runs: it waits with the keys on, as a recording does, until it is told to end.
CHILD = """
import time
from candata_cli.keys import typed_keys
from candata_cli.record_command import _until_signal
with _until_signal() as stop, typed_keys() as (typed, problem):
    print("ready", problem, flush=True)
    while True:
        time.sleep(0.05)
"""


def test_a_second_sigterm_ends_the_program_and_leaves_the_echo_on():
    child, person = pty.fork()
    if not child:
        os.execv(sys.executable, [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path!r}\n{CHILD}"])
    try:
        text = b""
        while b"ready" not in text:
            text += os.read(person, 1000)
        assert not termios.tcgetattr(person)[3] & termios.ECHO
        for _ in range(2):
            os.kill(child, signal.SIGTERM)
            time.sleep(0.3)
        until = time.monotonic() + 20
        while not termios.tcgetattr(person)[3] & termios.ECHO:
            assert time.monotonic() < until
            time.sleep(0.05)
    finally:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(person)
