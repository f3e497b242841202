"""An upright can of tin, the object of `xhand_tabletop`; all numbers are our own."""

from __future__ import annotations

from math import pi, sqrt

from candata.scenes.contract import SceneObject
from candata.schema.object import ObjectFile, RestingPose, Shape

RADIUS_M, HALF_HEIGHT_M, MASS_KG = 0.030, 0.060, 0.25
#: Shares of random drops that ended on a base, and on the side (`candata.scenes.resting`).
ON_ONE_BASE, ON_ITS_SIDE = 0.05, 0.9

OBJECT = SceneObject(
    file=ObjectFile(
        name="can",
        about="a can of tin, 0.06 m wide and 0.12 m high, 0.25 kg",
        mass_kg=MASS_KG,
        visual=Shape(type="cylinder", size_m=(RADIUS_M, HALF_HEIGHT_M)),
        inertia="exact",
        rests=(
            RestingPose(
                quaternion=(sqrt(0.5), sqrt(0.5), 0.0, 0.0),
                height_m=RADIUS_M,
                probability=ON_ITS_SIDE,
                tilt_rad=pi / 2,
            ),
            RestingPose(quaternion=(1.0, 0.0, 0.0, 0.0), height_m=HALF_HEIGHT_M, probability=ON_ONE_BASE, tilt_rad=0.0),
            RestingPose(quaternion=(0.0, 1.0, 0.0, 0.0), height_m=HALF_HEIGHT_M, probability=ON_ONE_BASE, tilt_rad=pi),
        ),
    ),
)
