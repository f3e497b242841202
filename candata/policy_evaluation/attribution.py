"""Which effects explain wrong predictions, and which motion would tell worlds apart best."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from candata.policies import Motion
from candata.policy_evaluation.contract import Played, RealStarts
from candata.policy_evaluation.results import Disagreement, EffectShare
from candata.scenes import Scene

Array = NDArray[np.float64]


def effect_share(effect: str, seen: Array, nominal: Array, repaired: Array, without: Array) -> EffectShare:
    """Return what one effect explains of the wrong predictions of the nominal simulator.

    Parameters
    ----------
    effect : str
        Its name.
    seen : (P, n) float64
        What was seen, 1 or 0; NaN where nothing was. A share of repeats counts as what most of them were, and as
        nothing where half of them were each.
    nominal, repaired, without : (P, n) float64
        Predicted success of the nominal simulator, of the repaired one, and of that without the effect; NaN where one
        became unstable, which counts for nothing.
    """
    known = np.isfinite(seen + nominal + repaired + without) & (seen != 0.5)
    truth = seen > 0.5
    right_nominal, right_repaired, right_without = ((world > 0.5) == truth for world in (nominal, repaired, without))
    wrong = known & ~right_nominal
    explained = wrong & right_repaired & ~right_without
    broken = known & right_nominal & ~right_repaired & right_without
    count = int(wrong.sum())
    return EffectShare(
        effect=effect,
        explained=int(explained.sum()),
        broken=int(broken.sum()),
        wrong=count,
        share=float(explained.sum() / count) if count else float("nan"),
    )


def disagreement(
    plays: Mapping[tuple[str, str], Played],
    policies: tuple[str, ...],
    worlds: tuple[str, ...],
    starts: RealStarts,
    commands_of: str,
) -> Disagreement | None:
    """Return the policy and the start for which worlds disagree most; None of fewer than two worlds.

    The share of pairs of worlds that end differently comes first, then how far apart the object goes on average in the
    two worlds that differ most. Unstable simulations do not count.

    Parameters
    ----------
    plays : mapping of (policy, world) to Played
        What came of each.
    policies, worlds : tuple of str
        Names; the worlds that predict.
    starts : RealStarts
        In the order of what was played.
    commands_of : str
        The world whose commands would be recorded.
    """
    pairs = list(combinations(worlds, 2))
    if not pairs or not len(starts):
        return None
    widest_choice: tuple[tuple[float, float], str, int, tuple[str, str]] | None = None
    for policy in policies:
        runs = {world: plays[policy, world] for world in worlds}
        stable = ~np.any([run.failed for run in runs.values()], axis=0)
        success = {world: run.success for world, run in runs.items()}
        differing = np.mean([success[a] != success[b] for a, b in pairs], axis=0)
        distances_m = np.stack([_distance(runs[a], runs[b]) for a, b in pairs])
        for i in np.flatnonzero(stable).tolist():
            widest = int(distances_m[:, i].argmax())
            key = (float(differing[i]), float(distances_m[widest, i]))
            if widest_choice is None or key > widest_choice[0]:
                widest_choice = key, policy, i, pairs[widest]
    if widest_choice is None:
        return None
    (_, distance), policy, i, between = widest_choice
    return Disagreement(
        policy=policy,
        start=starts.ids[i],
        outcomes={world: str(plays[policy, world].outcomes[i]) for world in worlds},
        distance_m=distance,
        between=between,
        commands=commands_of,
    )


def _distance(first: Played, second: Played) -> Array:
    """Return the mean distance `(n,)` of the object between two worlds [m]."""
    distances_m = np.linalg.norm(first.object_pose[..., :3] - second.object_pose[..., :3], axis=-1)
    return np.asarray(distances_m.mean(1))


def next_motion(scene: Scene, choice: Disagreement, plays: Played, starts: RealStarts) -> Motion:
    """Return the motion to record: the commands as they were played, and where the object stands."""
    i, at = starts.ids.index(choice.start), scene.object_qpos
    shift = starts.qpos[i, at : at + 3] - np.asarray(scene.model.qpos0[at : at + 3], float)
    return Motion(f"{choice.policy} from {choice.start}", plays.commands[i], shift)
