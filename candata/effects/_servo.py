"""Servos whose answer to a position error is no straight line: what their effects share."""

from __future__ import annotations

import numpy as np

from candata.effects import _select
from candata.effects._contract import Array, Elements
from candata.scenes.assemble import Scene
from candata.scenes.motors import affine_law


def has_law(scene: Scene) -> bool:
    """Tell whether every drive of the fingers follows a position, of all that effects of servos act on."""
    ids = _select.actuators(scene, None) if _select.has_drives(scene) else np.zeros(0, int)
    gain, bias = affine_law(scene.model, ids)
    return len(ids) > 0 and bool(((gain > 0) & (bias[:, 1] < 0)).all())


def in_commands(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return errors `(n, A)` in units of the commands: of x `(n,)` [rad, or m] where an element acts, else zero."""
    errors = np.zeros((len(x), len(scene.actuator_ids)))
    ids = scene.actuator_ids.tolist()
    for row, element in enumerate(elements):
        for a in _select.actuators(scene, element).tolist():
            errors[row, ids.index(a)] = x[row] * _select.command_per_rad(scene, a)
    return errors
