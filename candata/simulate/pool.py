"""Worker processes that make chunks of episodes: spawned, told in plain words, one thread each."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from candata.scenes import Scene, load_scene
from candata.scenes.labels import with_labels
from candata.schema.episode import Episode
from candata.schema.quarantine import QuarantinedEpisode
from candata.simulate.jobs import OPERATION, GenerationRecipe, job, motions_of, noise_of

T = TypeVar("T")
#: How long a stopped worker may take to remove what it has half written [s].
_LEAVE_S = 5.0
#: Scenes that a process keeps compiled: one for each of forty objects, a few megabytes each.
SCENES_KEPT = 48
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class EpisodeChunk:
    """Episodes that one worker makes and writes as one part; plain values only.

    Attributes
    ----------
    out : str
        Dataset.
    recipe : str
        The Recipe as JSON.
    config : str
        Digest of the configuration, kept as the part's producer.
    numbers : tuple of int
        The episodes' numbers.
    strict : bool
        Raise the error of an episode that cannot be made; else it is left out.
    """

    out: str
    recipe: str
    config: str
    numbers: tuple[int, ...]
    strict: bool = False


@dataclass(frozen=True)
class ChunkResult:
    """What became of a chunk: its episodes' numbers, the part that holds them (None where all were left out), and how
    many ended with each outcome.
    """

    numbers: tuple[int, ...]
    part: str | None
    outcomes: dict[str, int]


def make_chunk(out: str, recipe: str, config: str, numbers: tuple[int, ...], strict: bool) -> ChunkResult:
    """Return what became of a chunk, once its part and the record of what was left out stand; runs in any process.

    Raises
    ------
    DataError
        When an episode cannot be made, with `strict`.
    """
    from candata.datasets import write_part
    from candata.datasets.quarantine import write_quarantine
    from candata.simulate.attempts import attempted_episodes

    plan = GenerationRecipe.model_validate_json(recipe)
    by_scene: dict[str, list[int]] = {}
    for number in numbers:
        by_scene.setdefault(plan.scenes[plan.scene_turn(number)], []).append(number)
    made: dict[int, Episode | QuarantinedEpisode] = {}
    for name, scene_numbers in by_scene.items():
        scene = _scene(name, plan.taxels)
        motions = motions_of(plan, scene)
        noise = noise_of(plan.noise, scene)
        batch = [job(plan, number, scene, motions) for number in scene_numbers]
        wanted = [plan.wanted(number) for number in scene_numbers]
        results = attempted_episodes(scene, batch, wanted, duration_s=plan.duration_s, noise=noise)
        made |= zip(scene_numbers, results, strict=True)
    episodes = [e for n in numbers if isinstance(e := made[n], Episode)]
    left_out = [e for n in numbers if isinstance(e := made[n], QuarantinedEpisode)]
    if strict and left_out:
        raise left_out[0].error
    write_quarantine(Path(out), config, left_out)
    part_id = write_part(out, episodes, producer(config)).id if episodes else None
    return ChunkResult(numbers, part_id, Counter(e.meta.outcome for e in episodes if e.meta.outcome is not None))


def producer(config: str) -> dict[str, str]:
    """Return what a part says of who wrote it."""
    return {"operation": OPERATION, "config": config}


@contextlib.contextmanager
def spawned_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of fresh processes, one thread each, that end with this one; what waits at the end is dropped.

    Where the block is left by Ctrl-C, what runs is stopped as well, and removes what it has half written.
    """
    earlier_processes = set(multiprocessing.active_children())
    # The tracker lets Ctrl-C through while it begins, so it begins before Ctrl-C is held back.
    resource_tracker.ensure_running()
    with _single_threads():
        with _interrupts_held():  # an interrupt among the pool's semaphores would leave one of them in the system
            pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start)
        try:
            yield pool
        except (KeyboardInterrupt, GeneratorExit):
            for process in set(multiprocessing.active_children()) - earlier_processes:
                process.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def submit_tasks(
    pool: ProcessPoolExecutor, work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]
) -> list[Future[T]]:
    """Return the futures of tasks, in their order; the processes begun for them never hear Ctrl-C.

    A terminal sends it to every process. One that has just begun would answer with a traceback, before `_start` can
    tell it to ignore it; so it is held back, in this process only until all have begun.
    """
    with _interrupts_held():
        return [pool.submit(_run_task, work, task) for task in tasks]


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back inside the block, and let it come at its end; processes begun in it never hear it.

    The mask is what those processes inherit. It does not hold back a signal that the system gives to another thread
    of this process, which Python answers in the main thread all the same: so the answer waits as well.
    """
    came: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    answered_here = callable(handler) and threading.current_thread() is threading.main_thread()
    if answered_here:
        signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    earlier_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if answered_here:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier_mask)
        if came:
            signal.raise_signal(signal.SIGINT)


def _run_task(work: Callable[..., T], task: tuple[Any, ...]) -> T:
    """Return what a task returns; a worker that is told to leave ends once the task has removed what is half."""
    try:
        return work(*task)
    except _StoppedWorker:
        os._exit(1)


@lru_cache(maxsize=SCENES_KEPT)
def _scene(name: str, taxels: bool) -> Scene:
    """Return the scene with labels, compiled once a process."""
    return with_labels(load_scene(name), taxels)


def _start() -> None:
    """Prepare a worker: interrupts are the parent's to handle, and it ends when the parent does, or tells it to."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_end_with_parent, daemon=True).start()


class _StoppedWorker(SystemExit):
    """The parent told this worker to leave; what a user's code raises to end a program is another SystemExit."""


def _leave(_number: int, _frame: object) -> NoReturn:
    """Leave the task under way, so that it removes what is half; the process goes soon after, whatever waits for it.

    A second signal is not heard: the pool sends one to all workers when the first of them has ended.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.setitimer(signal.ITIMER_REAL, _LEAVE_S)
    raise _StoppedWorker


def _end_with_parent() -> None:
    """Wait for the parent's end, then leave at once: a killed parent must not leave workers behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def _single_threads() -> Iterator[None]:
    """Give processes started inside one thread each in numerical libraries."""
    earlier_values = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in earlier_values.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
