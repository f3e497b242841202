"""The command line, run in the process of the test."""

import contextlib
import io
from types import SimpleNamespace

import pytest

from candata_cli import main as entry


def exit_code(*arguments: object) -> int:
    """Run a command and return its exit code; what it prints goes where pytest's capsys reads it."""
    with pytest.raises(SystemExit) as stop:
        entry.main([str(a) for a in arguments])
    return stop.value.code or 0


def run(*arguments: object) -> SimpleNamespace:
    """Run a command; return `code`, `out` and `err`."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = exit_code(*arguments)
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())
