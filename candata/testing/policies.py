"""What every policy keeps: it acts somewhere, repeats by its seed, and asks for no more than the actuators take."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from candata.policies import POLICIES, Plan, Policy
from candata.policies._contract import Planner
from candata.policies._drive import command_range
from candata.scenes import Scene, load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.testing._claims import registered_name, require, require_words


class PolicyConformance:
    """Conformance of one policy.

    Attributes
    ----------
    policy : Policy
        The constant of the plug-in.
    scenes : tuple of str or Path
        Scenes by name or path; the policy is asked about each, and must be able to act in one.
    duration_s : float
        Length of the plans.
    """

    policy: ClassVar[Policy]
    scenes: ClassVar[tuple[str | Path, ...]] = ("gripper_tabletop", "cube_toss", "xhand_tabletop")
    duration_s: ClassVar[float] = 1.0

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it does; variants each have words of their own."""
        require_words(POLICIES, self.policy)
        words = [variant.words for variant in self.policy.variants]
        require(all(words) and len(set(words)) == len(words), f"variants need words of their own: {words}")

    def test_it_can_act_in_one_of_the_scenes(self) -> None:
        """Else nothing below would say anything."""
        names = ", ".join(map(str, self.scenes))
        require(self._possible_scenes(), f"it can act in none of {names}: name another in `scenes`")

    def test_commands_lie_within_the_limits_of_the_actuators(self) -> None:
        """One row a control step, at most as many as were asked for; one column an actuator; all finite."""
        for scene in self._possible_scenes():
            rows, limits = round(self.duration_s * scene.file.rate_hz), command_range(scene)
            for plan in self._plans(scene, seed=1):
                shape, columns = plan.commands.shape, len(scene.actuator_ids)
                fits = 2 <= shape[0] <= rows and shape[1:] == (columns,)
                require(fits, f"scene {scene.name}: commands are {shape}, expected (2 to {rows}, {columns})")
                require(np.isfinite(plan.commands).all(), f"scene {scene.name}: commands are not finite")
                is_inside = (limits[:, 0] <= plan.commands) & (plan.commands <= limits[:, 1])
                require(is_inside.all(), f"scene {scene.name}: commands leave what the actuators take")
                state = (scene.model.nq,), (scene.model.nv,)
                require(
                    (plan.qpos.shape, plan.qvel.shape) == state, f"scene {scene.name}: the state is not (nq,), (nv,)"
                )
                require(np.isfinite(np.r_[plan.qpos, plan.qvel]).all(), f"scene {scene.name}: the state is not finite")

    def test_the_seed_decides_the_plan(self) -> None:
        """The same seed gives the same bits, another seed another motion or start."""
        for scene in self._possible_scenes():
            for plan, plan_again in zip(self._plans(scene, seed=1), self._plans(scene, seed=1), strict=True):
                require(_same_plan(plan, plan_again), f"scene {scene.name}: the same seed gives another plan")
            first_plan, second_plan = (_plan(self.policy.plan, scene, seed, self.duration_s) for seed in (1, 2))
            require(not _same_plan(first_plan, second_plan), f"scene {scene.name}: two seeds give the same plan")

    def test_the_simulation_plays_it_to_the_end(self) -> None:
        """An episode is what `candata generate-sim --policy` makes of it."""
        name = registered_name(POLICIES, self.policy)
        for scene in self._possible_scenes():
            (episode,) = make_episodes(scene, [EpisodeJob("played", 0, name, 1)], duration_s=self.duration_s)
            require(episode.meta.task == name, f"scene {scene.name}: the episode does not say what was played")

    def _plans(self, scene: Scene, seed: int) -> list[Plan]:
        """Return a plan of the policy and of each of its variants."""
        planners = [self.policy.plan, *(variant.plan for variant in self.policy.variants)]
        return [_plan(planner, scene, seed, self.duration_s) for planner in planners]

    def _possible_scenes(self) -> list[Scene]:
        """Return the scenes in which the policy can act."""
        return [scene for scene in map(load_scene, self.scenes) if self.policy.possible(scene)]


def _plan(planner: Planner, scene: Scene, seed: int, duration_s: float) -> Plan:
    """Return a plan made from a fresh generator."""
    return planner(scene, np.random.default_rng(seed), duration_s)


def _same_plan(plan: Plan, other_plan: Plan) -> bool:
    """Tell whether two plans hold the same bits."""
    pairs = (plan.commands, other_plan.commands), (plan.qpos, other_plan.qpos), (plan.qvel, other_plan.qvel)
    return all(np.array_equal(a, b) for a, b in pairs)
