"""What commands print: data to stdout, notes and progress to stderr."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import typer

if TYPE_CHECKING:
    from candata.datasets import Dataset

#: Exit code of a command that Ctrl-C ended: 128 + SIGINT, as shells have it.
EXIT_STOPPED = 130

#: Seconds between lines of progress where stderr is no terminal.
EVERY_S = 30.0
GAP = "Check the diagnosis itself, and what it found."
SCENE = "Look at scenes, and write repaired ones: a model and its roles."
POLICY = "Judge policies before they meet the robot: evaluate, filter, refine."
RAY = "Work on a Ray cluster instead: local (this machine, --jobs cores), auto, HOST:PORT or ray://HOST:PORT."


def group(app: typer.Typer, name: str, help_text: str) -> typer.Typer:
    """Return the command group `name` of the application, added if no file has added it yet."""
    for info in app.registered_groups:
        if info.name == name and info.typer_instance is not None:
            return info.typer_instance
    new_group = typer.Typer(help=help_text, no_args_is_help=True, rich_markup_mode=None)
    app.add_typer(new_group, name=name)
    return new_group


def open_named(dataset: str, version: str | None = None, partial: bool = False) -> Dataset:
    """Return the version of a dataset that a folder or a registered name means, `@` and a tag or version after it.

    `version` is a number, the start of a digest or a tag, and stands above what follows the `@`.
    """
    from candata.datasets import open_dataset
    from candata.datasets.registry import resolve

    path, named_version = resolve(dataset)
    return open_dataset(path, number(version) if version else named_version, partial=partial)


def number(text: str | None) -> int | str | None:
    """Return a short number as a number, a tag or the start of a digest as it is."""
    return int(text) if text and text.isdigit() and len(text) < 6 else text


def words(text: str) -> tuple[str, ...]:
    """Return the words of a comma-separated list."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def shares_text(counts: Mapping[str, int]) -> str:
    """Return `success 12 (60 %), slip 8 (40 %)`, the most frequent first; empty of nothing."""
    total = sum(counts.values())
    order = sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
    return ", ".join(f"{name} {count} ({100 * count / total:.0f} %)" for name, count in order)


class StoppedRun(Exception):
    """Ctrl-C ended a command; says what is kept, and what to type next.

    That is the same command, which goes on from there or begins again, or the words of another one.
    """

    def __init__(self, kept_text: str = "", goes_on: bool = False, next_command: Sequence[str] = ()) -> None:
        """Keep all three."""
        super().__init__(kept_text)
        self.kept, self.goes_on, self.other = kept_text, goes_on, next_command


@contextmanager
def stoppable(kept_text: str | Callable[[], str] = "nothing was written", goes_on: bool = False) -> Iterator[None]:
    """Turn Ctrl-C in the block, or the function so decorated, into words on what is kept.

    Parameters
    ----------
    kept_text : str or callable
        What is kept, as a clause; asked when it happens.
    goes_on : bool
        Whether the same command goes on from there; else it begins again.

    Raises
    ------
    Stopped
        When Ctrl-C was pressed; `candata_cli.main` prints it.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise StoppedRun(kept_text if isinstance(kept_text, str) else kept_text(), goes_on) from None


def written_clause(path: Path) -> str:
    """Return whether an output that appears whole or not at all is there, as a clause for `stoppable`."""
    return f"{path} is written, whole" if path.exists() else "nothing was written"


def out(text: str) -> None:
    """Print a line of data to stdout."""
    typer.echo(text)


def out_json(value: Any) -> None:
    """Print plain data (what `json` knows) to stdout, indented; NaN is refused.

    Raises
    ------
    ValueError
        When the value holds NaN or infinity, which JSON has not.
    """
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def out_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print aligned columns to stdout, the header first."""
    cells = [list(header), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    for row in cells:
        typer.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def note(text: str) -> None:
    """Print a line to stderr: what is being done, never data."""
    typer.echo(text, err=True)


def duration(seconds: float) -> str:
    """Return a length of time as a reader would say it: seconds up to two minutes, minutes up to two hours, hours."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


class Advance(Protocol):
    """Moves a progress on."""

    def __call__(self, steps: int, detail: str = "") -> None:
        """Count steps as done; `detail` says more about all that are."""


@contextmanager
def progress(label: str, total: int) -> Iterator[Advance]:
    """Show a bar with the time left on stderr and yield `advance(steps)`.

    Where stderr is no terminal, a line says the same every half minute, and one at the end how many are done.

    Parameters
    ----------
    label : str
        What is being done.
    total : int
        Number of steps.
    """
    if not sys.stderr.isatty():
        begin_s = told_s = time.monotonic()
        done_count = 0

        def advance(steps: int, detail: str = "") -> None:
            nonlocal told_s, done_count
            done_count += steps
            now_s = time.monotonic()
            if 0 < done_count < total and now_s - told_s >= EVERY_S:
                told_s = now_s
                left_text = duration((now_s - begin_s) / done_count * (total - done_count))
                note(f"{label}: {done_count} of {total}, about {left_text} left{detail and f'; {detail}'}")

        yield advance
        note(f"{label}: {total} done")
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total)

        def advance_bar(steps: int, detail: str = "") -> None:
            bar.update(task, advance=steps, description=f"{label}{detail and f': {detail}'}")

        yield advance_bar


@contextmanager
def transfer(label: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar in bytes on stderr and yield `advance(bytes)`; where stderr is no terminal, one line at the end."""
    if not sys.stderr.isatty():
        yield lambda _bytes: None
        note(f"{label}: {total / 1e6:.1f} MB done")
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total)
        yield lambda count: bar.advance(task, count)


@dataclass(frozen=True)
class Stages:
    """What a long command does: called with the name of each stage; `ends` hears by when it is done at the latest."""

    tell: Callable[[str], None]
    ends: Callable[[float | None], None] = lambda ends_s: None

    def __call__(self, name: str) -> None:
        """Tell that a stage begins."""
        self.tell(name)


@contextmanager
def stages(with_bar: bool = False) -> Iterator[Stages]:
    """Yield what shows stages: a spinner with the time spent on a terminal, a line each elsewhere.

    Where the command knows its latest end (`with_bar`), a terminal also shows a bar and the time left.
    """
    if not sys.stderr.isatty():
        yield Stages(note)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressBar, SpinnerColumn, Task, TextColumn, TimeElapsedColumn

    time_left = TimeLeft()

    class Share(BarColumn):
        """A bar as long as the share of the time that has gone."""

        def render(self, task: Task) -> ProgressBar:
            task.completed = time_left.gone_s
            return super().render(task)

    columns = [SpinnerColumn(), TextColumn("{task.description}")]
    columns += [Share(20), TextColumn("{task.fields[left]}")] if with_bar else []
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("starting", total=None, left=time_left)

        def tell(name: str) -> None:
            if time_left.grown:
                time_left.grown = False
                bar.console.print(name, markup=False, highlight=False)
            bar.update(task, description=name.partition(" (")[0] if with_bar else name)

        def ends(ends_s: float | None) -> None:
            time_left.move(ends_s)
            bar.update(task, total=time_left.total_s)

        yield Stages(tell, ends)


class TimeLeft:
    """The time left of a command, as text whenever it is shown."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without an end."""
        self._clock, self._begun_s = clock, clock()
        self._ends_s: float | None = None
        self.grown = False

    @property
    def gone_s(self) -> float:
        """Time since the beginning [s]."""
        return self._clock() - self._begun_s

    @property
    def total_s(self) -> float | None:
        """Time from the beginning to the latest end [s]; None while that is not known."""
        return None if self._ends_s is None else self._ends_s - self._begun_s

    def move(self, ends_s: float | None) -> None:
        """Take another latest end, on the clock's time, or None; `grown` is set where it is later."""
        self.grown |= self._ends_s is not None and ends_s is not None and ends_s > self._ends_s
        self._ends_s = ends_s

    def __str__(self) -> str:
        """Return `at most 2:05 left`; empty while nothing is known."""
        if self._ends_s is None:
            return ""
        left_s = round(self._ends_s - self._clock())
        return f"at most {left_s // 60}:{left_s % 60:02d} left" if left_s > 0 else "longer than planned"
