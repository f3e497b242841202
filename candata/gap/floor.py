"""The floor: what the same comparison shows when nothing but sensor noise differs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from candata.gap.recordings import Recordings
from candata.gap.replay import Replayer, replay
from candata.gap.residuals import Layout, residual
from candata.gap.starts import Starts, starts
from candata.rotation import exp, multiply
from candata.schema.scene import Noise
from candata.simulate import rollout
from candata.simulate.episodes import add_noise

Array = NDArray[np.float64]
#: Null replays of each episode; `WORLDS` of them differ in their true start, each measured with fresh noise.
REPLICAS, WORLDS = 16, 4
#: Smallest noise that is believed where none is declared: resolution of good encoders [rad or m], motion
#: capture [m, rad] and tactile sensors [N].
SMALLEST = Noise(object_pose=(2e-4, 1e-3), joint_position=3e-4, fingertip_force=0.01)
#: Share of a column's typical spread below which no episode's own spread is believed.
SPREAD_FLOOR = 0.3

FloorKind = Literal["measured", "declared", "assumed"]


@dataclass(frozen=True)
class Floor:
    """Spread and loss of null replays.

    Attributes
    ----------
    kind : str
        declared (from the scene's `noise`) or assumed (from the recording's quiet stretches).
    sigma : (E, B, D) float64
        Spread of each residual: the 68 % quantile of its size over null replays, by episode, column and phase.
    null : (R, E, B, D) float64
        Residuals of the null replays.
    noise : Noise
        The noise with which they were made.
    """

    kind: FloorKind
    sigma: Array
    null: Array
    noise: Noise


def sensor_noise(scene_noise: Noise | None, recs: Recordings) -> tuple[FloorKind, Noise]:
    """Return the noise to use: the declared one, or one estimated from the recording."""
    if scene_noise is not None and _any(scene_noise):
        return "declared", scene_noise
    return "assumed", Noise(
        object_pose=(
            max(SMALLEST.object_pose[0], _high_pass(recs, "object_pose", slice(0, 3))),
            max(SMALLEST.object_pose[1], 2 * _high_pass(recs, "object_pose", slice(4, 7))),
        ),
        joint_position=max(SMALLEST.joint_position, _high_pass(recs, "joint_position", slice(None))),
        fingertip_force=max(SMALLEST.fingertip_force, _high_pass(recs, "fingertip_force", slice(None))),
    )


def _any(noise: Noise) -> bool:
    """Tell whether any noise is declared."""
    return max(*noise.object_pose, noise.joint_position, noise.fingertip_force, noise.force_step) > 0


def _high_pass(recs: Recordings, channel: str, columns: slice) -> float:
    """Return the noise of a channel (1 sd) from second differences in its quietest fifth.

    White noise of sd s has second differences of sd s sqrt(6); the median size of a normal is 0.6745 sd.
    """
    if channel not in recs.readings:
        return 0.0
    values = recs.readings[channel].reshape(*recs.readings[channel].shape[:2], -1)[..., columns]
    bend = np.abs(values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2])
    window = min(8, bend.shape[1])
    count = bend.shape[1] // window
    local = np.nanmedian(bend[:, : count * window].reshape(len(recs), count, window, -1), axis=2)
    local = local[np.isfinite(local)]
    return float(np.quantile(local, 0.2) / 0.6745 / np.sqrt(6)) if local.size else 0.0


def null_recordings(
    replayer: Replayer, recs: Recordings, begin: Starts, noise: Noise, rng: np.random.Generator,
    replicas: int = REPLICAS,
) -> Recordings:
    """Return R x E recordings of the nominal scene on the same commands, starting near the recorded starts."""
    worlds = min(WORLDS, replicas)
    qpos, qvel = _perturbed(replayer, begin, noise, worlds, rng)
    played = rollout(
        replayer.scene, np.concatenate([recs.commands] * worlds), qpos, qvel, [()] * len(qpos),
        instant_force=recs.instant_force, threads=replayer.threads,
    )
    replayer.count(len(qpos) * recs.commands.shape[1] * replayer.scene.substeps)
    copies = replicas // worlds
    index = np.tile(np.arange(len(recs)), worlds * copies)
    readings = {n: np.concatenate([v] * copies) for n, v in played.readings.items() if n in recs.readings}
    noisy = add_noise(readings, noise, rng)
    many = recs.take(index)
    for name, values in many.readings.items():
        noisy[name] = np.where(np.isfinite(values), noisy[name], np.nan)
    return replace(many, readings=noisy)


def _perturbed(
    replayer: Replayer, begin: Starts, noise: Noise, worlds: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return true starts that could have led to the recorded ones: a tenth of the noise off, as averages are."""
    qpos, qvel = np.concatenate([begin.qpos0] * worlds), np.concatenate([begin.qvel0] * worlds)
    scene = replayer.scene
    qpos[:, scene.joint_qpos] += 0.3 * noise.joint_position * rng.standard_normal((len(qpos), len(scene.joint_qpos)))
    if scene.object_id is not None:
        at = scene.object_qpos
        qpos[:, at : at + 2] += 0.3 * noise.object_pose[0] * rng.standard_normal((len(qpos), 2))
        turn = exp(0.3 * noise.object_pose[1] * rng.standard_normal((len(qpos), 3)))
        qpos[:, at + 3 : at + 7] = multiply(turn, qpos[:, at + 3 : at + 7])
    return qpos, qvel


def floor(
    replayer: Replayer, recs: Recordings, begin: Starts, plan: Layout, rng: np.random.Generator,
    replicas: int = REPLICAS,
) -> Floor:
    """Return the floor of a set of recordings by null replays through the same observer.

    Parameters
    ----------
    replayer : Replayer
    recs, begin, plan
        What was recorded, where it starts, how it is cut into blocks.
    rng : numpy.random.Generator
        Noise of the nulls.
    replicas : int
        Null replays of each episode.
    """
    kind, noise = sensor_noise(replayer.scene.file.noise, recs)
    nulls = null_recordings(replayer, recs, begin, noise, rng, replicas)
    readings = replay(replayer, nulls, starts(replayer.scene, nulls), [()])[0]
    wide = replace(plan, phase=np.concatenate([plan.phase] * replicas))
    null = residual(nulls, wide, readings).reshape(replicas, len(recs), *plan.phase.shape[1:], -1)
    return Floor(kind, _sigma(plan, null, smallest(plan, noise)), null, noise)


def smallest(plan: Layout, noise: Noise) -> Array:
    """Return `(D,)` the smallest spread a block mean can have under the noise."""
    table = {
        "joint_position": noise.joint_position, "fingertip_force": max(noise.fingertip_force, noise.force_step / 3.5),
    }
    pose = {"position": noise.object_pose[0], "rotation": noise.object_pose[1]}
    size = [table[c] if c in table else pose[e.split()[0]] for c, e, _ in plan.columns]
    return np.array(size) / np.sqrt(plan.rows)


def _sigma(plan: Layout, null: Array, least: Array) -> Array:
    """Return `(E, B, D)` spreads by episode and phase, never far below the pooled spread of the phase."""
    sigma = np.broadcast_to(np.maximum(least, 1e-9), null.shape[1:]).copy()
    for p in range(len(plan.phases)):
        here = plan.phase == p
        if not here.any():
            continue
        pooled = np.nanquantile(np.abs(null[:, here]), 0.68, axis=(0, 1))
        for e in np.flatnonzero(here.any(1)):
            own = np.nanquantile(np.abs(null[:, e, here[e]]), 0.68, axis=(0, 1))
            sigma[e, here[e]] = np.fmax(np.fmax(own, SPREAD_FLOOR * pooled), least)
    return sigma
