"""Records of `object.yaml`: an object that a scene may hold, as shapes, a mass and the poses in which it rests."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from candata.schema.record import Record
from candata.schema.scene import NonNegative, Positive

#: Convex pieces of an object. Chosen: contact is sought for every pair of pieces; the finest YCB objects have 8.
MOST_PIECES = 64
#: How many sizes each primitive has (MuJoCo XML reference, "geom/size").
SIZES = {"mesh": 0, "box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Share = Annotated[float, Field(ge=0, le=1)]


def is_object_name(name: str) -> bool:
    """Tell whether a text is one word of letters, digits, `_` and `-`: the name of an object, and no path."""
    return _NAME.fullmatch(name) is not None


def _one_word(name: str) -> str:
    """Return the name of an object."""
    if not is_object_name(name):
        raise ValueError("expected one word of letters, digits, _ and -")
    return name


def _inside(file: str) -> str:
    """Return the name of a file that lies in the object's own folder."""
    path = PurePosixPath(file)
    if path.is_absolute() or ".." in path.parts or "\\" in file or not path.name:
        raise ValueError("expected a file in the folder of the object")
    return file


class Shape(Record):
    """A convex primitive, or a mesh in a file of the object's folder [m].

    `size_m` is what MuJoCo calls the size of a geom: half extents, radius, or radius and half length. `position_m` and
    `quaternion` (w x y z) place the shape in the object's frame.
    """

    type: Literal["mesh", "box", "sphere", "cylinder", "capsule", "ellipsoid"]
    file: Annotated[str, AfterValidator(_inside)] | None = None
    size_m: tuple[Positive, ...] = ()
    position_m: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        """Refuse a mesh without a file, and a primitive with a file or with another number of sizes."""
        if (self.type == "mesh") != (self.file is not None):
            raise ValueError("a mesh has a file, a primitive has none")
        if len(self.size_m) != SIZES[self.type]:
            raise ValueError(f"size_m of a {self.type} has {SIZES[self.type]} numbers")
        return self


class RestingPose(Record):
    """A pose in which an object rests on a level plane, whatever its heading.

    `quaternion` (w x y z) turns the object's frame into the world's, `height_m` is that of its origin above the plane.
    `probability` is the share of random drops that ended there, `tilt_rad` the angle of the frame's z axis to the
    vertical: 0 where the object stands as its model does.
    """

    quaternion: Quaternion
    height_m: float
    probability: Share
    tilt_rad: NonNegative


class ObjectFile(Record):
    """`object.yaml`: what a scene needs to hold an object.

    `visual` is the surface that a camera sees; it carries the mass, spread evenly over the volume of the closed mesh
    (`inertia: exact`) or of its convex hull (`hull`). `pieces` are convex and touch other bodies; a primitive without
    pieces touches them itself.
    """

    name: Annotated[str, AfterValidator(_one_word)]
    about: str
    mass_kg: Positive
    visual: Shape
    pieces: tuple[Shape, ...] = Field(default=(), max_length=MOST_PIECES)
    inertia: Literal["exact", "hull"]
    rests: tuple[RestingPose, ...] = Field(min_length=1)
    origin: str | None = None
    licence: str | None = None

    @model_validator(mode="after")
    def _can_touch(self) -> Self:
        """Refuse a visual mesh without pieces: MuJoCo would let its convex hull touch, unasked."""
        if self.visual.type == "mesh" and not self.pieces:
            raise ValueError("a visual mesh needs convex pieces")
        return self

    @property
    def upright(self) -> RestingPose:
        """The resting pose with the least tilt."""
        return min(self.rests, key=lambda rest: rest.tilt_rad)


class ObjectList(Record):
    """`objects.yaml`: objects that take turns in a set; names of folders in `folder`, which is named from the file."""

    folder: str = "."
    objects: tuple[Annotated[str, AfterValidator(_one_word)], ...] = Field(min_length=1)
