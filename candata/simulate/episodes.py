"""Episodes from plans: play a batch, add sensor noise, cut the settling off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.policies import Motion, Plan, StepPolicy, command_limits, motion_plan, opening_plan, policy
from candata.rotation import exp, multiply
from candata.scenes import Scene
from candata.scenes.assemble import OBJECT_MARK
from candata.schema.channels import VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.disturbance import Disturbances, Kick
from candata.schema.effect import EffectSetting
from candata.schema.episode import ContactRule, Episode, EpisodeMeta
from candata.schema.scene import Noise
from candata.simulate.closed_loop import ClosedLoop, Pilot
from candata.simulate.contact_labels import NEWTON_PER_COUNT, label_channels
from candata.simulate.disturbances import Kicks, drawn_command_noise, drawn_kicks
from candata.simulate.loop import Alter, Trajectory, rollout
from candata.simulate.outcome import object_motion, outcome
from candata.simulate.perturbation import Draw, perturbed
from candata.simulate.tracker import with_tracker

Array = NDArray[np.float64]
#: Streams of an episode's random numbers: what is planned never depends on what is measured, or on drawn effects.
PLAN_STREAM, NOISE_STREAM, EFFECT_STREAM, ATTEMPT_STREAM = 0, 1, 2, 3
COMMAND_STREAM, KICK_STREAM, POLICY_STREAM = 4, 5, 6


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
    step_policy : StepPolicy, optional
        What gives the commands in a closed loop, instead of a policy.
    disturbances : Disturbances, optional
        Noise on its commands, and kicks.
    object : str, optional
        Name of the object that is in the place of the scene's own; the episode then bears the digest of its scene too.
    draw : Draw, optional
        The attempt at an outcome that is wanted of the episode.
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
    step_policy: StepPolicy | None = None
    disturbances: Disturbances | None = None
    object: str | None = None
    draw: Draw | None = None


def make_episodes(
    scene: Scene,
    jobs: Sequence[EpisodeJob],
    *,
    duration_s: float,
    noise: Noise | None = None,
    threads: int = 1,
    alter: Alter | None = None,
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

    Raises
    ------
    DataError
        When MuJoCo could not step a simulation to its end.
    """
    episodes, fails = tried_episodes(scene, jobs, duration_s=duration_s, noise=noise, threads=threads, alter=alter)
    for job, failed_s in zip(jobs, fails, strict=True):
        if np.isfinite(failed_s):
            raise unstable_error(scene, job, float(failed_s))
    return episodes


def unstable_error(scene: Scene, job: EpisodeJob, failed_s: float) -> DataError:
    """Return the error of an episode that MuJoCo gave up at a time after its start [s]."""
    step_ms = 1000 * scene.model.opt.timestep
    failure_time = "while it settles" if failed_s < 0 else f"{failed_s:.2f} s after its start"
    return DataError(
        "the simulation is unstable",
        expected=f"a finite state after every step of {step_ms:g} ms",
        found=f"{job.policy} {_in_words(job)}: none {failure_time}",
        where=Where(path=scene.name, episode=job.id),
        fix="give the model a smaller time step, more damping or armature, or milder effects",
    )


def tried_episodes(
    scene: Scene,
    jobs: Sequence[EpisodeJob],
    *,
    duration_s: float,
    noise: Noise | None = None,
    threads: int = 1,
    alter: Alter | None = None,
    plans: Sequence[Plan] | None = None,
) -> tuple[list[Episode], Array]:
    """Return the episodes of `jobs` and when MuJoCo gave each of them up, `(n,)` [s] after its start.

    Not a number where it did not; before zero, while the model settled. From there on such an episode means nothing.
    Parameters are those of `make_episodes`, and the jobs' `plans` where they are at hand.

    Raises
    ------
    FailedStepsError
        When policies in a closed loop give no commands.
    """
    plans = plans or [planned(scene, j, duration_s) for j in jobs]
    settle = round(plans[0].settle_s * scene.file.rate_hz)
    rows = max(len(p.commands) for p in plans)
    commands = np.stack([_padded_commands(p, settle, rows) for p in plans])
    pilots = [_pilot(scene, j, len(p.commands), noise) for j, p in zip(jobs, plans, strict=True)]
    kicks = [_kicks(scene, j, len(p.commands)) for j, p in zip(jobs, plans, strict=True)]
    closed_loop = ClosedLoop(pilots, settle, scene.file.rate_hz, command_limits(scene))
    trajectory = rollout(
        scene,
        commands,
        np.stack([p.qpos for p in plans]),
        np.stack([p.qvel for p in plans]),
        [j.effects for j in jobs],
        observer=Kicks(scene, kicks, settle) if any(kicks) else None,
        closed_loop=closed_loop if any(pilots) else None,
        settle=settle,
        threads=threads,
        alter=alter,
        keep_state=any(p.goal for p in plans),
    )
    closed_loop.check()
    plans = [
        replace(p, commands=given[settle : settle + len(p.commands)]) for p, given in zip(plans, commands, strict=True)
    ]
    ends = np.array([settle + len(p.commands) for p in plans])
    fails = np.where(trajectory.failed < ends, (trajectory.failed - settle) / scene.file.rate_hz, np.nan)
    numbered_jobs = enumerate(zip(jobs, plans, kicks, strict=True))
    return [_episode(scene, j, p, k, trajectory, i, settle, noise) for i, (j, p, k) in numbered_jobs], fails


def _in_words(job: EpisodeJob) -> str:
    """Return which effects act in a job, unless these are withheld."""
    if job.hidden:
        return "with what is withheld"
    return f"with {', '.join(e.name for e in job.effects)}" if job.effects else "without any effect"


def planned(scene: Scene, job: EpisodeJob, duration_s: float) -> Plan:
    """Return the plan of one job.

    Raises
    ------
    DataError
        When the policy plans what cannot be played: too few or too many commands, or numbers that are not finite.
    """
    rng = _rng(job, PLAN_STREAM)
    if job.step_policy is not None:
        return opening_plan(scene, rng, duration_s)
    plan = motion_plan(scene, job.motion, rng) if job.motion else policy(job.policy).plan(scene, rng, duration_s)
    _refuse_impossible(scene, job, plan)
    plan = perturbed(scene, plan, job.draw) if job.draw else plan
    noise = _command_noise(scene, job, len(plan.commands))
    return replace(plan, commands=np.clip(plan.commands + noise, *command_limits(scene).T)) if noise.any() else plan


def _command_noise(scene: Scene, job: EpisodeJob, rows: int) -> Array:
    """Return what is added to the commands of a job, `(T, A)`."""
    noise = job.disturbances.command_noise if job.disturbances else None
    if noise is None:
        return np.zeros((rows, len(scene.actuator_ids)))
    return drawn_command_noise(noise, scene, _rng(job, COMMAND_STREAM), rows)


def _kicks(scene: Scene, job: EpisodeJob, rows: int) -> tuple[Kick, ...]:
    """Return the kicks of a job."""
    if job.disturbances is None:
        return ()
    return drawn_kicks(job.disturbances, _rng(job, KICK_STREAM), rows, scene.file.rate_hz)


def _pilot(scene: Scene, job: EpisodeJob, rows: int, noise: Noise | None) -> Pilot | None:
    """Return what gives the commands of a job in a closed loop; None where they are planned."""
    if job.step_policy is None:
        return None
    return Pilot(
        job.id,
        partial(job.step_policy.begin, scene, _rng(job, POLICY_STREAM)),
        lambda readings: _sensed(scene, job, readings, noise),
        rows,
        _command_noise(scene, job, rows),
    )


def _sensed(scene: Scene, job: EpisodeJob, readings: dict[str, Array], noise: Noise | None) -> dict[str, NDArray]:
    """Return readings `(T, ...)` with the episode's noise, the object's pose as the scene's tracker gives it."""
    rng = _rng(job, NOISE_STREAM)
    return with_tracker(add_noise(readings, noise, rng), noise, scene.file.rate_hz, rng)


def _refuse_impossible(scene: Scene, job: EpisodeJob, plan: Plan) -> None:
    """Raise DataError where a plan has the wrong size or holds numbers that are not finite."""
    rows = len(plan.commands)
    shapes = {
        "commands": (plan.commands, (rows, len(scene.actuator_ids))),
        "qpos": (plan.qpos, (scene.model.nq,)),
        "qvel": (plan.qvel, (scene.model.nv,)),
    }
    for name, (array, shape) in shapes.items():
        is_finite = bool(np.isfinite(array).all())
        if rows == 0 or np.shape(array) != shape or not is_finite:
            raise DataError(
                f"policy {job.policy} plans what cannot be played",
                expected=f"{name} of shape {shape}, all finite",
                found=f"shape {np.shape(array)}{'' if is_finite else ', not all finite'}",
                where=Where(path=scene.name, episode=job.id),
                fix="mend the policy, or leave it out with --policies",
            )


def _rng(job: EpisodeJob, stream: int) -> np.random.Generator:
    """Return the generator of one stream of a job."""
    noise_seed = job.noise_seed if stream == NOISE_STREAM else None
    attempt = [job.draw.attempt] if job.draw and job.draw.attempt and stream == PLAN_STREAM else []
    return np.random.default_rng([job.seed if noise_seed is None else noise_seed, job.index, stream, *attempt])


def _padded_commands(plan: Plan, settle: int, rows: int) -> Array:
    """Return the commands with the first held for `settle` rows before and the last held to `rows` after."""
    first_rows = np.repeat(plan.commands[:1], settle, axis=0)
    last_rows = np.repeat(plan.commands[-1:], rows - len(plan.commands), axis=0)
    return np.concatenate([first_rows, plan.commands, last_rows])


def _episode(
    scene: Scene,
    job: EpisodeJob,
    plan: Plan,
    kicks: tuple[Kick, ...],
    trajectory: Trajectory,
    index: int,
    settle: int,
    noise: Noise | None,
) -> Episode:
    """Return one episode of a played batch."""
    part = slice(settle, settle + len(plan.commands))
    readings = {name: value[index, part] for name, value in trajectory.readings.items()}
    arrays = _sensed(scene, job, readings, noise)
    labels = {name: value[index, part] for name, value in trajectory.labels.items()}
    arrays |= label_channels(labels, arrays.get("fingertip_force"))
    count = len(plan.commands)
    arrays["time_ns"] = np.round(np.arange(count) * 1e9 / scene.file.rate_hz).astype(np.int64)
    if plan.commands.shape[1]:
        arrays["action"] = plan.commands
    if "fingertip_force" in arrays:
        arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], ContactRule().threshold_n)
        arrays["contact"] = np.asarray(arrays["fingertip_contact"].any(1))
    return Episode(_meta(scene, job, arrays, kicks, _outcome(scene, plan, trajectory, index, part)), arrays)


def _outcome(scene: Scene, plan: Plan, trajectory: Trajectory, index: int, part: slice) -> str | None:
    """Return what became of the object; None where nothing was meant with it."""
    if plan.goal is None or scene.object_id is None:
        return None
    qpos, touch, tip_force = (
        trajectory.qpos[index, part],
        trajectory.touch[index, part],
        trajectory.tip_force[index, part],
    )
    return outcome(plan.goal, object_motion(scene, qpos, touch, tip_force))


def _meta(
    scene: Scene, job: EpisodeJob, arrays: dict[str, NDArray], kicks: tuple[Kick, ...], outcome_word: str | None
) -> EpisodeMeta:
    """Return who, what, when; and what is to be known of the arrays."""
    # The object by its name: where its folder lies decides nothing.
    base, mark, _ = scene.name.rpartition(OBJECT_MARK)
    labels = job.draw.labels() if job.draw else {}
    if job.object is not None:
        labels["scene_digest"] = scene.digest
    return EpisodeMeta(
        id=job.id,
        source="sim",
        rate_hz=scene.file.rate_hz,
        scene=scene.name if job.object is None else f"{base}{mark}{job.object}",
        object=job.object or scene.file.object,
        task=job.policy,
        seed=None if job.hidden else job.seed,
        effects=None if job.hidden else job.effects,
        outcome=outcome_word,
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
        labels=labels,
        kicks=kicks,
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
