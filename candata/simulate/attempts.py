"""Episodes tried until they end as wanted, and left out with a reason where they cannot be made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import CandataError, DataError, Where
from candata.policies import Plan
from candata.scenes import Scene
from candata.schema.episode import Episode
from candata.schema.outcome import is_wanted
from candata.schema.quarantine import QuarantinedEpisode
from candata.schema.scene import Noise
from candata.simulate.closed_loop import FailedStepsError
from candata.simulate.episodes import ATTEMPT_STREAM, EpisodeJob, planned, tried_episodes, unstable_error
from candata.simulate.perturbation import drawn

Array = NDArray[np.float64]
#: Attempts at a wanted outcome, after which the episode is left out. Chosen: what one draw in ten gives is missed by
#: one episode in 60.
MOST_ATTEMPTS = 40
#: Depth of an object in the hand or the table at which it starts inside [m], and how far the settling may move it out
#: [m]. Chosen: soft contacts of resting objects stay below 1 mm, and an object that a finger moves aside stays near.
INSIDE_M, MOVED_OUT_M = 0.005, 0.05


def attempted_episodes(
    scene: Scene, jobs: Sequence[EpisodeJob], wanted: Sequence[str | None], *, duration_s: float, noise: Noise | None
) -> list[Episode | QuarantinedEpisode]:
    """Return each job's episode, or why it cannot be made; the same whatever else is in the batch.

    Parameters
    ----------
    scene : Scene
        Where all play.
    jobs : sequence of EpisodeJob
        What to make.
    wanted : sequence of str or None
        The outcome that each is tried for, at most `MOST_ATTEMPTS` times; None takes the first.
    duration_s : float
        Length of an episode [s].
    noise : Noise, optional
        Sensor noise to add.
    """
    results: dict[int, Episode | CandataError] = {}
    seen: dict[int, Counter[str]] = {place: Counter() for place in range(len(jobs))}
    for attempt in range(MOST_ATTEMPTS):
        places = [place for place in seen if place not in results]
        if not places:
            break
        batch = [_attempt(jobs[place], wanted[place], attempt, duration_s) for place in places]
        for place, made in zip(places, _tried(scene, batch, duration_s, noise), strict=True):
            word = wanted[place]
            if word is None or (isinstance(made, Episode) and is_wanted(made.meta.outcome, word)):
                results[place] = made
            elif isinstance(made, Episode) and made.meta.outcome is None:
                results[place] = _aimless_error(scene, jobs[place], word)
            else:
                seen[place][str(made.meta.outcome) if isinstance(made, Episode) else made.problem] += 1
    return [
        _kept(scene, job, results.get(place) or _unreached_error(scene, job, str(wanted[place]), seen[place]))
        for place, job in enumerate(jobs)
    ]


def _attempt(job: EpisodeJob, wanted: str | None, attempt: int, duration_s: float) -> EpisodeJob:
    """Return the job of one attempt at an outcome; the job itself where none is wanted."""
    if wanted is None:
        return job
    rng = np.random.default_rng([job.seed, job.index, ATTEMPT_STREAM, attempt])
    return replace(job, draw=drawn(wanted, attempt, duration_s, rng))


def _tried(
    scene: Scene, jobs: Sequence[EpisodeJob], duration_s: float, noise: Noise | None
) -> list[Episode | CandataError]:
    """Return each job's episode, or the error that keeps it from being one."""
    plans = {job.id: _plan(scene, job, duration_s) for job in jobs}
    playable = [(job, plan) for job in jobs if isinstance(plan := plans[job.id], Plan)]
    made: dict[str, Episode | CandataError] = {
        name: plan for name, plan in plans.items() if isinstance(plan, CandataError)
    }
    made |= _played(scene, playable, duration_s, noise)
    return [made[job.id] for job in jobs]


def _played(
    scene: Scene, playable: Sequence[tuple[EpisodeJob, Plan]], duration_s: float, noise: Noise | None
) -> dict[str, Episode | CandataError]:
    """Return by id what became of each job that has a plan; those beside a policy that fails are played once more."""
    if not playable:
        return {}
    jobs, plans = zip(*playable, strict=True)
    try:
        episodes, fails = tried_episodes(scene, jobs, duration_s=duration_s, noise=noise, plans=plans)
    except FailedStepsError as failure:
        others = [(job, plan) for job, plan in playable if job.id not in failure.by_episode]
        return {**failure.by_episode, **_played(scene, others, duration_s, noise)}
    made: dict[str, Episode | CandataError] = {}
    for job, plan, episode, failed_s in zip(jobs, plans, episodes, fails, strict=True):
        if np.isfinite(failed_s):
            made[job.id] = unstable_error(scene, job, float(failed_s))
        else:
            made[job.id] = _start_error(scene, job, plan, episode) or episode
    return made


def _plan(scene: Scene, job: EpisodeJob, duration_s: float) -> Plan | CandataError:
    """Return the plan of a job, or why it has none."""
    try:
        return planned(scene, job, duration_s)
    except CandataError as error:
        return error


def _start_error(scene: Scene, job: EpisodeJob, plan: Plan, episode: Episode) -> DataError | None:
    """Return the error of an object that starts inside the hand or the table, and is still there or thrown out."""
    if scene.object_id is None:
        return None
    depth_m, obstacle = _depth(scene, plan.qpos)
    if depth_m <= INSIDE_M:
        return None
    at, settled_qpos = scene.object_qpos, plan.qpos.copy()
    settled_qpos[at : at + 7] = episode["object_pose"][0]
    moved_m = float(np.linalg.norm(settled_qpos[at : at + 3] - plan.qpos[at : at + 3]))
    if moved_m <= MOVED_OUT_M and _depth(scene, settled_qpos)[0] <= INSIDE_M:
        return None
    return DataError(
        f"the object starts inside {obstacle}",
        expected=f"at most {1000 * INSIDE_M:g} mm deep",
        found=f"{1000 * depth_m:.1f} mm with {job.policy}",
        where=Where(path=scene.name, episode=job.id),
        fix="move the object and the hand apart in the scene",
    )


def _depth(scene: Scene, qpos: Array) -> tuple[float, str]:
    """Return how deep the object is in anything else in a state `(nq,)` [m], and the name of that."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    is_object = np.isin(data.contact.geom, scene.object_geoms)
    depths = np.where(is_object.any(1) & ~is_object.all(1), -data.contact.dist, 0.0)
    if not len(depths):
        return 0.0, ""
    deepest = int(depths.argmax())
    geom = int(data.contact.geom[deepest][~is_object[deepest]][0]) if depths[deepest] > 0 else 0
    return float(depths[deepest]), model.geom(geom).name or f"a geom of {model.body(model.geom_bodyid[geom]).name}"


def _kept(scene: Scene, job: EpisodeJob, result: Episode | CandataError) -> Episode | QuarantinedEpisode:
    """Return an episode as it is, an error as the record of what is left out."""
    if isinstance(result, Episode):
        return result
    return QuarantinedEpisode.of(job.id, job.policy, job.object or scene.file.object, result)


def _aimless_error(scene: Scene, job: EpisodeJob, wanted: str) -> DataError:
    """Return the error of an episode that is meant to do nothing, and so has no outcome."""
    return DataError(
        f"policy {job.policy} has no goal, so its episodes have no outcome",
        expected=f"an episode that can end as {wanted}",
        where=Where(path=scene.name, episode=job.id),
        fix="name policies with a goal with --policies, or leave --outcomes out",
    )


def _unreached_error(scene: Scene, job: EpisodeJob, wanted: str, seen: Counter[str]) -> DataError:
    """Return the error of an episode of which no attempt ended as wanted."""
    return DataError(
        f"no draw gave the outcome {wanted}",
        expected=f"{wanted} in one of {MOST_ATTEMPTS} draws of {job.policy}",
        found=", ".join(f"{name} {count}" for name, count in sorted(seen.items())),
        where=Where(path=scene.name, episode=job.id),
        fix="ask for another mix with --outcomes, or for other policies",
    )
