"""What to do next: the motion under which the causes that are still tied differ most (T-optimal).

Each tied candidate in turn is taken for the truth: its world plays a motion, and all replay it under the observer as a
diagnosis would. What counts is what will decide: by how much the loss of a wrong candidate, refitted, lies above that
of the true one, in floors of the motion itself. The motion whose least of these is largest is the one to record.

Source: Atkinson & Fedorov 1975, "Optimal design: experiments for discriminating between several models", Biometrika
62, eq. 1; the refit runs along the line from no effect to the fitted one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings, recordings
from candata.gap.fit.problem import Problem
from candata.gap.measure.floor import spread
from candata.gap.measure.score import Compact, Score, score
from candata.gap.replay.replayer import EffectSet, Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.policies import Motion, command_limits, policy
from candata.scenes import Scene
from candata.schema.contact import fingertip_contact
from candata.schema.scene import Noise
from candata.simulate.episodes import EpisodeJob, tried_episodes
from candata.simulate.jobs import possible_policies

Array = NDArray[np.float64]
#: Plays of each motion from other starts in the first look, and of the `FINALISTS` best in the second, by the number
#: of rivals: 392 and 345 simulations for the 17 motions of `xhand_tabletop`.
PLAYS = {2: (2, 5), 3: (1, 2)}
FINALISTS = 3
#: Tied candidates that are told apart at most.
RIVALS = max(PLAYS)
#: Largest fingertip force of a proposed motion, over the largest one recorded.
FORCE_MARGIN = 1.5
#: Shortest and longest proposed motion [s]: time to grasp, carry and let go, whatever the recordings' length.
SHORTEST_S, LONGEST_S = 2.0, 4.0
#: Points of the line from no effect (0) to the fitted one (1) and beyond at which a refit is tried.
REFIT = tuple(np.linspace(0.0, 3.0, 25).tolist())


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
    force_limit_n : float, optional
        Largest force on a fingertip [N]; by default `FORCE_MARGIN` times what the scene's usual motions need.
    """

    replayer: Replayer
    sets: tuple[EffectSet, ...]
    noise: Noise
    channels: tuple[str, ...]
    force_limit_n: float | None = None


@dataclass(frozen=True)
class Choice:
    """The motion to record and what it is expected to show.

    Attributes
    ----------
    motion : Motion
    separation : float
        Least loss by which a wrong candidate is worse than the truth after a refit, in floors of the motion.
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
    """Return the rivals of a diagnosis: with its noise, within the forces of its recordings."""
    return Rivals(
        problem.replayer,
        tuple(sets[:RIVALS]),
        problem.noise,
        tuple(problem.recs.readings),
        _recorded_limit(problem.recs),
    )


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
    """Return `(M,)` the least loss of a wrong rival [floors] and `(M,)` the largest fingertip force [N].

    A motion that MuJoCo cannot step to its end in the world of a rival separates nothing.

    Parameters
    ----------
    rivals : Rivals
    motions : sequence of M Motion
    plays : int
        Plays of each from other starts.
    seed : int
        Seed of starts and noise; each world gets the same.
    """
    least, force = np.full(len(motions), np.inf), np.zeros(len(motions))
    for number, truth in enumerate(rivals.sets):
        recs, sound = _played(rivals, motions, truth, plays, seed)
        if "fingertip_force" in recs.readings:
            size = np.linalg.norm(recs.readings["fingertip_force"], axis=-1)
            force = np.maximum(force, np.nanmax(size.reshape(len(motions), -1), axis=1))
        others = [some for k, some in enumerate(rivals.sets) if k != number]
        for losses in _losses(rivals, _compared(rivals, recs), truth, others):
            refitted = losses.reshape(len(REFIT), len(motions), plays).mean(2).min(0)
            least = np.minimum(least, np.where(sound, np.maximum(refitted, 0.0), 0.0))
    return least, force


def _played(
    rivals: Rivals, motions: Sequence[Motion], world: EffectSet, plays: int, seed: int
) -> tuple[Recordings, NDArray[np.bool_]]:
    """Return recordings of the motions in a world, and which motions `(M,)` went to their end.

    They are M x plays episodes, the plays of a motion together.
    """
    scene = rivals.replayer.scene
    jobs = [
        EpisodeJob(f"{m}-{k}", m * plays + k, motion.name, seed, world, motion=motion)
        for m, motion in enumerate(motions)
        for k in range(plays)
    ]
    made, fails = tried_episodes(scene, jobs, duration_s=0.0, noise=rivals.noise, threads=rivals.replayer.threads)
    return recordings(scene, made), np.all(np.isnan(fails).reshape(len(motions), plays), axis=1)


def _compared(rivals: Rivals, recs: Recordings) -> Recordings:
    """Return the recordings with what the real ones hold."""
    return replace(recs, readings={n: v for n, v in recs.readings.items() if n in rivals.channels})


def _losses(rivals: Rivals, recs: Recordings, truth: EffectSet, others: Sequence[EffectSet]) -> list[Array]:
    """Return, for each rival, `(E,)` how much worse than the truth it does on recordings of the truth's world."""
    scene = rivals.replayer.scene
    begin = starts(scene, recs)
    nominal, right, *theirs = replay_all(rivals.replayer, recs, begin, [(), truth, *others])
    plan = layout(scene, recs, begin, nominal)
    own = residual(recs, plan, right)
    # What the truth leaves of its own recording is the floor: noise, and the chaos of these contacts.
    level = score(own, spread(rivals.noise, plan, own[None]), plan)
    none = level.normal(residual(recs, plan, nominal))
    return [rival_excess(level, none, level.normal(residual(recs, plan, r))) for r in theirs]


def rival_excess(level: Score, none: Compact, fitted: Compact) -> Array:
    """Return `(G, E)` the loss beyond the floor that a rival leaves, at each point of the line on which it is refitted.

    Parameters
    ----------
    level : Score
        In units of what the truth leaves.
    none, fitted : (E, K) float32
        Normalised residuals without an effect and with the rival's fit; linear in between and beyond.
    """
    return np.stack([level.loss(none + np.float32(u) * (fitted - none)) - 1.0 for u in REFIT])
