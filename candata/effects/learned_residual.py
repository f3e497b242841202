"""A stop-gap: forces that a diagnosis fitted where no effect of the library explains what was recorded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _residual_terms as dictionary
from candata.effects._contract import (
    Array,
    Effect,
    Elements,
    Forces,
    Hook,
    Parameter,
    always,
    constant_bounds,
    spans,
    values,
)
from candata.errors import UnknownNameError
from candata.scenes.assemble import Scene

#: Name of the element that is the object; the others are the joints.
OBJECT = "object"


class _Residual(NamedTuple):
    """Coefficients by joint `(n, J, K)` and of the object `(n, K, 6)`, wave numbers `(n, J)`, and what was before."""

    scene: Scene
    joint: Array
    object: Array
    waves: Array
    memory: dictionary.TermMemory | None


def element_names(scene: Scene) -> tuple[str, ...]:
    """Return what a residual force can act on: every joint, and the object."""
    return (*scene.file.joints, *([OBJECT] if scene.object_id is not None else []))


def _owners(scene: Scene) -> tuple[str, ...]:
    """Return the element of each coefficient."""
    joints = [j for j in scene.file.joints for _ in dictionary.JOINT_TERMS]
    return (*joints, *[OBJECT] * dictionary.sizes(scene)[1])


def _start(scene: Scene, x: Array, elements: Elements) -> _Residual:
    """Return the coefficients; of a named element only, where one is named."""
    count, joints = dictionary.sizes(scene)[0], len(scene.joint_ids)
    total = sum(dictionary.sizes(scene))
    acting = np.stack([_acts_on_element(scene, element) for element in elements])
    joint = np.where(acting[:, :count], x[:, :count], 0.0).reshape(len(x), joints, len(dictionary.JOINT_TERMS))
    object_coefficients = np.where(acting[:, count:], x[:, count:total], 0.0).reshape(
        len(x), (total - count) // dictionary.AXES, dictionary.AXES
    )
    return _Residual(scene, joint, object_coefficients, x[:, total:], None)


def _acts_on_element(scene: Scene, element: str | None) -> Array:
    """Return which coefficients act on `element`."""
    names = element_names(scene)
    if element is not None and element not in names:
        raise UnknownNameError("element", element, names)
    return np.array([element in (None, owner) for owner in _owners(scene)], bool)


def _apply(residual: _Residual, x: Forces) -> tuple[_Residual, Forces]:
    """Return the forces with the residual added."""
    scene = residual.scene
    memory, terms = dictionary.terms(scene, residual.memory, x, residual.waves)
    forces = x.added.copy()
    forces[:, scene.joint_dof] += (residual.joint * terms.joint).sum(2)
    if scene.object_id is not None:
        dof = scene.object_dof
        forces[:, dof : dof + dictionary.AXES] += (residual.object * terms.object).sum(1)
    return residual._replace(memory=memory), x._replace(added=forces)


EFFECT = Effect(
    about="a force that was fitted to recordings is added: a stop-gap until its cause is known",
    parameters=(
        Parameter(
            "coefficients",
            "1",
            constant_bounds(-1e4, 1e4),
            values(1.0),
            spans((0.0, 0.0)),
            "fitted by a diagnosis: N or N m for each unit of each term of the dictionary",
            always(0.0),
            size=lambda scene: sum(dictionary.sizes(scene)),
            owners=_owners,
        ),
        Parameter(
            "wave_number",
            "1",
            constant_bounds(0.0, 1e4),
            values(),
            spans((1.0, 1.0)),
            "fitted by a diagnosis: rad of the periodic terms for each rad or m of the joint",
            always(1.0),
            size=lambda scene: len(scene.file.joints),
            owners=lambda scene: scene.file.joints,
        ),
    ),
    acts_on="joint",
    possible=lambda scene: len(element_names(scene)) > 0,
    elements=element_names,
    force=Hook(_start, _apply),
    fitted=True,
)
