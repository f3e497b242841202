"""The numbers of a model that effects change, and the attributes of MJCF that hold them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Model array -> (kind of element, attribute) if the attribute is the number itself.
DIRECT_FIELDS = {
    "geom_friction": ("geom", "friction"),
    "geom_solref": ("geom", "solref"),
    "geom_solimp": ("geom", "solimp"),
    "geom_condim": ("geom", "condim"),
    "geom_priority": ("geom", "priority"),
    "pair_dim": ("pair", "condim"),
    "pair_friction": ("pair", "friction"),
    "pair_solref": ("pair", "solref"),
    "pair_solimp": ("pair", "solimp"),
    "dof_damping": ("joint", "damping"),
    "dof_frictionloss": ("joint", "frictionloss"),
    "dof_armature": ("joint", "armature"),
    "jnt_stiffness": ("joint", "stiffness"),
    "actuator_forcerange": ("actuator", "forcerange"),
}
#: Model arrays that take more than one attribute, or a computation.
GEOMETRY = ("geom_size", "geom_pos", "site_pos", "body_pos", "mesh_vert")
INERTIA = ("body_mass", "body_inertia", "body_ipos", "body_iquat")
SPRING = ("qpos_spring",)
SERVO = (
    *("actuator_gaintype", "actuator_gainprm", "actuator_biasprm", "actuator_dynprm"),
    *("actuator_forcelimited", "actuator_ctrlrange"),
)
FIELDS = (*DIRECT_FIELDS, *GEOMETRY, *INERTIA, *SPRING, *SERVO)
#: Options of the solver and of the world.
OPTIONS = ("gravity", "timestep", "cone", "impratio", "integrator")
#: Words of MJCF for the numbers of an option.
WORDS = {
    "cone": ("pyramidal", "elliptic"),
    "integrator": ("Euler", "RK4", "implicit", "implicitfast", "discrete"),
}


@dataclass(frozen=True)
class FieldDifference:
    """One model array in which two models differ, and where.

    Attributes
    ----------
    field : str
        Name of the array, or of the option.
    ids : tuple of int
        Rows that differ; `(0,)` for an option.
    """

    field: str
    ids: tuple[int, ...]


def joint_of(model: mujoco.MjModel, field: str, row: int) -> int:
    """Return the joint to which a row of an array of joints, or of their degrees of freedom, belongs."""
    return row if field.startswith("jnt_") else int(model.dof_jntid[row])


def read(model: mujoco.MjModel, field: str) -> Array:
    """Return one array (or option) of a model as rows of numbers, `(n, w)`."""
    values = getattr(model.opt, field) if field in OPTIONS else getattr(model, field)
    numbers = np.array(values, float)
    return numbers.reshape(
        1 if field in OPTIONS else len(numbers), int(np.prod(numbers.shape[0 if field in OPTIONS else 1 :]))
    )


def differences(first_model: mujoco.MjModel, second_model: mujoco.MjModel, rtol: float = 0.0) -> list[FieldDifference]:
    """Return the fields in which two models differ by more than `rtol`, of a row's largest number.

    Fields of another shape differ in every row.
    """
    out = []
    for field in (*FIELDS, *OPTIONS):
        first_values, second_values = read(first_model, field), read(second_model, field)
        if first_values.shape != second_values.shape:
            out.append(FieldDifference(field, tuple(range(max(len(first_values), len(second_values))))))
            continue
        size = np.maximum(np.abs(first_values), np.abs(second_values)).max(axis=1, initial=0.0)
        # A number that is zero but for rounding is compared with the largest number of its kind.
        size = size + 0.1 * size.max(initial=0.0)
        distance = np.abs(first_values - second_values).max(axis=1, initial=0.0)
        if field == "body_iquat":  # a quaternion and its negative are one rotation
            distance = np.minimum(distance, np.abs(first_values + second_values).max(axis=1, initial=0.0))
        rows = np.flatnonzero(distance > rtol * size)
        if len(rows):
            out.append(FieldDifference(field, tuple(rows.tolist())))
    return out


def words(numbers: Array | float) -> str:
    """Return numbers as an attribute, to twelve digits."""
    return " ".join(f"{v:.12g}" for v in np.atleast_1d(numbers))
