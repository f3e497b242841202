"""Length scale of a tracker, read off tosses without any fit of contact: free fall and the height at rest.

A toss is replayed open loop from its own start, so a wrong length hides in small errors of every landing. Two moments
show it plainly. In flight the object falls with the length scale times gravity, whatever its size. At rest it lies at
the length scale times the height at which the simulated one settles, and there a wrong size looks the same. Both off by
the same factor: the tracker's lengths. Only the rest height: the object, the support, or a bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import effects_with
from candata.gap.data.recordings import Recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.problem import Problem
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.residuals import REST_SPEED_MPS
from candata.gap.replay.starts import Starts
from candata.gap.run.streams import Streams
from candata.rotation import difference, rotate
from candata.scenes import Scene
from candata.scenes.assemble import subtree
from candata.scenes.traits import is_toss
from candata.simulate import rollout
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Fewest rows of flight that say more than where and how fast it began.
FLIGHT_ROWS = 6
#: Fewest tosses for an interval by resampling.
FEWEST = 8
#: Time in which an object that was put down at rest settles [s].
SETTLE_S = 0.4
#: A simulated object that turns more than this while it settles stood on an edge [rad].
TOPPLED_RAD = 0.1
#: What no resampling shows: a camera's clock off by 0.1 % reads gravity off by 0.2 %.
SYSTEMATIC = 0.002
#: Resamples of the tosses, and the ends of a 90 % interval.
RESAMPLES, ENDS = 1000, (0.05, 0.95)


@dataclass(frozen=True)
class Scale:
    """A measured length scale: recorded over true.

    Attributes
    ----------
    value, low, high : float
        Estimate and 90 % interval, widened by `SYSTEMATIC`.
    episodes : int
        Tosses it rests on.
    """

    value: float
    low: float
    high: float
    episodes: int

    def holds(self, value: float) -> bool:
        """Tell whether the interval contains a value."""
        return self.low <= value <= self.high

    def agrees(self, other: Scale) -> bool:
        """Tell whether two intervals overlap."""
        return self.low <= other.high and other.low <= self.high


@dataclass(frozen=True)
class LengthScale:
    """Direct evidence on lengths.

    Attributes
    ----------
    flight, rest : Scale or None
        From free fall and from the height at rest; None where there is too little to see.
    causes : tuple of str
        Effects that can explain both; empty where lengths are right, or nothing was seen.
    scale : Scale or None
        The value for `pose_scale` where that is the cause, both sources weighed by their intervals.
    """

    flight: Scale | None
    rest: Scale | None
    causes: tuple[str, ...]
    scale: Scale | None


def length_scale(scene: Scene, recs: Recordings, begin: Starts, streams: Streams) -> LengthScale:
    """Return what free fall and rest height say about the tracker's lengths.

    Parameters
    ----------
    scene : Scene
        A toss; in other scenes nothing is seen.
    recs, begin
        Recorded tosses and where their replays start.
    streams : Streams
        Draw resamples of the tosses.
    """
    flight = scale_from_flight(scene, recs, begin, streams.of("free fall", recs.ids))
    rest = scale_from_rest(scene, recs, streams.of("height at rest", recs.ids))
    causes = _causes(flight, rest)
    return LengthScale(flight, rest, causes, _weighed(flight, rest) if causes == ("pose_scale",) else None)


def ruled_out(found: LengthScale) -> frozenset[str]:
    """Return the effects on lengths that free fall and rest together exclude; none where one of them was not seen."""
    if not found.causes or found.flight is None or found.rest is None:
        return frozenset()
    return frozenset(effects_with("tracked_length")) - frozenset(found.causes)


def _causes(flight: Scale | None, rest: Scale | None) -> tuple[str, ...]:
    """Return the effects that explain both readings.

    A short metre slows the fall and lowers the rest by one factor. A clock shows in the fall alone; size, support and
    bias in the rest alone.
    """
    falls = flight is None or flight.holds(1.0)
    lies = rest is None or rest.holds(1.0)
    if falls and lies:
        return ()
    if falls:
        alone = ("object_size", "support_height", "pose_bias")
        return alone if flight is not None else ("pose_scale", *alone)
    if rest is None:
        return ("pose_scale", "clock_drift")
    if flight is not None and flight.agrees(rest):
        return ("pose_scale",)
    return ("clock_drift",) if lies else ("pose_scale", "object_size")


def _weighed(flight: Scale | None, rest: Scale | None) -> Scale | None:
    """Return the mean of two scales that agree, weighed by the squares of their intervals."""
    if flight is None or rest is None:
        return flight or rest
    weight = [1 / (s.high - s.low) ** 2 for s in (flight, rest)]
    share = weight[0] / sum(weight)
    value = share * flight.value + (1 - share) * rest.value
    half = 0.5 / np.sqrt(sum(weight))
    return Scale(value, value - half, value + half, min(flight.episodes, rest.episodes))


def scale_from_flight(scene: Scene, recs: Recordings, begin: Starts, rng: np.random.Generator) -> Scale | None:
    """Return the free fall of the object's centre of mass over gravity; None where too little of it was seen.

    One factor for all tosses by least squares, each with its own start and speed: x = a + v t + s g t^2 / 2.
    """
    if not is_toss(scene) or _is_jointed(scene) or "object_pose" not in recs.readings:
        return None
    sums = []
    for e, row in enumerate(begin.rows):
        pose = recs.readings["object_pose"][e, : row + 1]
        seen = np.isfinite(pose).all(1)
        if seen.sum() < FLIGHT_ROWS:
            continue
        centre = pose[seen, :3] + rotate(pose[seen, 3:], scene.model.body_ipos[scene.object_id])
        sums.append(_fall(scene, np.flatnonzero(seen) / scene.file.rate_hz, centre))
    if len(sums) < FEWEST:
        return None
    products = np.array(sums)
    picks = resamples(rng, len(products), RESAMPLES)
    many = products[picks].sum(1)
    return _scale(products[:, 0].sum() / products[:, 1].sum(), many[:, 0] / many[:, 1], len(products))


def _fall(scene: Scene, t: Array, centre: Array) -> tuple[float, float]:
    """Return the products `seen . expected` and `expected . expected` of a flight, free of its start and speed."""
    design = np.stack([np.ones_like(t), t], axis=1)
    expected = 0.5 * np.array(scene.model.opt.gravity) * t[:, None] ** 2
    both = np.concatenate([expected, centre], axis=1)
    left = both - design @ np.linalg.lstsq(design, both, rcond=None)[0]
    return float((left[:, :3] * left[:, 3:]).sum()), float((left[:, :3] ** 2).sum())


def scale_from_rest(scene: Scene, recs: Recordings, rng: np.random.Generator) -> Scale | None:
    """Return the height at rest over that of the simulated object, put down in the same attitude; None without rest.

    Heights count from the world's origin, about which `pose_scale` acts.
    """
    if not is_toss(scene) or _is_jointed(scene) or "object_pose" not in recs.readings:
        return None
    recorded = np.array([p for p in (_rest_pose(scene, recs, e) for e in range(len(recs))) if p is not None])
    if len(recorded) < FEWEST:
        return None
    settled = _settled(scene, recorded)
    stands = np.linalg.norm(difference(settled[:, 3:], recorded[:, 3:]), axis=1) < TOPPLED_RAD
    if stands.sum() < FEWEST or (settled[stands, 2] <= 0).any():
        return None
    ratio = recorded[stands, 2] / settled[stands, 2]
    picks = resamples(rng, len(ratio), RESAMPLES)
    return _scale(ratio.mean(), ratio[picks].mean(1), len(ratio))


def _rest_pose(scene: Scene, recs: Recordings, episode: int) -> Array | None:
    """Return the mean pose `(7,)` of the last rows of a toss, or None where it still moves or is not seen."""
    rows = recs.readings["object_pose"][episode, : recs.lengths[episode]][-STILL_ROWS:]
    if len(rows) < STILL_ROWS or not np.isfinite(rows).all():
        return None
    span_s = (STILL_ROWS - 1) / scene.file.rate_hz
    if np.linalg.norm(rows[-1, :3] - rows[0, :3]) > REST_SPEED_MPS * span_s:
        return None
    return np.concatenate([rows[:, :3].mean(0), rows[-1, 3:]])


def _settled(scene: Scene, pose: Array) -> Array:
    """Return the poses `(n, 7)` at which the simulated object settles when it is put down at `pose (n, 7)`."""
    count = len(pose)
    qpos = np.repeat(np.asarray(scene.model.qpos0, float)[None], count, axis=0)
    qpos[:, scene.object_qpos : scene.object_qpos + 7] = pose
    commands = np.zeros((count, max(2, round(SETTLE_S * scene.file.rate_hz)), 0))
    played = rollout(scene, commands, qpos, np.zeros((count, scene.model.nv)), [()] * count)
    return played.readings["object_pose"][:, -1]


def _is_jointed(scene: Scene) -> bool:
    """Tell whether the object has joints of its own, so that no fixed point of it falls freely."""
    if scene.object_id is None:
        return False
    return int(scene.model.body_jntnum[sorted(subtree(scene.model, scene.object_id))].sum()) > 1


def _scale(value: float, many: Array, episodes: int) -> Scale:
    """Return a scale with the interval of its resamples."""
    low, high = np.quantile(many, ENDS)
    return Scale(float(value), float(low) - SYSTEMATIC, float(high) + SYSTEMATIC, episodes)


def with_lengths(problem: Problem) -> Problem:
    """Return the problem with what free fall and rest say of the tracker's lengths, before anything is fitted."""
    scene, recs = problem.replayer.scene, problem.recs
    found = length_scale(scene, recs, problem.begin, problem.streams)
    if found.scale is None:
        return replace(problem, ruled_out=ruled_out(found))
    c, s = candidate("pose_scale", scene), found.scale
    note = (
        f"the tracker's lengths are {s.value:.4f} of true ({s.low:.4f} to {s.high:.4f}), read off free fall and the "
        f"height at rest of {s.episodes} tosses, without a fit of contact"
    )
    measured = ((c, np.log([s.value]) if c.logarithmic[0] else np.array([s.value])),)
    noted = replace(recs, notes=(*recs.notes, note))
    return replace(problem, recs=noted, ruled_out=ruled_out(found), measured=measured)
