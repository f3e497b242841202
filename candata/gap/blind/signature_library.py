"""Filling a signature library with a crew before anything is diagnosed: each signature once, whoever makes it.

What is simulated, and where it is kept, is what a diagnosis of the recordings would simulate and keep: a diagnosis
after it finds it there. Every signature is a task and a file of its own, so that a filling that was stopped goes on.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from candata.datasets import open_dataset
from candata.errors import CandataError, DataError, Where
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.runs import Place
from candata.gap.data.recordings import Recordings, read
from candata.gap.fit.folds import FEWEST
from candata.gap.fit.problem import Problem
from candata.gap.fit.signature_keys import share_signatures
from candata.gap.preparation import posed
from candata.gap.replay.replayer import EffectSet, Replayer
from candata.gap.replay.starts import Starts, starts
from candata.gap.screening.demand import Depth, wanted
from candata.gap.verdict.findings import lasting
from candata.scenes.traits import is_toss
from candata.schema.bench import FilledSignature

#: What a run has filled its cache with.
FILLED = "filled.jsonl"
#: Cases from which on more than the first look pays. Record 43.
MANY = 12
#: Cases that are looked at to find recordings whose signatures the others share.
PEEK = 6


class Source(NamedTuple):
    """Recordings whose signatures are kept, and where, in plain words that hold in any process.

    Attributes
    ----------
    dataset, version, scene : str
        Folder, digest, and what `load_scene` takes.
    cache : str
        Folder under which signatures are kept.
    seed : int
        Seed of the diagnoses: of more than 64 episodes it decides which are searched.
    only : tuple of str
        Effects to search among; all that can act and show when empty.
    shared : bool
        For other recordings of the same commands, to which a sensor at fault says another start.
    noise_declared : bool
        Whether the diagnoses are told the noise that the scene declares.
    """

    dataset: str
    version: str
    scene: str
    cache: str
    seed: int = 0
    only: tuple[str, ...] = ()
    shared: bool = False
    noise_declared: bool = True


class Plan(NamedTuple):
    """How many signatures a library is to hold, and the tasks of `keep_signature` that are left to do."""

    total: int
    tasks: list[tuple[Source, Depth, int]]


def source(folder: Path, scene: str, cache: Path, seed: int = 0, version: int | str | None = None) -> Source:
    """Return the source of a dataset's folder."""
    found = open_dataset(folder, version)
    return Source(str(folder.resolve()), found.digest, lasting(scene), str(cache.resolve()), seed)


def planned(some: Source, depth: Depth = "all") -> Plan:
    """Return what is left to simulate; makes the nominal replay and the nulls, which all diagnoses share too.

    Raises
    ------
    DataError
        When there are too few episodes, or nothing moves: no diagnosis would look at a signature.
    """
    _posed.cache_clear()  # the folder may have gone since
    found = _posed(some, depth)
    lacking = [i for i, (part, effects) in enumerate(found) if part.library.lacks(effects)]
    return Plan(len(found), [(some, depth, i) for i in lacking])


def keep_signature(some: Source, depth: Depth, number: int) -> FilledSignature:
    """Return what it took to keep one of the `wanted` signatures; runs in any process."""
    start = time.process_time()
    part, effects = _posed(some, depth)[number]
    part.library.keep(effects)
    return FilledSignature(cpu_s=time.process_time() - start)


def shared_tasks(places: Sequence[Place], cache: Path, seed: int) -> list[tuple[Source, Depth, int]]:
    """Return the tasks that keep the signatures which cases share, as many as pay for so many cases; none for tosses.

    Where the recordings cannot be diagnosed, each case's own result says so.
    """
    some = shared_by(places, cache, seed)
    try:
        return planned(some, "most" if len(places) >= MANY else "first").tasks if some else []
    except CandataError:
        return []


def shared_by(places: Sequence[Place], cache: Path, seed: int) -> Source | None:
    """Return the recordings among some cases whose signatures most others share; None where few do.

    Cases share commands, but a sensor at fault can shift where one of them starts.
    """
    looked = [(p, b) for p in places[:PEEK] if (b := _begun(p)) is not None and not is_toss(b.replayer.scene)]
    shared = [
        sum(p.nominal == q.nominal and share_signatures(a.replayer, a.begun, b.begun) for q, b in looked)
        for p, a in looked
    ]
    if len(looked) < 2 or 2 * max(shared) <= len(looked):
        return None
    place = looked[shared.index(max(shared))][0]
    found = source(place.folder, place.scene, cache, seed)
    return found._replace(shared=True, noise_declared=place.noise_declared)


class _Begun(NamedTuple):
    """A scene, and recordings with where they start."""

    replayer: Replayer
    begun: tuple[Recordings, Starts]


def _begun(place: Place) -> _Begun | None:
    """Return what a case recorded; None where it cannot be read, which its own diagnosis says."""
    try:
        scene = place.nominal.load()
        recs = read(scene, open_dataset(place.folder))
        return _Begun(Replayer(scene), (recs, starts(scene, recs)))
    except CandataError:
        return None


@lru_cache(maxsize=1)
def _posed(some: Source, depth: Depth) -> list[tuple[Problem, EffectSet]]:
    """Return the wanted signatures of a source, posed once a process as a diagnosis poses its problem."""
    replayer, data = (
        Replayer(NominalScene(some.scene, some.noise_declared).load()),
        open_dataset(some.dataset, some.version),
    )
    found = posed(data, replayer, some.seed, Path(some.cache), some.only, share=True)
    if found.problem is None:
        raise DataError(
            "there is nothing to diagnose in these recordings",
            expected=f"{FEWEST} episodes or more that move",
            found=f"{len(found.everything)} episodes",
            where=Where(path=some.dataset),
            fix="record more",
        )
    problem = found.problem
    if some.shared:
        problem = replace(problem, library=replace(problem.library, own=False, parts={}))
    return wanted(problem, depth)
