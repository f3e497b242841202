"""What to do next: the motion under which the causes that are still tied differ most (T-optimal).

Each tied candidate in turn is taken for the truth: its world plays a motion, the others replay it under the observer as
a diagnosis would, and what is left after the best refit counts. The motion whose least separation is largest is the
one to record.

Source: Atkinson & Fedorov 1975, "Optimal design: experiments for discriminating between several models", Biometrika
62, eq. 1; the refit runs along the line from no effect to the fitted one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from candata.gap.floor import smallest
from candata.gap.recordings import Recordings, recordings
from candata.gap.replay import EffectSet, Replayer, replay_all
from candata.gap.residuals import Layout, layout, residual
from candata.gap.score import Score
from candata.gap.search import Problem
from candata.gap.starts import starts
from candata.policies import Motion, command_limits, policy
from candata.scenes import Scene
from candata.schema.contact import fingertip_contact
from candata.schema.scene import Noise
from candata.simulate.episodes import Job, make_episodes
from candata.simulate.jobs import possible_policies

Array = NDArray[np.float64]
#: Plays of each motion from other starts in the first look, and of the `FINALISTS` best in the second, by the number
#: of rivals: the time grows with its square (16 and 20 CPU s in `xhand_tabletop`).
PLAYS = {2: (3, 6), 3: (2, 3)}
FINALISTS = 3
#: Tied candidates that are told apart at most.
RIVALS = max(PLAYS)
#: Largest fingertip force of a proposed motion, over the largest one recorded.
FORCE_MARGIN = 1.5
#: Shortest and longest proposed motion [s]: time to grasp, carry and let go, whatever the recordings' length.
SHORTEST_S, LONGEST_S = 2.0, 4.0
#: Farthest that a refit goes along the line from no effect to the fitted one.
FARTHEST = 3.0
#: Neighbouring blocks over which the spread of plays is averaged.
CHAOS_BLOCKS = 16


@dataclass(frozen=True)
class Rivals:
    """What is to be told apart, and what a difference is measured against.

    Attributes
    ----------
    replayer : Replayer
    sets : tuple of tuple of EffectSetting
        The fitted candidates, two or three.
    noise : Noise
        Sensor noise of the recordings.
    channels : tuple of str
        What the recordings hold.
    spread : (P, D) float64, optional
        Spread of a residual's block means when only noise differs, by phase and column of the residual; what the
        noise alone leaves by default.
    force_limit_n : float, optional
        Largest force on a fingertip [N]; by default `FORCE_MARGIN` times what the scene's usual motions need.
    """

    replayer: Replayer
    sets: tuple[EffectSet, ...]
    noise: Noise
    channels: tuple[str, ...]
    spread: Array | None = None
    force_limit_n: float | None = None


@dataclass(frozen=True)
class Choice:
    """The motion to record and what it is expected to show.

    Attributes
    ----------
    motion : Motion
    separation : float
        Least difference between two candidates after a refit: RMS of block means, in floors.
    usual : float
        The same under the scene's usual motions, their median.
    tried : int
        Motions within the limits that were compared.
    """

    motion: Motion
    separation: float
    usual: float
    tried: int


def rivals_of(problem: Problem, sets: Sequence[EffectSet]) -> Rivals:
    """Return the rivals of a diagnosis: in units of its floor, within the forces of its recordings."""
    return Rivals(
        problem.replayer,
        tuple(sets[:RIVALS]),
        problem.noise,
        tuple(problem.recs.readings),
        typical_spread(problem.plan, problem.score),
        _recorded_limit(problem.recs),
    )


def typical_spread(plan: Layout, score: Score) -> Array:
    """Return `(P, D)` the median floor of each column by phase; over all phases where one did not occur."""
    sigma = score.sigma.reshape(*plan.phase.shape, -1).astype(float)
    seen = score.mask.reshape(sigma.shape)
    rows = []
    for p in range(len(plan.phases)):
        here = np.where(seen & (plan.phase == p)[..., None], sigma, np.nan)
        rows.append(_median(here))
    overall = _median(np.where(seen, sigma, np.nan))
    return np.where(np.isfinite(rows), rows, np.where(np.isfinite(overall), overall, 1.0))


def _median(values: Array) -> Array:
    """Return `(D,)` the median over all but the last axis; NaN for a column without values."""
    flat = values.reshape(-1, values.shape[-1])
    out = np.full(flat.shape[1], np.nan)
    some = np.isfinite(flat).any(0)
    out[some] = np.nanmedian(flat[:, some], axis=0)
    return out


def _recorded_limit(recs: Recordings) -> float | None:
    """Return the force limit [N] that the recordings suggest; None where nothing was touched."""
    if "fingertip_force" not in recs.readings:
        return None
    force = recs.readings["fingertip_force"]
    if not fingertip_contact(np.nan_to_num(force)).any():
        return None
    return FORCE_MARGIN * float(np.nanmax(np.linalg.norm(force, axis=-1)))


def usual_motions(scene: Scene, duration_s: float, seed: int = 0) -> tuple[Motion, ...]:
    """Return the scene's usual motions as commands, one each."""
    return tuple(_motions(scene, duration_s, seed, variants=False))


def all_motions(scene: Scene, duration_s: float, seed: int = 0) -> tuple[Motion, ...]:
    """Return the scene's usual motions and then their variants, as commands within the limits of actuators and joints.

    Parameters
    ----------
    scene : Scene
    duration_s : float
        Length of each.
    seed : int
        Seed of what is random in them.
    """
    return tuple(_motions(scene, duration_s, seed, variants=False) + _motions(scene, duration_s, seed, variants=True))


def _motions(scene: Scene, duration_s: float, seed: int, variants: bool) -> list[Motion]:
    """Return motions of the policies that the scene plays."""
    if not len(scene.actuator_ids):
        return []
    low, high = command_limits(scene).T
    found = []
    for number, name in enumerate(possible_policies(scene)):
        kind = policy(name)
        planners = [(v.words, v.plan) for v in kind.variants] if variants else [(name, kind.plan)]
        for words, planner in planners:
            plan = planner(scene, np.random.default_rng([seed, number]), duration_s)
            shift = np.zeros(3) if plan.object_shift_m is None else plan.object_shift_m
            found.append(Motion(words, np.clip(plan.commands, low, high), shift))
    return found


def separating_motion(rivals: Rivals, duration_s: float, rng: np.random.Generator) -> Choice | None:
    """Return the motion under which the rivals differ most, or None where no motion stays within the limits.

    Parameters
    ----------
    rivals : Rivals
    duration_s : float
        Typical length of the recordings.
    rng : numpy.random.Generator
        Seeds of motions, starts and noise.
    """
    scene = rivals.replayer.scene
    length = float(np.clip(duration_s, SHORTEST_S, LONGEST_S))
    first, *seeds = (int(s) for s in rng.integers(2**31, size=3))
    motions = all_motions(scene, length, first)
    usual = len(usual_motions(scene, length, first))
    if not motions:
        return None
    plays, plays_again = PLAYS[len(rivals.sets)]
    apart, force = separations(rivals, motions, plays, seeds[0])
    limit = rivals.force_limit_n
    within = np.flatnonzero(force <= (FORCE_MARGIN * force[:usual].max(initial=0.0) if limit is None else limit))
    if not len(within):
        return None
    best = within[np.argsort(-apart[within])][:FINALISTS]
    # What won by luck in the first look is seen again with other starts and other noise.
    again, hard = separations(rivals, [motions[i] for i in best], plays_again, seeds[1])
    allowed = hard <= max(force[best].max(), 0.0 if limit is None else limit)
    chosen = int(np.argmax(np.where(allowed, again, -1.0)))
    return Choice(motions[best[chosen]], float(again[chosen]), float(np.median(apart[:usual])), len(within))


def separations(rivals: Rivals, motions: Sequence[Motion], plays: int, seed: int) -> tuple[Array, Array]:
    """Return `(M,)` the least separation of two rivals [floors] and `(M,)` the largest fingertip force [N].

    Parameters
    ----------
    rivals : Rivals
    motions : sequence of M Motion
    plays : int
        Plays of each from other starts, at least 2: what differs from play to play (noise, chaos of contact) is no
        separation.
    seed : int
        Seed of starts and noise; each world gets the same.
    """
    least, force = np.full(len(motions), np.inf), np.zeros(len(motions))
    for number, truth in enumerate(rivals.sets):
        recs = _played(rivals, motions, truth, plays, seed)
        if "fingertip_force" in recs.readings:
            size = np.linalg.norm(recs.readings["fingertip_force"], axis=-1)
            force = np.maximum(force, np.nanmax(size.reshape(len(motions), -1), axis=1))
        others = [some for k, some in enumerate(rivals.sets) if k != number]
        for apart in _left(rivals, _compared(rivals, recs), others, plays):
            least = np.minimum(least, apart)
    return least, force


def _played(rivals: Rivals, motions: Sequence[Motion], world: EffectSet, plays: int, seed: int) -> Recordings:
    """Return recordings of the motions in a world: M x plays episodes, the plays of a motion together."""
    scene = rivals.replayer.scene
    jobs = [
        Job(f"{m}-{k}", m * plays + k, motion.name, seed, world, motion=motion)
        for m, motion in enumerate(motions)
        for k in range(plays)
    ]
    made = make_episodes(scene, jobs, duration_s=0.0, noise=rivals.noise, threads=rivals.replayer.threads)
    return recordings(scene, made)


def _compared(rivals: Rivals, recs: Recordings) -> Recordings:
    """Return the recordings with what the real ones hold."""
    return replace(recs, readings={n: v for n, v in recs.readings.items() if n in rivals.channels})


def _left(rivals: Rivals, recs: Recordings, others: Sequence[EffectSet], plays: int) -> list[Array]:
    """Return, for each rival of the world in which `recs` were made, `(M,)` what it leaves of each motion."""
    scene = rivals.replayer.scene
    begin = starts(scene, recs)
    nominal, *theirs = replay_all(rivals.replayer, recs, begin, [(), *others])
    plan = layout(scene, recs, begin, nominal)
    spread = rivals.spread
    if spread is None:
        spread = np.repeat(smallest(plan, rivals.noise)[None], len(plan.phases), axis=0)
    sigma = spread[plan.phase]
    none = _by_motion(residual(recs, plan, nominal), plays)
    return [unexplained(none, _by_motion(residual(recs, plan, r), plays), _by_motion(sigma, plays)) for r in theirs]


def _by_motion(values: Array, plays: int) -> Array:
    """Return `(M, plays, B, D)` of `(M x plays, B, D)`."""
    return values.reshape(-1, plays, *values.shape[1:])


def unexplained(none: Array, fitted: Array, sigma: Array) -> Array:
    """Return `(M,)` the RMS residual [floors] that a refitted rival leaves in every play of a motion.

    Residuals between no effect and the fitted one are taken as linear, and the point with the least of them counts.
    The mean product of different plays is free of what is not common to them: noise and chaos add nothing, and the
    spread of the plays widens the floor.

    Parameters
    ----------
    none, fitted : (M, R, B, D) float64
        Residuals of R plays without an effect and with the rival's fit; NaN where not seen.
    sigma : (M, R, B, D) float64
        Floor of each.
    """
    seen = np.asarray((np.isfinite(none) & np.isfinite(fitted)).all(1))
    none, fitted = (np.where(seen[:, None], v, 0.0) for v in (none, fitted))
    spread = 0.5 * (none.var(1, ddof=1) + fitted.var(1, ddof=1))
    # Averaged over neighbours: weights that follow each cell's own luck would favour cells that agree by chance.
    unit = np.sqrt(np.maximum((sigma**2).mean(1), uniform_filter1d(spread, CHAOS_BLOCKS, axis=1)))[:, None]
    z, step = none / unit, (fitted - none) / unit
    along = step.mean(1)
    share = -(z.mean(1) * along).sum((1, 2)) / np.maximum((along**2).sum((1, 2)), 1e-12)
    left = z + np.clip(share, 0.0, FARTHEST)[:, None, None, None] * step
    plays = left.shape[1]
    common = (left.sum(1) ** 2 - (left**2).sum(1)) / (plays * (plays - 1))
    return np.sqrt(np.maximum(common.sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1), 0.0))
