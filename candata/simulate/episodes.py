"""Episodes from plans: play a batch, add sensor noise, cut the settling off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.policies import Motion, Plan, motion_plan, policy
from candata.rotation import exp, multiply
from candata.scenes import Scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.labels import with_labels
from candata.schema.channels import VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.effect import EffectSetting
from candata.schema.episode import ContactRule, Episode, EpisodeMeta
from candata.schema.scene import Noise
from candata.simulate.contact_labels import NEWTON_PER_COUNT, taxel_counts
from candata.simulate.loop import Alter, Trajectory, rollout
from candata.simulate.tracker import tracked_pose

Array = NDArray[np.float64]
#: Streams of an episode's random numbers: what is planned never depends on what is measured, or on drawn effects.
PLAN_STREAM, NOISE_STREAM, EFFECT_STREAM = 0, 1, 2


@dataclass(frozen=True)
class EpisodeJob:
    """One episode to make.

    Attributes
    ----------
    id : str
        Id of the episode.
    index : int
        Number in its set; seeds its random streams together with `seed`.
    policy : str
        Name of the policy, or of the motion.
    seed : int
        Seed of the set.
    effects : tuple of EffectSetting
        Effects of its world.
    hidden : bool
        Keep seed and effects out of the episode.
    point_cloud : str, optional
        Name of the object's cloud in the dataset.
    noise_seed : int, optional
        Seed of the sensor noise, where it is not `seed`.
    motion : Motion, optional
        What to play instead of a policy.
    object : str, optional
        Name of the object that is in the place of the scene's own; the episode then bears the digest of its scene too.
    """

    id: str
    index: int
    policy: str
    seed: int
    effects: tuple[EffectSetting, ...] = ()
    hidden: bool = False
    point_cloud: str | None = None
    noise_seed: int | None = None
    motion: Motion | None = None
    object: str | None = None


def make_episodes(
    scene: Scene,
    jobs: Sequence[EpisodeJob],
    *,
    duration_s: float,
    noise: Noise | None = None,
    threads: int = 1,
    alter: Alter | None = None,
    collision: bool = False,
    taxels: bool = False,
) -> list[Episode]:
    """Return the episodes of `jobs`, simulated as one batch; the same for a seed whatever else is in it.

    Parameters
    ----------
    scene : Scene
        The nominal scene; each job adds its own effects.
    jobs : sequence of Job
        What to make.
    duration_s : float
        Length of each episode after settling; a motion has its own.
    noise : Noise, optional
        Sensor noise to add; none when omitted.
    threads : int
        Threads of the pool.
    alter : callable, optional
        As in `rollout`.
    collision : bool
        Add `fingertip_collision`, where the scene has fingertips and an object.
    taxels : bool
        Add `taxels`, where the scene has fingertips.

    Raises
    ------
    DataError
        When MuJoCo could not step a simulation to its end.
    UsageError
        When labels are to be added and the scene is not as `load_scene` returns it.
    """
    episodes, fails = tried_episodes(
        scene,
        jobs,
        duration_s=duration_s,
        noise=noise,
        threads=threads,
        alter=alter,
        collision=collision,
        taxels=taxels,
    )
    for job, failed_s in zip(jobs, fails, strict=True):
        if np.isfinite(failed_s):
            step_ms = 1000 * scene.model.opt.timestep
            failure_time = "while it settles" if failed_s < 0 else f"{failed_s:.2f} s after its start"
            raise DataError(
                "the simulation is unstable",
                expected=f"a finite state after every step of {step_ms:g} ms",
                found=f"{job.policy} {_in_words(job)}: none {failure_time}",
                where=Where(path=scene.name, episode=job.id),
                fix="give the model a smaller time step, more damping or armature, or milder effects",
            )
    return episodes


def tried_episodes(
    scene: Scene,
    jobs: Sequence[EpisodeJob],
    *,
    duration_s: float,
    noise: Noise | None = None,
    threads: int = 1,
    alter: Alter | None = None,
    collision: bool = False,
    taxels: bool = False,
) -> tuple[list[Episode], Array]:
    """Return the episodes of `jobs` and when MuJoCo gave each of them up, `(n,)` [s] after its start.

    Not a number where it did not; before zero, while the model settled. From there on such an episode means nothing.
    Parameters are those of `make_episodes`.
    """
    plans = [_plan(scene, j, duration_s) for j in jobs]
    settle = round(plans[0].settle_s * scene.file.rate_hz)
    rows = max(len(p.commands) for p in plans)
    commands = np.stack([_padded_commands(p, settle, rows) for p in plans])
    trajectory = rollout(
        with_labels(scene, taxels) if collision or taxels else scene,
        commands,
        np.stack([p.qpos for p in plans]),
        np.stack([p.qvel for p in plans]),
        [j.effects for j in jobs],
        settle=settle,
        threads=threads,
        alter=alter,
    )
    ends = np.array([settle + len(p.commands) for p in plans])
    fails = np.where(trajectory.failed < ends, (trajectory.failed - settle) / scene.file.rate_hz, np.nan)
    numbered_jobs = enumerate(zip(jobs, plans, strict=True))
    return [_episode(scene, j, p, trajectory, i, settle, noise) for i, (j, p) in numbered_jobs], fails


def _in_words(job: EpisodeJob) -> str:
    """Return which effects act in a job, unless these are withheld."""
    if job.hidden:
        return "with what is withheld"
    return f"with {', '.join(e.name for e in job.effects)}" if job.effects else "without any effect"


def _plan(scene: Scene, job: EpisodeJob, duration_s: float) -> Plan:
    """Return the plan of one job."""
    rng = _rng(job, PLAN_STREAM)
    return motion_plan(scene, job.motion, rng) if job.motion else policy(job.policy).plan(scene, rng, duration_s)


def _rng(job: EpisodeJob, stream: int) -> np.random.Generator:
    """Return the generator of one stream of a job."""
    noise_seed = job.noise_seed if stream == NOISE_STREAM else None
    return np.random.default_rng([job.seed if noise_seed is None else noise_seed, job.index, stream])


def _padded_commands(plan: Plan, settle: int, rows: int) -> Array:
    """Return the commands with the first held for `settle` rows before and the last held to `rows` after."""
    first_rows = np.repeat(plan.commands[:1], settle, axis=0)
    last_rows = np.repeat(plan.commands[-1:], rows - len(plan.commands), axis=0)
    return np.concatenate([first_rows, plan.commands, last_rows])


def _episode(
    scene: Scene, job: EpisodeJob, plan: Plan, trajectory: Trajectory, index: int, settle: int, noise: Noise | None
) -> Episode:
    """Return one episode of a played batch."""
    part = slice(settle, settle + len(plan.commands))
    readings = {name: value[index, part] for name, value in trajectory.readings.items()}
    rng, rate_hz = _rng(job, NOISE_STREAM), scene.file.rate_hz
    arrays: dict[str, NDArray] = {**add_noise(readings, noise, rng)}
    if noise is not None and noise.tracker is not None and "object_pose" in arrays:
        arrays["object_pose"], valid = tracked_pose(arrays["object_pose"], noise.tracker, rate_hz, rng)
        if noise.tracker.dropout_share:  # all episodes of a set have the same channels
            arrays["object_pose_valid"] = valid
    count = len(plan.commands)
    arrays["time_ns"] = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    if plan.commands.shape[1]:
        arrays["action"] = plan.commands
    labels = {name: value[index, part] for name, value in trajectory.labels.items()}
    if "collision" in labels:
        arrays["fingertip_collision"] = labels["collision"]
    if "taxel_force" in labels:
        arrays["taxels"] = taxel_counts(labels["taxel_force"], arrays["fingertip_force"])
    if "fingertip_force" in arrays:
        arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], ContactRule().threshold_n)
        arrays["contact"] = np.asarray(arrays["fingertip_contact"].any(1))
    return Episode(_meta(scene, job, arrays), arrays)


def _meta(scene: Scene, job: EpisodeJob, arrays: dict[str, NDArray]) -> EpisodeMeta:
    """Return who, what, when; and what is to be known of the arrays."""
    # The object by its name: where its folder lies decides nothing.
    base, mark, _ = scene.name.rpartition(OBJECT_MARK)
    return EpisodeMeta(
        id=job.id,
        source="sim",
        rate_hz=scene.file.rate_hz,
        scene=scene.name if job.object is None else f"{base}{mark}{job.object}",
        object=job.object or scene.file.object,
        task=job.policy,
        seed=None if job.hidden else job.seed,
        effects=None if job.hidden else job.effects,
        joint_names=scene.file.joints,
        actuator_names=scene.file.actuator_names,
        fingertip_names=scene.file.fingertips,
        contact_rule=ContactRule() if "fingertip_force" in arrays else None,
        newton_per_count=NEWTON_PER_COUNT if "taxels" in arrays else None,
        invalid_counts={
            name.removesuffix(VALID_SUFFIX): int((~flags).sum())
            for name, flags in arrays.items()
            if name.endswith(VALID_SUFFIX)
        },
        point_cloud=job.point_cloud,
        labels={} if job.object is None else {"scene_digest": scene.digest},
    )


def add_noise(arrays: dict[str, Array], noise: Noise | None, rng: np.random.Generator) -> dict[str, Array]:
    """Return the channels with white sensor noise and the rounding of joints and forces, as the scene declares them.

    Parameters
    ----------
    arrays : dict of str to ndarray
        `object_pose (..., 7)`, `joint_position`, `joint_velocity` and `joint_effort (..., J)`,
        `fingertip_force (..., F, 3)`; others pass through.
    noise : Noise or None
        One standard deviation of each; None returns the arrays as they are.
    rng : numpy.random.Generator
        Source of the noise.
    """
    if noise is None:
        return dict(arrays)
    out = dict(arrays)
    if "object_pose" in out:
        pose = out["object_pose"]
        position = pose[..., :3] + noise.object_pose[0] * rng.standard_normal(pose[..., :3].shape)
        turn = exp(noise.object_pose[1] * rng.standard_normal(pose[..., :3].shape))
        out["object_pose"] = np.concatenate([position, multiply(turn, pose[..., 3:])], axis=-1)
    if "joint_position" in out:
        joints = out["joint_position"]
        out["joint_position"] = rounded(
            joints + np.asarray(noise.joint_position) * rng.standard_normal(joints.shape), noise.joint_step
        )
    for channel, size in (("joint_velocity", noise.joint_velocity), ("joint_effort", noise.joint_effort)):
        if channel in out:
            out[channel] = out[channel] + np.asarray(size) * rng.standard_normal(out[channel].shape)
    if "fingertip_force" in out:
        force = out["fingertip_force"]
        force = force + noise.fingertip_force * rng.standard_normal(force.shape)
        out["fingertip_force"] = rounded(force, noise.force_step)
    return out


def rounded(values: Array, step: float | Sequence[float]) -> Array:
    """Return values rounded to whole steps, one step or one for each of the last axis; as they are where it is 0."""
    size = np.broadcast_to(step, values.shape[-1:])
    if not size.any():
        return values
    return np.where(size > 0, np.round(values / np.where(size > 0, size, 1.0)) * size, values)
