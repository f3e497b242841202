"""Worlds in which command chunks are tried: a trained model, or a simulator with or without effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError
from candata.loaders import Normaliser
from candata.loaders.increments import integrate
from candata.loaders.normaliser import TAIL_STD
from candata.policies import Goal
from candata.policy_evaluation.chunk_starts import ChunkStarts
from candata.policy_evaluation.cost import ChunkCost, chunk_cost
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.simulate.outcome import object_motion, outcome
from candata.training.forecasters import Forecaster
from candata.training.rollout import CONTACT_THRESHOLD
from candata.training.simulator import simulator

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Distance from the training rows' centre up to which a value counts as seen, in standard deviations of the normaliser.
#: Source: the normaliser spans all but a thousandth of the training rows on each side by `TAIL_STD` of them; twice as
#: far out nothing like it was seen.
FAMILIAR_SDS = 2 * TAIL_STD
#: Channels by which a window is known or strange.
TOLD_BY = ("object_pose", "joint_position", "action")
#: Force that stands for a fingertip that presses, where only contact is known [N]; any above the contact threshold.
PRESSING_N = 1.0


class ChunkForecast(NamedTuple):
    """Poses `(M, S, N, T + 1, 7)` [m], the present ones first, and contact `(S, N, T)` or None, at `rate_hz`."""

    poses: Array
    contact: Array | None
    rate_hz: float

    def cost(self, goal: Goal) -> ChunkCost:
        """Return the costs `(M, S, N)` and whether the goal is reached."""
        return chunk_cost(goal, self.poses, self.contact, self.rate_hz)

    def succeeds(self, goal: Goal, scene: Scene) -> Flags:
        """Return `(S, N)` whether the outcome of a chunk's first sample is success, as for a simulated episode.

        A fingertip counts as pressing where anything but the support touches the object.
        """
        poses = self.poses[0]
        contact = np.zeros(poses.shape[:-2]) if self.contact is None else self.contact
        success = np.zeros(poses.shape[:2], bool)
        for s, n in np.ndindex(*success.shape):
            touch = np.r_[contact[s, n, 0], contact[s, n]] >= CONTACT_THRESHOLD
            qpos = np.zeros((len(touch), scene.model.nq))
            qpos[:, scene.object_qpos : scene.object_qpos + 7] = poses[s, n]
            force = PRESSING_N * np.repeat(touch[:, None], max(1, len(scene.force_sensors)), axis=1)
            motion = replace(object_motion(scene, qpos, touch, force), rate_hz=self.rate_hz)
            success[s, n] = outcome(goal, motion) == "success"
        return success


@dataclass(frozen=True, eq=False)
class ChunkWorld:
    """Forecasts what chunks do.

    Attributes
    ----------
    name : str
        Name for people.
    forecaster : Forecaster
        Who forecasts.
    starts : ChunkStarts
        Starts, at the forecaster's rate.
    normaliser : Normaliser or None
        What the forecaster was trained on; None for a simulator, to which nothing is strange.
    """

    name: str
    forecaster: Forecaster
    starts: ChunkStarts
    normaliser: Normaliser | None = None

    def forecast(self, commands: Array, seed: tuple[int, ...]) -> ChunkForecast:
        """Return the forecasts of chunks `(S, N, R, A)` at the episodes' own rate, all in one batch.

        Raises
        ------
        UsageError
            When a chunk is longer than what is forecast at once.
        """
        windows = self.starts.windows
        stride = int(windows.stride[windows.owner[0]])
        starts_count, candidates, rows = commands.shape[:3]
        if rows > windows.horizon * stride:
            raise UsageError(
                f"a chunk is longer than {self.name} can roll",
                expected=f"at most {windows.horizon / windows.rate_hz:g} s",
                found=f"{rows / (windows.rate_hz * stride):g} s",
                fix="shorten the chunk, or train a model with a longer --horizon",
            )
        steps = -(-rows // stride)
        batch = self.starts.batch(commands)
        made = self.forecaster.forecast(batch, seed)
        present = np.asarray(batch["history/object_pose"][:, -1], np.float64)
        increments = np.asarray(made.increments[:, :, :steps], np.float64)
        poses = integrate(np.broadcast_to(present, (len(increments), *present.shape)), increments)
        first = np.broadcast_to(present[None, :, None], (len(increments), len(present), 1, 7))
        poses = np.concatenate([first, poses], axis=2).reshape(len(increments), starts_count, candidates, steps + 1, 7)
        contact = None if made.contact is None else made.contact[:, :steps].reshape(starts_count, candidates, steps)
        return ChunkForecast(poses, contact, windows.rate_hz)

    def is_familiar(self, commands: Array) -> Flags:
        """Return `(S, N)`: start and commands of a chunk lie within what the forecaster was trained on.

        Each number of past poses, joints and commands and of the planned commands is told by itself.
        """
        shape = commands.shape[:2]
        if self.normaliser is None:
            return np.ones(shape, bool)
        batch = self.starts.batch(commands)
        familiar = np.ones(len(batch["episode"]), bool)
        for channel in TOLD_BY:
            if channel not in self.normaliser.channels:
                continue
            centre, scale = (x.ravel() for x in self.normaliser.channel(channel))
            columns = slice(0, 3) if channel == "object_pose" else slice(None)
            sds = FAMILIAR_SDS / (TAIL_STD if self.normaliser.clips else 1.0)
            for key in (f"history/{channel}", f"planned/{channel}"):
                if key in batch:
                    z = np.abs((batch[key][..., columns] - centre[columns]) / scale[columns])
                    familiar &= (z <= sds).all((1, 2))
        return familiar.reshape(shape)


def simulated_world(
    name: str, starts: ChunkStarts, rows: int, scene: str | None, effects: tuple[EffectSetting, ...], threads: int = 1
) -> ChunkWorld:
    """Return the world of a simulator, which plays chunks of `rows` rows at the episodes' own rate.

    Raises
    ------
    CandataError
        As `candata.training.simulator.simulator`.
    """
    native = starts.native(rows)
    return ChunkWorld(name, simulator(native.windows, scene, effects, name, threads), native)
