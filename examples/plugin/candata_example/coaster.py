"""A round coaster of cork, 0.1 m wide and 8 mm thick; it falls flat from any attitude."""

from __future__ import annotations

from math import pi

from candata.scenes.contract import SceneObject
from candata.schema.object import ObjectFile, RestingPose, Shape

RADIUS_M, HALF_HEIGHT_M = 0.05, 0.004

OBJECT = SceneObject(
    ObjectFile(
        name="coaster",
        about="a round coaster of cork, 0.1 m wide, 15 g",
        mass_kg=0.015,
        visual=Shape(type="cylinder", size_m=(RADIUS_M, HALF_HEIGHT_M)),
        inertia="exact",
        rests=(
            RestingPose(quaternion=(1, 0, 0, 0), height_m=HALF_HEIGHT_M, probability=0.5, tilt_rad=0),
            RestingPose(quaternion=(0, 1, 0, 0), height_m=HALF_HEIGHT_M, probability=0.5, tilt_rad=pi),
        ),
    )
)
