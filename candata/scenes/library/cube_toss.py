"""A cube thrown onto a plane; no actuators."""

from __future__ import annotations

import mujoco

from candata.scenes.contract import BuiltinScene
from candata.schema.scene import Noise, SceneFile

#: Side, mass, inertia, friction and rate of the acrylic cube of Pfrommer, Halm, Posa 2020 (arXiv
#: 2009.11193): 0.1048 m, 0.37 kg, 8.1e-4 kg m^2 (mass near the faces), 0.18, 148 Hz.
SIDE_M, MASS_KG, INERTIA_KGM2, FRICTION, RATE_HZ = 0.1048, 0.37, 8.1e-4, 0.18, 148.0
SUBSTEPS = 10


def build() -> mujoco.MjSpec:
    """Return a cube above a plane with MuJoCo's default contact (pyramidal cone)."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 1 / RATE_HZ / SUBSTEPS
    spec.worldbody.add_light(pos=(0.3, -0.6, 1.5), dir=(-0.1, 0.4, -1), castshadow=True)
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(1, 1, 0.1),
        friction=(FRICTION, 0.005, 0.0001),
        rgba=(0.82, 0.78, 0.72, 1),
    )
    cube = spec.worldbody.add_body(
        name="object", pos=(0, 0, 0.2), mass=MASS_KG, explicitinertial=True, ipos=(0, 0, 0), inertia=(INERTIA_KGM2,) * 3
    )
    cube.add_freejoint(name="object")
    cube.add_geom(
        name="object",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(SIDE_M / 2,) * 3,
        friction=(FRICTION, 0.005, 0.0001),
        rgba=(0.2, 0.55, 0.75, 1),
    )
    return spec


SCENE = BuiltinScene(
    file=SceneFile(
        model="builtin",
        rate_hz=RATE_HZ,
        object="object",
        support="table",
        noise=Noise(object_pose=(0.0005, 0.005)),
    ),
    build=build,
    policies=("toss",),
    about="a 0.105 m cube thrown onto a plane, no actuators",
)
