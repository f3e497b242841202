"""`log.jsonl`: one line a few steps, readable while the run goes on, whole again after a kill."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from candata.schema.json_text import parse_json
from candata.training.runs import run_file

NAME = "log.jsonl"


class StepLog:
    """The log of a run, open for writing; lines beyond `step` and a torn one are dropped first."""

    def __init__(self, folder: Path, step: int) -> None:
        self._path = folder / NAME
        earlier_lines = [line for line in read_log(folder) if line["step"] <= step]
        with run_file(self._path) as draft:
            draft.write_text("".join(_line(line) for line in earlier_lines))
        self._file = self._path.open("a")

    def write(self, **values: Any) -> None:
        """Add a line; numbers that are not finite become null."""
        self._file.write(_line(values))
        self._file.flush()

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self._file.close()


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Return the lines of a run's log; empty for none, a torn last line left out."""
    path = folder / NAME
    return list(_lines(path.read_bytes())) if path.is_file() else []


def _lines(content: bytes) -> Iterator[dict[str, Any]]:
    """Yield the whole lines up to the first torn one."""
    for line in content.splitlines():
        try:
            value = parse_json(line, finite=False)
        except ValueError:
            return
        if not isinstance(value, dict) or "step" not in value:
            return
        yield value


def _line(values: dict[str, Any]) -> str:
    """Return one line of JSON."""
    finite = {k: None if isinstance(v, float) and not abs(v) < float("inf") else v for k, v in values.items()}
    return json.dumps(finite, allow_nan=False) + "\n"
