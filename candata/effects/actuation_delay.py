"""Commands act later than modelled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    always,
    constant_bounds,
    spans,
    values,
)
from candata.scenes.assemble import Scene

MAX_DELAY_S = 0.15


class _CommandHistory(NamedTuple):
    """Past commands `(n, H, A)` one a physics step, delays in steps `(n, A)`."""

    commands: Array | None
    steps: Array
    history: int


def _start(scene: Scene, x: Array, elements: Elements) -> _CommandHistory:
    """Return an empty line; delays of joints that are not driven hinges are zero."""
    step = scene.model.opt.timestep
    steps = np.zeros((len(x), len(scene.actuator_ids)))
    ids = scene.actuator_ids.tolist()
    for row, element in enumerate(elements):
        columns = [ids.index(a) for a in _select.servos(scene, element)]
        steps[row, columns] = x[row, 0] / step
    return _CommandHistory(None, steps, int(np.ceil(MAX_DELAY_S / step)) + 2)


def _apply(line: _CommandHistory, u: Array) -> tuple[_CommandHistory, Array]:
    """Return the delayed commands `(n, S, A)`: the mean over each physics step of the shifted hold.

    A delay that is no whole number of steps mixes two commands by the share of the step each covers, so the
    result is continuous in the delay.
    """
    n, count, width = u.shape
    earlier_commands = np.repeat(u[:, :1], line.history, axis=1) if line.commands is None else line.commands
    track = np.concatenate([earlier_commands, u], axis=1)
    whole_steps = np.floor(line.steps).astype(int)
    share = (line.steps - whole_steps)[:, None]
    at = line.history + np.arange(count)[None, :, None] - whole_steps[:, None, :]
    rows, columns = np.arange(n)[:, None, None], np.arange(width)[None, None, :]
    delayed_commands = (1 - share) * track[rows, at, columns] + share * track[rows, at - 1, columns]
    return line._replace(commands=track[:, -line.history :]), delayed_commands


EFFECT = Effect(
    about="commands reach the servos late",
    advice=Advice("Delay the commands of {servo} by {x}"),
    parameters=(
        Parameter(
            "delay_s",
            "s",
            constant_bounds(0.0, MAX_DELAY_S),
            values(0.006, 0.015, 0.03, 0.06),
            spans((0.008, 0.045)),
            "serial buses and drive firmware: 5 to 50 ms",
            always(0.0),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.servo_places,
    command=Hook(_start, _apply),
)
