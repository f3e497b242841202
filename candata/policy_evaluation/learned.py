"""Learned worlds: a trained model forecasts the object and the contact, a servo lag or the simulator the joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.loaders import Windows
from candata.loaders.increments import integrate
from candata.policy_evaluation.contract import Array, Orders, Played, PlayedPolicy, RealStarts
from candata.policy_evaluation.imagined import ImaginedEpisodes, imagined_episodes
from candata.policy_evaluation.pilots import CONTACT, closed_loop, held_commands
from candata.policy_evaluation.simulated import SimulatedWorld
from candata.scenes import Scene
from candata.simulate.closed_loop import ClosedLoop
from candata.simulate.outcome import ObjectMotion, object_motion, outcome
from candata.training.episode_scenes import EpisodeScenes
from candata.training.forecasters import NOISE_NUMBERS, TrainedModel
from candata.training.poses import mean_pose
from candata.training.rollout import CONTACT_THRESHOLD
from candata.training.servo_lag import ServoLags
from candata.training.simulator import Simulator

JointsFrom = Literal["servo", "simulator"]
#: What policies see in a learned world, beside the contact that the model forecasts.
SEEN_CHANNELS: tuple[str, ...] = ("object_pose", "joint_position")
#: Channels that a learned world can make of its own forecasts, of commands and of servos.
MADE_CHANNELS = ("object_pose", "joint_position", "action", "contact")


def check_joints(joints: str) -> None:
    """Refuse an origin of joints that is not known.

    Raises
    ------
    UnknownNameError
        When it is not.
    """
    if joints not in get_args(JointsFrom):
        raise UnknownNameError("origin of joints", joints, get_args(JointsFrom))


@dataclass(frozen=True, eq=False)
class LearnedWorld:
    """A trained model as a world; see `candata.policy_evaluation.contract.World`.

    A planned policy's commands are known to the model as far as its horizon. A policy in a closed loop is asked row by
    row. Every model step is forecast anew, after the policy was asked at its first row: that command holds for the
    horizon.

    Attributes
    ----------
    name : str
        What it is called in tables.
    scene : Scene
        The nominal scene: for limits, rate, and the surface of the object.
    forecaster : TrainedModel
        Who forecasts.
    windows : Windows
        As the model reads the recordings.
    lags : ServoLags
        How joints follow their commands.
    execute : int
        Model steps executed of each forecast, where the commands are planned.
    joints : str
        `servo`, or `simulator`: of planned commands, those of the nominal simulation.
    """

    name: str
    scene: Scene
    forecaster: TrainedModel
    windows: Windows
    lags: ServoLags
    execute: int
    joints: JointsFrom = "servo"

    def __post_init__(self) -> None:
        """Refuse a model that reads what no forecast gives, or steps that the rows do not fit."""
        check_joints(self.joints)
        lacking_channels = [name for name in self.windows.channels if name not in MADE_CHANNELS]
        if lacking_channels or "action" not in self.windows.channels:
            raise UsageError(
                f"{self.name} cannot be a world",
                expected=f"a model that reads actions, and nothing but {', '.join(MADE_CHANNELS)}",
                found=f"it reads {', '.join(self.windows.channels)}",
                fix="evaluate policies in a model without these inputs",
            )
        own_names = (self.scene.file.joints, self.scene.file.actuator_names)
        if (self.windows.joint_names, self.windows.actuator_names) != own_names:
            raise UsageError(
                f"{self.name} was trained on another hand",
                expected=f"joints and actuators of scene {self.scene.name}: {', '.join(own_names[0])}",
                found=", ".join(self.windows.joint_names),
            )
        stride = self.scene.file.rate_hz / self.windows.rate_hz
        if round(stride) < 1 or abs(stride - round(stride)) > 1e-6 * stride:
            raise UsageError(
                f"the steps of {self.name} do not fit the scene",
                expected=f"a rate that divides {self.scene.file.rate_hz:g} Hz",
                found=f"{self.windows.rate_hz:g} Hz",
            )

    @property
    def summary(self) -> str:
        """Who forecasts, and what moves the joints."""
        moved_joints, count = len(self.lags.joints), len(self.windows.joint_names)
        words = (
            "joints by a servo lag"
            if moved_joints == count
            else f"{moved_joints} of {count} joints by a servo lag, others still"
        )
        if self.joints == "simulator":
            words = f"joints of planned policies by the nominal simulator, else {words}"
        return f"{self.forecaster.summary}; {words}; contact as forecast"

    def play(self, policy: PlayedPolicy, starts: RealStarts, seed: int, duration_s: float) -> Played:
        """Return what comes of a policy from all starts.

        Raises
        ------
        DataError
            When the policy fails, or a start is of no episode that the model's windows hold.
        UsageError
            When a goal is told by contact, and the model forecasts none.
        """
        orders = policy.orders(self.scene, starts, seed, duration_s)
        settle = round(orders.settle_s * self.scene.file.rate_hz)
        joints = self._planned_joints(policy, orders, starts, seed, duration_s, settle)
        episode_rows = self._begun_episodes(orders, starts, joints, settle)
        rows, stride = orders.commands.shape[1], episode_rows.stride
        loop = closed_loop(self.scene, self.name, policy.name, orders, starts, 0, lambda _place, readings: readings)
        execute = self.execute if loop is None else 1
        commands, contact = orders.commands.copy(), np.zeros((len(starts), rows))
        forecaster, spread, count = self._forecaster(episode_rows, starts), np.zeros(len(starts)), 0
        for step in range(0, -(-rows // stride), execute):
            if loop is not None:
                self._act(loop, episode_rows, range(step * stride, step * stride + 1), commands, contact)
            batch = episode_rows.batch(step) | {NOISE_NUMBERS: starts.numbers}
            forecast = forecaster.forecast(batch, (seed, step))
            steps = integrate(episode_rows.poses(step), forecast.increments[:, :, :execute])
            for k in range(execute):
                chance = None if forecast.contact is None else forecast.contact[:, k]
                episode_rows.write_step(step + k + 1, mean_pose(steps[:, :, k]), chance)
                changed_row = (step + k) * stride + 1
                contact[:, changed_row : changed_row + stride] = np.nan if chance is None else chance[:, None]
                spread += np.linalg.norm(steps[:, :, k, :3] - steps[:, :, k, :3].mean(0), axis=-1).mean(0)
                count += 1
            if loop is not None:
                between = range(step * stride + 1, min((step + 1) * stride, rows))
                self._act(loop, episode_rows, between, commands, contact)
        if loop is not None:
            loop.check()
        if np.isnan(contact).any():
            self._refuse_goals_of_contact(orders)
        part = slice(episode_rows.first_row, episode_rows.first_row + rows)
        poses = episode_rows.rows["object_pose"][:, part].astype(np.float64)
        moved_joints = self._joint_rows(episode_rows, part, starts)
        return Played(
            tuple(
                None if goal is None else outcome(goal, self._motion(poses[i], contact[i]))
                for i, goal in enumerate(orders.goals)
            ),
            poses,
            moved_joints,
            contact,
            commands,
            self.scene.file.rate_hz,
            spread / max(count, 1) if forecaster.samples > 1 else None,
            np.zeros(len(starts), bool),
        )

    def _refuse_goals_of_contact(self, orders: Orders) -> None:
        """Refuse goals that are reached only while the hand touches, where no contact is forecast."""
        if any(goal is not None and (goal.turn_rad > 0 or goal.slip) for goal in orders.goals):
            raise UsageError(
                f"{self.name} forecasts no contact, without which no turn in the hand and no slip is a success",
                expected="goals that poses alone tell: a lift, a place or a topple",
                found="a turn" if any(goal is not None and goal.turn_rad > 0 for goal in orders.goals) else "a slip",
                fix="leave this world out, or the policies that mean so",
            )

    def _motion(self, poses: Array, contact: Array) -> ObjectMotion:
        """Return the motion that an outcome is told from; contact stands for the press of every fingertip."""
        touch = contact >= CONTACT_THRESHOLD
        qpos = np.zeros((len(poses), self.scene.model.nq))
        at = self.scene.object_qpos
        qpos[:, at : at + 7] = poses
        tips = np.zeros((len(poses), max(1, len(self.scene.file.fingertips))))
        return replace(
            object_motion(self.scene, qpos, touch, tips), tips=np.repeat(touch[:, None], tips.shape[1], axis=1)
        )

    def _episodes(self, starts: RealStarts) -> NDArray[np.int64]:
        """Return the number of each start's episode among those of the windows."""
        number = {name: k for k, name in enumerate(self.windows.episode_ids)}
        unknown_id = next((name for name in starts.ids if name not in number), None)
        if unknown_id is not None:
            raise DataError("a start is of another data set than the model reads", where=Where(episode=unknown_id))
        return np.array([number[name] for name in starts.ids], np.int64)

    def _planned_joints(
        self, policy: PlayedPolicy, orders: Orders, starts: RealStarts, seed: int, duration_s: float, settle: int
    ) -> Array:
        """Return the joints `(n, settle + T, J)` that follow the planned commands."""
        start = starts.qpos[:, self.scene.joint_qpos]
        commands = held_commands(orders, settle)
        joints = np.repeat(start[:, None], commands.shape[1], axis=1)
        for i in range(len(starts)):
            follows = self.lags.follow(start[i, self.lags.joints], commands[i, :-1], self.scene.file.rate_hz)
            joints[i, 1:, self.lags.joints] = follows.T
        if self.joints == "simulator" and not any(orders.begins):
            nominal_play = SimulatedWorld("nominal", self.scene).play(policy, starts, seed, duration_s)
            joints[:, settle:] = nominal_play.joint_position
            joints[:, :settle] = nominal_play.joint_position[:, :1]
        return joints

    def _begun_episodes(self, orders: Orders, starts: RealStarts, joints: Array, settle: int) -> ImaginedEpisodes:
        """Return the episodes with their past at rest, the commands that are planned, and the joints that follow."""
        at, rows = self.scene.object_qpos, orders.commands.shape[1]
        stride = round(self.scene.file.rate_hz / self.windows.rate_hz)
        lead = (self.windows.history - 1) * stride
        kept_rows = np.maximum(np.arange(settle - lead, settle + 1), 0)
        past_rows = {
            "object_pose": np.repeat(starts.qpos[:, None, at : at + 7], lead + 1, axis=1),
            "joint_position": joints[:, kept_rows],
            "action": np.repeat(orders.commands[:, :1], lead + 1, axis=1),
        }
        episode_rows = imagined_episodes(self.windows, self._episodes(starts), past_rows, rows)
        part = slice(lead, lead + rows)
        episode_rows.rows["action"][:, part], episode_rows.rows["action"][:, part.stop :] = (
            orders.commands,
            orders.commands[:, -1:],
        )
        if "joint_position" in (episode_rows.rows.dtype.names or ()):
            episode_rows.rows["joint_position"][:, part] = joints[:, settle:]
            episode_rows.rows["joint_position"][:, part.stop :] = joints[:, -1:]
        return episode_rows

    def _forecaster(self, episode_rows: ImaginedEpisodes, starts: RealStarts) -> TrainedModel:
        """Return the model; one that reads a simulator reads it over the episodes that are made."""
        simulator = self.forecaster.simulator
        if not isinstance(simulator, Simulator):
            return self.forecaster
        scenes = EpisodeScenes(simulator.scenes.scenes, simulator.scenes.number[self._episodes(starts)])
        return replace(self.forecaster, simulator=replace(simulator, windows=episode_rows.windows, scenes=scenes))

    def _act(
        self, loop: ClosedLoop, episode_rows: ImaginedEpisodes, rows: range, commands: Array, contact: Array
    ) -> None:
        """Let policies act at some rows: they see the forecast, and joints follow row by row."""
        for row in rows:
            place = episode_rows.first_row + row
            readings = {
                name: episode_rows.rows[name][:, place].astype(np.float64)
                for name in SEEN_CHANNELS
                if name in (episode_rows.rows.dtype.names or ())
            }
            if np.isfinite(contact[:, row]).all():
                readings[CONTACT] = contact[:, row]
            loop.set_commands(row, readings, commands)
            episode_rows.rows["action"][:, place:] = commands[:, row, None]
            if "joint_position" in readings:
                self._follow(episode_rows, place, commands[:, row])

    def _follow(self, episode_rows: ImaginedEpisodes, place: int, commands: Array) -> None:
        """Write the joints of the row after `place`, and hold them behind it."""
        lags = self.lags
        decay = np.exp(-1 / (self.scene.file.rate_hz * lags.time_constant_s))
        joints = episode_rows.rows["joint_position"][:, place].copy()
        target = lags.gain * commands[:, lags.actuators] + lags.offset
        joints[:, lags.joints] = decay * joints[:, lags.joints] + (1 - decay) * target
        episode_rows.rows["joint_position"][:, place + 1 :] = joints[:, None]

    def _joint_rows(self, episode_rows: ImaginedEpisodes, part: slice, starts: RealStarts) -> Array:
        """Return the joints `(n, T, J)`; those of the start where the model reads none."""
        if "joint_position" in (episode_rows.rows.dtype.names or ()):
            return episode_rows.rows["joint_position"][:, part].astype(np.float64)
        start = starts.qpos[:, self.scene.joint_qpos]
        return np.repeat(start[:, None], part.stop - part.start, axis=1)
