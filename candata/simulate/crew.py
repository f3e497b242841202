"""Who does the tasks of a run: this process, or processes beside it; `cluster` has machines beside this one."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import as_completed
from typing import Any, Protocol, TypeVar

from candata.simulate.pool import spawned_pool, submit_tasks

T = TypeVar("T")


class Crew(Protocol):
    """Does tasks that need nothing of each other."""

    def __call__(self, work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]) -> Generator[T, None, None]:
        """Yield what `work`, a function of a module, makes of each task, as it comes."""


def alone(work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]) -> Generator[T, None, None]:
    """Yield what `work` makes of each task, one after another in this process: the least of crews."""
    yield from (work(*task) for task in tasks)


def local(jobs: int) -> Crew:
    """Return a crew of processes of this machine; for a single task, and with one, the work is done in this one."""
    if jobs == 1:
        return alone

    def crew(work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]) -> Generator[T, None, None]:
        if len(tasks) < 2:
            yield from alone(work, tasks)
            return
        with spawned_pool(min(jobs, len(tasks))) as pool:
            yield from (done.result() for done in as_completed(submit_tasks(pool, work, tasks)))

    return crew
