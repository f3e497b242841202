"""What every scene keeps: it builds, its roles resolve, its policies can act, and left alone it comes to rest."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from candata.policies import policy
from candata.policies._drive import holding_commands
from candata.scenes import Scene, load_scene
from candata.scenes.contract import SCENES, BuiltinScene
from candata.scenes.roles import roles
from candata.simulate import at_rest, rollout
from candata.testing._claims import registered_name, require, require_words


class SceneConformance:
    """Conformance of one scene that can be named.

    Attributes
    ----------
    scene : BuiltinScene
        The constant of the plug-in.
    settle_s : float
        Time within which everything comes to rest [s].
    still_mps : float
        Speed of any degree of freedom at which it rests [m/s, rad/s].
    """

    scene: ClassVar[BuiltinScene]
    settle_s: ClassVar[float] = 3.0
    still_mps: ClassVar[float] = 0.01

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is."""
        require_words(SCENES, self.scene)

    def test_it_builds_the_same_each_time(self) -> None:
        """A scene is what its digest says: no chance and no clock is in it."""
        require(self._load().digest == self._load().digest, "two builds differ")

    def test_its_roles_resolve(self) -> None:
        """Joints, actuators, fingertips and object are parts of the model, and the noise is declared."""
        scene = self._load()
        scene_roles = roles(scene)
        require(len(scene_roles.joints) == len(scene.file.joints), "a joint is not in the model")
        require(scene.file.noise is not None, "`noise` is not declared: what a diagnosis calls its floor")
        unrecorded_actuators = {a for a in scene.file.actuator_names} - {joint.actuator for joint in scene_roles.joints}
        require(
            not unrecorded_actuators,
            f"actuators {', '.join(sorted(unrecorded_actuators))} move no joint that is recorded",
        )

    def test_its_policies_can_act(self) -> None:
        """`generate-sim` plays them by default."""
        scene = self._load()
        require(scene.policies, "`policies` is empty")
        unable = [name for name in scene.policies if not policy(name).possible(scene)]
        require(not unable, f"cannot act there: {', '.join(unable)}")

    def test_it_comes_to_rest(self) -> None:
        """Held where it begins, nothing drifts, jumps or falls for ever."""
        scene = self._load()
        qpos, qvel = at_rest(scene, 1)
        rest_command = holding_commands(scene, scene.model.actuator_length0[scene.actuator_ids])
        commands = np.repeat(rest_command[None, None], round(self.settle_s * scene.file.rate_hz), axis=1)
        trajectory = rollout(scene, commands, qpos, qvel, [()], keep_state=True)
        require(np.isfinite(trajectory.qpos).all(), "the simulation fails before it rests")
        fastest = float(np.abs(trajectory.qvel[0, -1]).max())
        require(fastest < self.still_mps, f"it still moves at {fastest:.2g} after {self.settle_s:g} s")

    def _load(self) -> Scene:
        """Return the scene, compiled anew."""
        return load_scene(registered_name(SCENES, self.scene))
