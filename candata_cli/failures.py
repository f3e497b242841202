"""What candata did not expect: a short text, a file with what developers need, and an exit code of its own."""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import traceback
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool

from candata.errors import CandataError, SetupError

#: Exit code of a failure within candata: EX_SOFTWARE of BSD's sysexits.h.
EXIT_UNEXPECTED = 70


def expected_as(error: Exception) -> CandataError | None:
    """Return the error of candata that an exception of Python's stands for; None if it is a fault of candata."""
    if isinstance(error, MemoryError):
        return SetupError(
            "out of memory",
            found=str(error) or None,
            fix="close other programs, use fewer --jobs, or give it less at a time",
        )
    if isinstance(error, BrokenProcessPool):
        return SetupError(
            "a worker process ended before its work",
            found="it was killed, which the system does where memory runs out, or it crashed",
            fix="use fewer --jobs; the same command goes on where it can",
        )
    return None


def report(error: Exception, words: Sequence[str]) -> str:
    """Return what to print of an unexpected failure, after its traceback was kept in a file.

    Parameters
    ----------
    error : Exception
        What was raised.
    words : sequence of str
        The command line.
    """
    from candata import __version__

    versions_text = f"candata {__version__}, Python {sys.version.split()[0]}, {platform.platform()}"
    traceback_text = "".join(traceback.format_exception(error))
    lines = [f"candata failed: {type(error).__name__}: {str(error)[:300]}".rstrip(": ")]
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="candata-failure-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(f"{versions_text}\n{shlex.join(['candata', *words])}\n\n{traceback_text}")
        lines += [f"  where: {file.name}", "  do: report it with that file; it is a fault of candata, not of your data"]
    except OSError:  # the disk is full
        lines += ["  do: report it with this; it is a fault of candata, not of your data", traceback_text]
    return "\n".join(lines)
