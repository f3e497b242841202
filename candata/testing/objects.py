"""What every object keeps: a scene can hold it, its surface and pieces agree, and it stays in its resting poses."""

from __future__ import annotations

from math import acos
from typing import ClassVar

import mujoco
import numpy as np

from candata.rotation import conjugate, rotate
from candata.scenes.contract import OBJECTS, SceneObject
from candata.scenes.model_file import compile_model
from candata.scenes.object_body import plane_scene
from candata.scenes.resting import with_drag
from candata.testing._claims import registered_name, require, require_words

_UP = np.array([0.0, 0.0, 1.0])


class ObjectConformance:
    """Conformance of one object that can be named.

    Attributes
    ----------
    object : SceneObject
        The constant of the plug-in.
    settle_s : float
        Time for which it is left in each of its poses [s].
    tilt_rad, height_m : float
        How far it may turn and sink meanwhile.
    """

    object: ClassVar[SceneObject]
    settle_s: ClassVar[float] = 1.0
    tilt_rad: ClassVar[float] = 0.1
    height_m: ClassVar[float] = 0.003

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, which is also that of its body."""
        require_words(OBJECTS, self.object)
        name = registered_name(OBJECTS, self.object)
        require(self.object.name == name, f"`name` is {self.object.name}, it is registered as {name}")

    def test_it_weighs_what_it_says(self) -> None:
        """The surface carries the whole mass; the pieces carry none."""
        mass = float(self._model().body_mass[1])
        require(np.isclose(mass, self.object.file.mass_kg), f"its body weighs {mass:g} kg")

    def test_its_inertia_is_one_that_a_body_can_have(self) -> None:
        """No principal moment exceeds the sum of the others (a solid's triangle inequality)."""
        moments = np.sort(self._model().body_inertia[1])
        require(moments[0] > 0, "a principal moment of inertia is not above 0")
        require(moments[2] <= moments[:2].sum() * (1 + 1e-9), "no solid has such moments of inertia")

    def test_its_poses_are_turns_with_the_tilt_that_they_say(self) -> None:
        """Shares of drops add up to one at most, quaternions are unit."""
        rests = self.object.file.rests
        require(sum(rest.probability for rest in rests) <= 1 + 1e-3, "probabilities add up to more than 1")
        for rest in rests:
            turn = np.array(rest.quaternion)
            require(abs(np.linalg.norm(turn) - 1) < 1e-6, f"{rest.quaternion} is no unit quaternion")
            cosine = float(rotate(turn, _UP)[2])
            tilt = acos(min(1.0, max(-1.0, cosine)))
            require(abs(tilt - rest.tilt_rad) < 1e-3, f"the tilt of {rest.quaternion} is {tilt:.3f} rad")

    def test_it_stays_in_each_of_its_poses(self) -> None:
        """Put there on a plane, it neither falls over nor jumps nor sinks."""
        model = with_drag(self._model())
        for rest in self.object.file.rests:
            data = mujoco.MjData(model)
            data.qpos[:] = (0, 0, rest.height_m, *rest.quaternion)
            mujoco.mj_step(model, data, nstep=round(self.settle_s / model.opt.timestep))
            ups = [rotate(conjugate(np.array(q)), _UP) for q in (rest.quaternion, data.qpos[3:])]
            turned = acos(min(1.0, float(ups[0] @ ups[1])))
            require(turned < self.tilt_rad, f"it falls from {rest.quaternion}: {turned:.2f} rad")
            moved = abs(float(data.qpos[2]) - rest.height_m)
            require(moved < self.height_m, f"from {rest.quaternion} it moves {moved:.4f} m up or down")

    def _model(self) -> mujoco.MjModel:
        """Return the object on a plane, compiled anew."""
        return compile_model(plane_scene(self.object), self.object.name)
