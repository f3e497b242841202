"""Simulated worlds: the nominal scene, the repaired one, and stand-ins for the real one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candata.policies import Goal
from candata.policy_evaluation.contract import Array, Played, PlayedPolicy, RealStarts
from candata.policy_evaluation.pilots import closed_loop, held_commands
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.simulate import Trajectory, rollout
from candata.simulate.episodes import NOISE_STREAM, add_noise
from candata.simulate.outcome import object_motion, outcome
from candata.simulate.tracker import with_tracker


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """A scene with effects; see `candata.policy_evaluation.contract.World`.

    Attributes
    ----------
    name : str
        What it is called in tables.
    scene : Scene
        The nominal scene.
    effects : tuple of EffectSetting
        What acts in it.
    threads : int
        Threads of the stepping loop; results do not depend on it.
    """

    name: str
    scene: Scene
    effects: tuple[EffectSetting, ...] = ()
    threads: int = 1

    @property
    def summary(self) -> str:
        """What acts in it."""
        if not self.effects:
            return f"the scene {self.scene.name} as it is"
        return f"the scene {self.scene.name} with {', '.join(effect.name for effect in self.effects)}"

    def play(self, policy: PlayedPolicy, starts: RealStarts, seed: int, duration_s: float) -> Played:
        """Return what comes of a policy from all starts; policies see readings with the scene's sensor noise."""
        scene = self.scene
        orders = policy.orders(scene, starts, seed, duration_s)
        settle = round(orders.settle_s * scene.file.rate_hz)
        commands = held_commands(orders, settle)
        loop = closed_loop(
            scene,
            self.name,
            policy.name,
            orders,
            starts,
            settle,
            lambda place, readings: self._sensor_readings(seed, int(starts.numbers[place]), readings),
        )
        trajectory = rollout(
            scene,
            commands,
            starts.qpos,
            starts.qvel,
            [self.effects] * len(starts),
            closed_loop=loop,
            keep_state=True,
            settle=settle,
            threads=self.threads,
            memory=starts.memory,
        )
        if loop is not None:
            loop.check()
        part = slice(settle, None)
        at = scene.object_qpos
        return Played(
            tuple(
                None if goal is None else self._outcome(trajectory, i, part, goal)
                for i, goal in enumerate(orders.goals)
            ),
            trajectory.qpos[:, part, at : at + 7],
            trajectory.qpos[:, part][:, :, scene.joint_qpos],
            trajectory.touch[:, part].astype(float),
            commands[:, part],
            scene.file.rate_hz,
            None,
            trajectory.failed < commands.shape[1],
        )

    def _outcome(self, trajectory: Trajectory, index: int, part: slice, goal: Goal) -> str:
        """Return what became of the object in one simulation."""
        motion = object_motion(
            self.scene, trajectory.qpos[index, part], trajectory.touch[index, part], trajectory.tip_force[index, part]
        )
        return outcome(goal, motion)

    def _sensor_readings(self, seed: int, number: int, readings: dict[str, Array]) -> dict[str, Array]:
        """Return readings `(T, ...)` with the sensor noise of a start, the same in every simulated world."""
        noise = self.scene.file.noise
        rng = np.random.default_rng([seed, number, NOISE_STREAM])
        return with_tracker(add_noise(readings, noise, rng), noise, self.scene.file.rate_hz, rng)
