"""The floor: what the same comparison shows when nothing but sensor noise differs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.deviation import COLUMNS, shifted_readings
from candata.gap.data.recordings import Recordings
from candata.gap.data.sample_hold import held_readings
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.replayer import EffectSet, Replayer, read_alike, replay, true_start
from candata.gap.replay.residuals import Layout, residual
from candata.gap.replay.starts import FIT_ROWS, Starts, starts
from candata.rotation import exp, multiply
from candata.scenes.traits import is_toss
from candata.schema.scene import Noise
from candata.simulate import rollout
from candata.simulate.episodes import add_noise

Array = NDArray[np.float64]
#: Null replays of each episode; at most `WORLDS` of them differ in their true start, each measured as often with fresh
#: noise. Record 43.
REPLICAS, WORLDS = 16, 4
#: Parts of the null replays that are left out in turn, to learn what a replay loses that had no say in the spread.
PARTS = 4
#: Share of a column's typical spread below which no episode's own spread is believed.
SPREAD_FLOOR = 0.3


@dataclass(frozen=True)
class Floor:
    """Spread and loss of null replays.

    Attributes
    ----------
    sigma : (E, B, D) float64
        Spread of each residual: the 68 % quantile of its size over null replays, by episode, column and phase.
    null : (R, E, B, D) float64
        Residuals of the null replays.
    without : (P, E, B, D) float64
        The same spread without each part of them: part p has every P-th one, from the p-th on. Without parts (P = 0)
        nothing is known of a replay that had no say in the spread.
    """

    sigma: Array
    null: Array
    without: Array = field(default_factory=lambda: np.zeros(0))


def null_recordings(
    replayer: Replayer,
    recs: Recordings,
    begin: Starts,
    noise: Noise,
    rng: np.random.Generator,
    replicas: int = REPLICAS,
    world: EffectSet = (),
) -> Recordings:
    """Return R x E recordings of a world on the same commands, starting near the recorded starts.

    The world starts where its own sensors would have read what was recorded.
    """
    worlds = min(WORLDS, replicas)
    begin = true_start(replayer.scene, recs, begin, world)
    true = perturbed(replayer, begin.take(np.tile(np.arange(len(recs)), worlds)), noise, rng)
    played = rollout(
        replayer.scene,
        np.concatenate([recs.commands] * worlds),
        true.qpos0,
        true.qvel0,
        [world] * len(true.rows),
        memory=true.memory0,
        supply=None if recs.supply is None else np.concatenate([recs.supply] * worlds),
        instant_force=recs.instant_force,
        read_effort="joint_effort" in recs.readings,
        threads=replayer.threads,
    )
    replayer.count(len(true.rows) * recs.commands.shape[1] * replayer.scene.substeps)
    copies = replicas // worlds
    index = np.tile(np.arange(len(recs)), worlds * copies)
    simulated = read_alike(replayer.scene, recs, played.readings)
    readings = {n: np.concatenate([v] * copies) for n, v in simulated.items() if n in recs.readings}
    taken = recs.take(index)
    for part in recs.slow:
        deviations = part.copies(worlds * copies).drawn(replayer.scene.file.rate_hz, rng)
        readings = shifted_readings(readings, deviations)
    noisy = add_noise(readings, noise, rng)
    for name, values in taken.readings.items():
        noisy[name] = np.where(np.isfinite(values), held_readings(noisy[name], taken.sources.get(name)), np.nan)
    return replace(taken, readings=noisy, misfit=None)


def perturbed(replayer: Replayer, begin: Starts, noise: Noise, rng: np.random.Generator) -> Starts:
    """Return starts that could have led to the same recordings: off by what averaging leaves of the noise.

    Poses averaged over `STILL_ROWS` rows keep a third of the noise of one. The height stays: a resting object
    stands on its support.
    """
    scene, count = replayer.scene, len(begin.rows)
    joints = (
        np.asarray(noise.joint_position) / np.sqrt(STILL_ROWS) * rng.standard_normal((count, len(scene.joint_qpos)))
    )
    shift = noise.object_pose[0] / np.sqrt(STILL_ROWS) * rng.standard_normal((count, 2))
    turn = exp(noise.object_pose[1] / np.sqrt(STILL_ROWS) * rng.standard_normal((count, 3)))
    moved = {"qvel": begin.qvel.copy(), "qvel0": begin.qvel0.copy()}
    if is_toss(scene):
        # A slope fitted to n + 1 rows of noise s at rate f is off by about s f / n.
        per_row = scene.file.rate_hz / np.maximum(begin.rows, FIT_ROWS)[:, None]
        push = np.repeat(noise.object_pose, 3) * per_row * rng.standard_normal((count, 6))
        for name in moved:
            moved[name][:, scene.object_dof : scene.object_dof + 6] += push
    for name in ("qpos", "qpos0"):
        qpos = getattr(begin, name).copy()
        qpos[:, scene.joint_qpos] += joints
        if scene.object_id is not None:
            at = scene.object_qpos
            qpos[:, at : at + 2] += shift
            qpos[:, at + 3 : at + 7] = multiply(turn, qpos[:, at + 3 : at + 7])
        moved[name] = qpos
    return Starts(**begin.arrays | moved)


def floor(
    replayer: Replayer,
    recs: Recordings,
    begin: Starts,
    plan: Layout,
    noise: Noise,
    rng: np.random.Generator,
    replicas: int = REPLICAS,
    world: EffectSet = (),
) -> Floor:
    """Return the floor of a set of recordings by null replays through the same observer.

    What a world cannot tell about itself depends on that world: a hand too weak to hold the object is less
    predictable than one that holds it. Hence `world`, the effects that are taken for true.

    Parameters
    ----------
    replayer : Replayer
    recs, begin, plan
        What was recorded, where it starts, how it is cut into blocks.
    noise : Noise
        That of its sensors.
    rng : numpy.random.Generator
        Noise of the nulls.
    replicas : int
        Null replays of each episode.
    world : tuple of EffectSetting
        Effects both in the null recordings and in their replays.
    """
    return spread(noise, plan, null_residuals(replayer, recs, begin, plan, noise, rng, replicas, world))


def null_residuals(
    replayer: Replayer,
    recs: Recordings,
    begin: Starts,
    plan: Layout,
    noise: Noise,
    rng: np.random.Generator,
    replicas: int = REPLICAS,
    world: EffectSet = (),
) -> Array:
    """Return the residuals `(R, E, B, D)` of null recordings under their replay; parameters as in `floor`."""
    nulls = null_recordings(replayer, recs, begin, noise, rng, replicas, world)
    from_null = starts(replayer.scene, nulls, np.tile(begin.moving, replicas))
    readings = replay(replayer, nulls, from_null, [world])[0]
    wide = replace(plan, phase=np.concatenate([plan.phase] * replicas))
    return residual(nulls, wide, readings).reshape(replicas, len(recs), *plan.phase.shape[1:], -1)


def spread(noise: Noise, plan: Layout, null: Array) -> Floor:
    """Return the floor of null residuals `(R, E, B, D)`; those outside the plan's phases do not count."""
    seen = np.where((plan.phase >= 0)[..., None], null, np.nan)
    least = smallest_spread(plan, noise)
    parts = min(PARTS, len(seen)) if len(seen) > 1 else 0
    without = [_sigma(plan, np.delete(seen, slice(p, None, parts), 0), least) for p in range(parts)]
    return Floor(_sigma(plan, seen, least), seen, np.array(without).reshape(parts, *seen.shape[1:]))


def smallest_spread(plan: Layout, noise: Noise) -> Array:
    """Return `(D,)` the smallest spread a block mean can have under the noise."""
    # Rounding of a reading that is still does not average out: step / sqrt(12) is the deviation of a uniform error.
    by_joint = np.hypot(noise.joint_position, np.sqrt(plan.rows / 12) * np.asarray(noise.joint_step))
    pose = {"position": noise.object_pose[0], "rotation": noise.object_pose[1]}
    force = max(noise.fingertip_force, noise.force_step / 3.5)
    joints = {"joint_position": by_joint, "joint_velocity": noise.joint_velocity, "joint_effort": noise.joint_effort}
    columns = {channel: [e for c, e, _ in plan.columns if c == channel] for channel in COLUMNS}
    sizes = {channel: np.broadcast_to(size, len(columns[channel])) for channel, size in joints.items()}
    sizes["object_pose"] = np.array([pose[e.split()[0]] for e in columns["object_pose"]])
    sizes["fingertip_force"] = np.full(len(columns["fingertip_force"]), force)
    return np.concatenate([sizes[channel] for channel in COLUMNS]) / np.sqrt(plan.rows)


def _sigma(plan: Layout, null: Array, least: Array) -> Array:
    """Return `(E, B, D)` spreads by episode and phase, never far below the pooled spread of the phase."""
    sigma = np.broadcast_to(np.maximum(least, 1e-9), null.shape[1:]).copy()
    for p in range(len(plan.phases)):
        here = plan.phase == p
        if not here.any():
            continue
        pooled = _quantile(null[:, here])
        for e in np.flatnonzero(here.any(1)):
            own = _quantile(null[:, e, here[e]])
            sigma[e, here[e]] = np.fmax(np.fmax(own, SPREAD_FLOOR * pooled), least)
    return sigma


def _quantile(values: Array) -> Array:
    """Return `(D,)` the 68 % quantile of the sizes over all but the last axis; NaN for a column without values."""
    flat = np.abs(values).reshape(-1, values.shape[-1])
    out = np.full(flat.shape[1], np.nan)
    finite = np.isfinite(flat)
    # Gaps cost ten times the time.
    for columns, read in ((finite.all(0), np.quantile), (finite.any(0) & ~finite.all(0), np.nanquantile)):
        if len(flat) and columns.any():
            out[columns] = read(flat[:, columns], 0.68, axis=0)
    return out
