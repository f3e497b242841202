"""Signatures: what an effect does to the comparison on given commands, simulated once in the nominal scene and kept.

A signature is the residual that a recording made in a world with the effect would show under the nominal replay, less
what a recording of the nominal scene shows: world, readings, start and observer are those of a diagnosis. It depends
on commands and starts, the scene and the effect, not on what was recorded, so that diagnoses of the same commands
share it.

Where nobody has filled a library for the commands, what an effect does is seen on the recording itself: by how much
its residual falls when it is replayed with the effect. That is half of the simulations, exact where it was simulated,
and kept for the next diagnosis of the same recordings.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect
from candata.gap.data.recordings import Recordings
from candata.gap.fit.signature_keys import content_of, key_of_commands, known_start, new_start, text_of
from candata.gap.measure.floor import null_residuals
from candata.gap.replay.replayer import BATCH, EffectSet, Replayer, read_alike, replay_all, true_start
from candata.gap.replay.residuals import Layout, residual
from candata.gap.replay.starts import Starts, starts
from candata.gap.run import cache
from candata.schema.scene import Noise
from candata.simulate import rollout

Array = NDArray[np.float64]
Compact = NDArray[np.float32]
#: Returns the residuals `(E, B, D)` of recordings that are replayed with each of some effect sets.
Replayed = Callable[[Sequence[EffectSet]], Sequence[Array]]
#: Seed of null recordings: the same from the cache and without it.
NULL_SEED = 0
#: Seconds between two words on how far simulations are.
TOLD_S = 10.0


@dataclass(frozen=True)
class Library:
    """Signatures on the commands of a set of recordings.

    Attributes
    ----------
    replayer : Replayer
    recs : Recordings
        Commands, and which channels were recorded.
    begin : Starts
        Where the worlds start: as recorded, or as in an earlier set of the same commands.
    plan : Layout
        Blocks of the residuals, without phases.
    raw : (E, B, D) float64
        Residual of the recordings under the nominal replay.
    folder : Path, optional
        Where they are kept; None keeps none.
    seen : bool
        Whether what effects do is seen on the recordings themselves, not in signatures that others share.
    memo : dict
        What this diagnosis has simulated or read so far.
    parts : dict
        Libraries of some of the episodes that this diagnosis has asked for.
    told : callable
        Called now and then with how many simulations are done and about how long the others take.
    own : bool
        Whether the worlds start where these recordings read that they do. Then a sensor at fault began elsewhere, and
        reads what was recorded; in the start of other recordings, which it was not part of, it reads something else.
    """

    replayer: Replayer
    recs: Recordings
    begin: Starts
    plan: Layout
    raw: Array
    folder: Path | None
    seen: bool
    memo: dict[str, Compact] = field(default_factory=dict)
    parts: dict[tuple[int, ...], Library] = field(default_factory=dict)
    told: Callable[[str], None] = lambda stage: None
    own: bool = True

    def take(self, index: NDArray[np.int64]) -> Library:
        """Return the library of some episodes."""
        key = tuple(index.tolist())
        if key not in self.parts:
            root = self.folder.parents[2] if self.folder else None
            begin, plan = self.begin.take(index), self.plan.take(index)
            recs, raw = self.recs.take(index), self.raw[index]
            part = library(self.replayer, recs, begin, plan, raw, root, self.told, share=not self.seen)
            self.parts[key] = replace(part, own=self.own and part.own)
        return self.parts[key]

    def signatures(self, settings: Sequence[EffectSet], replayed: Replayed) -> list[Compact]:
        """Return `(E, B, D) float32` of each effect set, from the cache or by simulation; NaN where not compared.

        What is seen on the recordings themselves comes from `replayed`.
        """
        # Workers that share a cache begin at different ends, so that they do not simulate the same ones.
        order = range(len(settings)) if self.seen else np.random.default_rng(os.getpid()).permutation(len(settings))
        each = max(1, BATCH // len(self.recs)) if self.seen else 1
        found: dict[int, Compact] = {}
        begun = told_s = time.monotonic()
        for first in range(0, len(settings), each):
            some = [int(i) for i in order[first : first + each]]
            asked = [settings[i] for i in some]
            made = self._on_recording(asked, replayed) if self.seen else [self._signature(one) for one in asked]
            found.update(zip(some, made, strict=True))
            now = time.monotonic()
            if now - told_s > TOLD_S and len(found) < len(settings):
                told_s, left = now, (now - begun) / len(found) * (len(settings) - len(found))
                self.told(f"simulating effects: {len(found)} of {len(settings)}, about {left:.0f} s left of these")
        return [found[i] for i in range(len(settings))]

    def _on_recording(self, settings: Sequence[EffectSet], replayed: Replayed) -> list[Compact]:
        """Return by how much the residuals of the recordings fall with each effect set.

        Not of a sensor at fault that read the start: a replay from a start that is a little less wrong goes on in as
        wrong a contact.
        """
        names = [self._name(some) for some in settings]
        for name, some in zip(names, settings, strict=True):
            if name not in self.memo and is_read_at_start(some):
                self._signature(some)
            elif name not in self.memo and (found := cache.read(self._file(name))) is not None:
                self.memo[name] = found["residual"]
        new = {name: some for name, some in zip(names, settings, strict=True) if name not in self.memo}
        for name, left in zip(new, replayed(list(new.values())) if new else [], strict=True):
            self.memo[name] = (self.raw - left).astype(np.float32)
            cache.keep(self._file(name), residual=self.memo[name])
        return [self.memo[name] for name in names]

    def knows(self, some: EffectSet) -> bool:
        """Tell whether this diagnosis has a signature already."""
        return self._name(some) in self.memo

    def lacks(self, some: EffectSet) -> bool:
        """Tell whether the cache has no file for a signature."""
        file = self._file(self._name(some))
        return file is None or not file.exists()

    def keep(self, some: EffectSet) -> None:
        """Simulate a signature into the cache, unless it is there; nothing of it stays in memory."""
        if cache.read(self._file(self._name(some))) is None:
            cache.keep(self._file(self._name(some)), residual=self._residual(some) - self._nominal())

    def _signature(self, some: EffectSet) -> Compact:
        """Return one signature."""
        return self._kept(self._name(some), lambda: self._residual(some) - self._nominal())

    def _nominal(self) -> Compact:
        """Return the residual of a recording of the nominal scene."""
        return self._kept("nominal", lambda: self._residual(()))

    def _name(self, some: EffectSet) -> str:
        """Return what names a signature: the effects, and whether the start is what they read."""
        return f"{text_of(some)} read" if self._is_read(some) else text_of(some)

    def _is_read(self, some: EffectSet) -> bool:
        """Tell whether the start is what a sensor at fault read."""
        return self.own and is_read_at_start(some)

    def _residual(self, some: EffectSet) -> Compact:
        """Return the residual of noise-free recordings of a world under the nominal replay."""
        begin = true_start(self.replayer.scene, self.recs, self.begin, some if self._is_read(some) else ())
        return _recorded(self.replayer, self.recs, begin, self.plan, some)

    def nulls(self, noise: Noise) -> Array:
        """Return the residuals `(R, E, B, D)` of null recordings under their replay, with a noise of their own."""

        def made() -> Compact:
            whole = replace(self.recs, readings={n: np.zeros_like(v) for n, v in self.recs.readings.items()})
            rng = np.random.default_rng(NULL_SEED)
            return null_residuals(self.replayer, whole, self.begin, self.plan, noise, rng).astype(np.float32)

        sizes = [a for part in self.recs.slow for a in (part.sd, part.time_s, part.shapes, part.motion, part.piece)]
        name = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in sizes)).hexdigest() if sizes else ""
        return self._kept(noise.model_dump_json() + name, made).astype(float)

    def _kept(self, text: str, make: Callable[[], Compact]) -> Compact:
        """Return what `text` names: from memory, from the cache, or made and kept in both."""
        if text not in self.memo:
            file = self._file(text)
            found = cache.read(file)
            self.memo[text] = make() if found is None else found["residual"]
            if found is None:
                cache.keep(file, residual=self.memo[text])
        return self.memo[text]

    def _file(self, text: str) -> Path | None:
        """Return where what `text` names is kept."""
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.npz" if self.folder else None


def library(
    replayer: Replayer,
    recs: Recordings,
    begin: Starts,
    plan: Layout,
    raw: Array,
    root: Path | None,
    told: Callable[[str], None] = lambda stage: None,
    share: bool | None = False,
) -> Library:
    """Return the library of a set of recordings.

    Parameters
    ----------
    replayer, recs, begin, plan
        As in `Library`.
    raw : (E, B, D) float64
        Residual of the recordings under the nominal replay.
    root : Path, optional
        The cache's folder; None keeps nothing.
    told : callable
        Hears how far simulations are.
    share : bool or None
        Whether to take, and make, signatures that recordings of the same commands share; with None they are taken
        where somebody has begun to fill such a library, none are made. Without a folder there is none.
    """
    flat = replace(plan, phase=np.zeros_like(plan.phase))
    if root is None:
        return Library(replayer, recs, begin, flat, raw, None, True, told=told)
    place = root / "signatures" / key_of_commands(replayer, recs, begin)
    known = known_start(place, begin, replayer.scene) if share is not False else None
    if known is None and not share:
        own_place = place / f"seen-{content_of(recs, begin)}"
        cache.mark_used(own_place)
        return Library(replayer, recs, begin, flat, raw, own_place, True, told=told)
    folder, shared = known or new_start(place, begin)
    own = np.array_equal(shared.qpos, begin.qpos) and np.array_equal(shared.qvel, begin.qvel)
    made = Library(replayer, recs, shared, flat, raw, folder, False, told=told, own=own)
    made._nominal()  # which all signatures need
    return made


def sharing_note(shelf: Library) -> tuple[str, ...]:
    """Return the note that signatures are shared, and with which start, by the name of its folder; none of own ones."""
    if shelf.seen or shelf.folder is None:
        return ()
    return (f"what effects do is read off signatures that recordings of these commands share ({shelf.folder.name})",)


def is_read_at_start(some: EffectSet) -> bool:
    """Tell whether some effects are of a sensor that read where a replay starts."""
    return any(effect(s.name).unread is not None for s in some)


def _recorded(replayer: Replayer, recs: Recordings, begin: Starts, plan: Layout, world: EffectSet) -> Compact:
    """Return the residual of noise-free recordings of a world under the nominal replay."""
    played = rollout(
        replayer.scene,
        recs.commands,
        begin.qpos0,
        begin.qvel0,
        [world] * len(recs),
        memory=begin.memory0,
        supply=recs.supply,
        instant_force=recs.instant_force,
        read_effort="joint_effort" in recs.readings,
        threads=replayer.threads,
    )
    replayer.count(recs.commands.shape[0] * recs.commands.shape[1] * replayer.scene.substeps)
    readings = read_alike(replayer.scene, recs, played.readings)
    made = replace(recs, readings={n: v for n, v in readings.items() if n in recs.readings}, misfit=None)
    readings = replay_all(replayer, made, starts(replayer.scene, made, begin.moving), [()])[0]
    return residual(made, plan, readings).astype(np.float32)
