"""Forces under another fingertip's name: told by the scene's own forces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.sensors import TOUCH_N, tare
from candata.gap.mismatch.swaps import AT_LEAST, cycles, in_episodes, some_of
from candata.scenes import Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Rise of the mean cosine with the scene's forces by which an exchange of fingertips is told, and what it must reach:
#: in some 300 simulated worlds, each with other causes, no exchange gained anything in all episodes together; in some
#: episodes it did, and reached 0.53.
RISE, REACHED = 0.05, 0.6
#: What it must reach to be sure where only one episode asks, or others speak against it. Record 43.
SURE = 0.8
#: Share of the largest squared force among exchanged fingertips that each must feel, recorded and simulated, to let an
#: episode ask: which of two opposed jaws bears a tilted object alone is chance. Chosen: 0.002 there at most.
SHARED = 0.005
#: Rows of touch that let an episode ask for an exchange.
ASKING_ROWS = 8


@dataclass(frozen=True)
class _Agreement:
    """How far recorded fingertips agree with the scene's, episode by episode.

    Attributes
    ----------
    dot : (E, F, F) float64
        Products of recorded (rows) and nominal forces, summed over time [N^2].
    own : (E, F, 3, 3) float64
        Products of the components of each recorded fingertip (rows) and of its own in the scene [N^2].
    real, nominal : (E, F) float64
        Squares of both.
    asking : (E, F) bool
        Where the scene touches long enough for an episode to ask for an exchange.
    """

    dot: Array
    own: Array
    real: Array
    nominal: Array
    asking: NDArray[np.bool_]

    def cosines(self, episodes: NDArray[np.bool_]) -> Array:
        """Return `(F, F)` the cosine of each recorded with each nominal fingertip, some episodes together."""
        size = self.real[episodes].sum(0)[:, None] * self.nominal[episodes].sum(0)
        return np.asarray(self.dot[episodes].sum(0) / np.sqrt(np.maximum(size, 1e-12)))

    def turned(self, episodes: NDArray[np.bool_]) -> Array:
        """Return `(F,)` each fingertip's cosine with its own when turned or mirrored at best (Kabsch 1976)."""
        size = self.real[episodes].sum(0) * self.nominal[episodes].sum(0)
        best = np.linalg.svd(self.own[episodes].sum(0), compute_uv=False).sum(-1)
        return np.asarray(best / np.sqrt(np.maximum(size, 1e-12)))


def exchange_findings(scene: Scene, recs: Recordings, force: Array) -> list[RecordingMismatch]:
    """Return fingertips that agree with each other's forces in the scene, and not with their own.

    Nothing where the scene's fingertips feel alike, or where another frame or sign explains as much.

    Parameters
    ----------
    force : (E, T, F, 3) float64
        Forces of a nominal replay [N].
    """
    if "fingertip_force" not in recs.readings or len(scene.file.fingertips) < 2:
        return []
    a = _agreement(recs.readings["fingertip_force"], force)
    for chosen in _exchanges(a):
        moved = np.flatnonzero(chosen != np.arange(len(chosen)))
        rise, signed = _rises(a, chosen, moved), _rises(a, chosen, moved, np.asarray)
        # Where some episodes agree as they are, a sign is no other convention.
        rise = signed if (signed < -RISE).any() else rise
        asked, against = rise > RISE, rise < -RISE
        if not asked.any() or (against.any() and asked.sum() < AT_LEAST):
            continue
        cosines = a.cosines(asked)
        before = float((cosines if against.any() else np.abs(cosines))[moved, moved].mean())
        after = float(cosines[moved, chosen[moved]].mean())
        # A frame that is turned is so in every episode.
        rival = 0.0 if against.any() else float(a.turned(asked)[moved].mean())
        if after > max(before + RISE, rival, REACHED):
            sure = after > SURE or (asked.sum() >= AT_LEAST and not against.any())
            return [_exchanged(scene, recs, chosen, asked, against, (before, after), sure)]
    return []


def _agreement(real: Array, force: Array) -> _Agreement:
    """Return how far recorded forces agree with the scene's, zero out of contact taken off the recorded ones."""
    own = np.where(np.isfinite(real), force, 0.0)
    seen = np.nan_to_num(real - tare(real, force))
    touched = (np.linalg.norm(own, axis=-1) > TOUCH_N).sum(1)
    return _Agreement(
        np.einsum("etic,etjc->eij", seen, own),
        np.einsum("etic,etid->eicd", seen, own),
        (seen**2).sum((1, 3)),
        (own**2).sum((1, 3)),
        touched >= ASKING_ROWS,
    )


def _exchanges(a: _Agreement) -> list[Index]:
    """Return exchanges `(F,)` worth a look: those that all episodes together ask for, and those that several do."""
    every = np.ones(len(a.dot), bool)
    each = [a.cosines(row) for row in np.eye(len(every), dtype=bool)]
    asked = Counter(c for e in each for c in _asked(e))
    often = [c for c, count in asked.most_common() if count >= AT_LEAST]
    found = [*_asked(a.cosines(every)), *often]
    return [np.array(c) for c in dict.fromkeys(found)]


def _asked(cosines: Array) -> list[tuple[int, ...]]:
    """Return the exchanges by which recorded fingertips agree with nominal ones better, one for each cycle."""
    _, chosen = linear_sum_assignment(-cosines + RISE * (1 - np.eye(len(cosines))))
    return [some_of(chosen, cycle) for cycle in cycles(chosen)]


def exchange_rivals(scene: Scene, recs: Recordings, force: Array) -> str:
    """Return which exchange of fingertips makes recorded forces agree with the scene's; nothing where none does."""
    if "fingertip_force" not in recs.readings or len(scene.file.fingertips) < 2:
        return ""
    a, tips = _agreement(recs.readings["fingertip_force"], force), scene.file.fingertips
    cosines = a.cosines(np.ones(len(a.dot), bool))
    for chosen in _exchanges(a):
        moved = np.flatnonzero(chosen != np.arange(len(chosen)))
        if cosines[moved, chosen[moved]].min() > SURE:
            return ", ".join(f"{tips[i]} reads what {tips[chosen[i]]} feels" for i in moved)
    return ""


def _rises(a: _Agreement, chosen: Index, moved: Index, own: Callable[[Array], Array] = np.abs) -> Array:
    """Return `(E,)` by how much the mean cosine rises with an exchange; 0 where an episode has no say.

    Parameters
    ----------
    own : callable
        What counts of a fingertip's cosine with its own: its size, unless a sign is no other convention.
    """
    out = np.zeros(len(a.dot))
    shared = np.logical_and(*(size[:, moved].min(1) > SHARED * size[:, moved].max(1) for size in (a.real, a.nominal)))
    for e in np.flatnonzero(a.asking[:, moved].all(1) & shared):
        cosines = a.cosines(np.arange(len(out)) == e)
        out[e] = (cosines[moved, chosen[moved]] - own(cosines[moved, moved])).mean()
    return out


def _exchanged(
    scene: Scene,
    recs: Recordings,
    chosen: Index,
    asked: NDArray[np.bool_],
    against: NDArray[np.bool_],
    cosines: tuple[float, float],
    sure: bool,
) -> RecordingMismatch:
    """Return the finding that fingertips are in another order, in all episodes or in those that ask for it."""
    tips = scene.file.fingertips
    moved = np.flatnonzero(chosen != np.arange(len(chosen)))
    pairs = ", ".join(f"{tips[i]} reads what {tips[chosen[i]]} feels" for i in moved)
    where = in_episodes(recs, asked) if against.any() else "in all episodes"
    order = "put the columns of `fingertip_force` in the order of `fingertips` in scene.yaml, or name them"
    verb = "are" if sure else "may be"
    return RecordingMismatch(
        "swapped_fingertips",
        sure,
        f"forces {verb} in another order than the scene's fingertips",
        "each fingertip agrees with its own in the scene",
        f"{pairs}, {where} (cosine {cosines[1]:.2f}, as given {cosines[0]:.2f})",
        f"{order}, the same in every episode" if against.any() else order,
        "fingertip_force",
        tuple(tips[i] for i in moved),
    )
