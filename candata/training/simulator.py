"""The simulator as a forecaster: from a window's past it starts MuJoCo and plays the planned commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.loaders import Windows
from candata.loaders.increments import increments
from candata.loaders.simulated import simulated_keys
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.schema.effect import EffectSetting
from candata.simulate import Observer, rollout
from candata.training.episode_scenes import EpisodeScenes, episode_scenes
from candata.training.forecasters import COMMANDS_PLANNED, Batch, ForecastArrays
from candata.training.rollout import Course, Loop, at_rows
from candata.training.window_starts import EARLIER_S, commands_from, window_starts

Array = NDArray[np.float64]
#: Windows stepped together: enough to hide the loop's overhead, few enough to stay in cache.
TOGETHER = 128
#: Share of the pose error removed each control step while something touches the object. A diagnosis takes a tenth of
#: it, as an observer hides what is wrong; a forecast wants to begin where the object is. Chosen of 0.006, 0.02, 0.06
#: and 0.15: the least error of forecasts in the true world, and nearly the least in the nominal one (grasps of a can).
POSE_GAIN = 0.06


@dataclass(frozen=True)
class SimulatedArrays:
    """What the simulator made of B windows.

    Attributes
    ----------
    object_pose : (B, H, 7) float64
        Poses as the scene's sensors report them; the last one where a window needs no more steps, and from where a
        simulation failed.
    joint_position : (B, H, J) float64
        Joints as the scene's sensors report them.
    contact : (B, H) float64
        1 where anything but the support touched the object in the control step before, else 0.
    steps : int
        Physics steps taken.
    """

    object_pose: Array
    joint_position: Array
    contact: Array
    steps: int


@dataclass(frozen=True, eq=False)
class Simulator:
    """Forecasts by simulating the scene of each episode, with the effects that belong to it.

    Attributes
    ----------
    windows : Windows
        Where the batches come from: its cache holds the commands at the episodes' own rate.
    scenes : EpisodeScenes
        What is simulated.
    summary : str
        Name for people.
    threads : int
        Threads of the stepping loop; results do not depend on it.
    """

    windows: Windows
    scenes: EpisodeScenes
    summary: str
    threads: int = 1

    def forecast(self, batch: Batch, seed: tuple[int, ...] = ()) -> ForecastArrays:
        """Return the simulated increments, one sample, and whether the hand touches; `seed` changes nothing."""
        simulated = self.simulate(batch)
        present = np.asarray(batch["history/object_pose"][:, -1:], np.float64)
        steps = increments(np.concatenate([present, simulated.object_pose], axis=1))
        return ForecastArrays(steps[None], simulated.contact)

    def free_run(self, course: Course) -> Loop:
        """Return one free simulation of each episode, from the row at which its loop begins to its end."""
        batch = at_rows(course.windows, course.episodes, np.zeros(len(course.episodes), np.int64))
        batch["history/object_pose"] = course.observed
        simulated = self._simulate(batch, course.steps, course.truth.shape[1])
        return Loop(simulated.object_pose, simulated.contact, simulated.joint_position)

    def simulate(self, batch: Batch) -> SimulatedArrays:
        """Return the simulated poses of a batch of the windows, and the contacts.

        Planned commands are the recorded ones, or those that the batch has as `COMMANDS_PLANNED`. The future is
        simulated up to the last step that the episode holds.
        """
        future = ~np.asarray(batch["future_pad"])
        steps = np.where(future.any(1), future.shape[1] - future[:, ::-1].argmax(1), 0)
        return self._simulate(batch, steps, future.shape[1])

    def keys(self, batch: Batch) -> dict[str, NDArray[np.float32]]:
        """Return what a model reads of the simulator: `simulated/object_pose`, `simulated/contact` of a batch."""
        simulated = self.simulate(batch)
        return simulated_keys(simulated.object_pose, simulated.contact)

    def _simulate(self, batch: Batch, steps: NDArray[np.int64], horizon: int) -> SimulatedArrays:
        """Return the simulated poses of `steps (B,)` model steps, up to the same number for all."""
        count = len(steps)
        object_pose, contact, taken = np.zeros((count, horizon, 7)), np.zeros((count, horizon)), 0
        joint_position = np.zeros((count, horizon, len(self.windows.joint_names)))
        history_rows = (~np.asarray(batch["history_pad"])).sum(1)
        turn = self.scenes.number[batch["episode"]]
        for number, scene in enumerate(self.scenes.scenes.values()):
            # Windows of about the same length together: a batch lasts as long as its longest.
            members = np.flatnonzero(turn == number)
            members = members[np.argsort((history_rows + steps)[members], kind="stable")]
            for first in range(0, len(members), TOGETHER):
                part = members[first : first + TOGETHER]
                played = self._play(scene, {name: values[part] for name, values in batch.items()}, steps[part], horizon)
                object_pose[part], contact[part] = played.object_pose, played.contact
                joint_position[part] = played.joint_position
                taken += played.steps
        return SimulatedArrays(object_pose, joint_position, contact, taken)

    def _play(self, scene: Scene, batch: Batch, steps: NDArray[np.int64], horizon: int) -> SimulatedArrays:
        """Return the simulated poses of windows that play in one scene together."""
        windows, episode = self.windows, batch["episode"]
        start = window_starts(windows, scene, batch)
        rows = (
            start.lead[:, None]
            + np.minimum(np.arange(1, horizon + 1), steps[:, None]) * windows.stride[episode][:, None]
        )
        count = int(rows.max()) + 1
        earlier = round(EARLIER_S * scene.file.rate_hz)
        played = rollout(
            scene,
            _commands(windows, batch, start.first_row, start.lead, count),
            start.qpos,
            start.qvel,
            [()] * len(steps),
            observer=None if is_toss(scene) else past_observer(scene, start.followed, count),
            earlier_commands=commands_from(windows, episode, start.first_row - earlier, earlier),
            threads=self.threads,
        )
        window = np.arange(len(steps))[:, None]
        readable_rows = np.minimum(rows, np.maximum(played.failed - 1, start.lead)[:, None])
        no_joints = np.zeros((*played.touch.shape, 0))
        return SimulatedArrays(
            played.readings["object_pose"][window, readable_rows],
            played.readings.get("joint_position", no_joints)[window, readable_rows],
            played.touch[window, readable_rows].astype(float),
            (count - 1) * scene.substeps * len(steps),
        )


def simulator(
    windows: Windows,
    scene: str | None,
    effects: tuple[EffectSetting, ...] = (),
    summary: str | None = None,
    threads: int = 1,
) -> Simulator:
    """Return the simulator of some windows.

    Parameters
    ----------
    windows : Windows
        Windows to forecast.
    scene : str or None
        What `load_scene` takes, or `SCENE+FOLDER` with a folder of object folders; None takes the scene that each
        episode names.
    effects : tuple of EffectSetting
        The repair: effects that act in every window.
    summary : str, optional
        Name for people.
    threads : int
        Threads of the stepping loop.

    Raises
    ------
    CandataError
        As `candata.training.episode_scenes.episode_scenes`.
    """
    usual = "the simulator with the effects given" if effects else "the simulator"
    return Simulator(windows, episode_scenes(windows, scene, effects), summary or usual, threads)


def _commands(
    windows: Windows, batch: Batch, first_row: NDArray[np.int64], lead: NDArray[np.int64], count: int
) -> Array:
    """Return commands `(n, count, A)` from the windows' starts on: recorded ones, from the present on planned."""
    recorded = commands_from(windows, batch["episode"], first_row, count)
    if COMMANDS_PLANNED not in batch:
        return recorded
    planned = np.asarray(batch[COMMANDS_PLANNED], np.float64)
    row = np.arange(count) - lead[:, None]
    window = np.arange(len(planned))[:, None]
    return np.where(row[..., None] < 0, recorded, planned[window, row.clip(0, planned.shape[1] - 1)])


def past_observer(scene: Scene, followed: dict[str, Array], count: int) -> Observer:
    """Return the observer of windows over `count` rows: it follows nothing behind the lead."""
    recorded = {
        name: np.concatenate([values, np.full((len(values), count - values.shape[1], values.shape[2]), np.nan)], axis=1)
        for name, values in followed.items()
    }
    joint_noise = np.asarray(scene.file.noise.joint_position) if scene.file.noise else 0.0
    return Observer(recorded, joint_noise=joint_noise, pose_gain=POSE_GAIN)
