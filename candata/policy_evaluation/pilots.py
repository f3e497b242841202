"""Closed loops in any world: what a policy sees there, how long it may take, and what it asks for in vain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from candata.errors import DataError, Where
from candata.policies import Observation, Step, command_limits
from candata.policy_evaluation.contract import Array, Orders, RealStarts
from candata.scenes import Scene
from candata.schema.channels import CHANNELS
from candata.schema.contact import fingertip_contact
from candata.schema.episode import ContactRule
from candata.simulate.closed_loop import ClosedLoop, Pilot

#: Longest time that an evaluated policy may take for one control step [s]. Chosen: 160 times a step of an 80 Hz hand.
STEP_LIMIT_S = 2.0
#: What every world lets a policy see beside what its sensors read: 1 where the hand touches the object.
CONTACT = "contact"

Sense = Callable[[int, dict[str, Array]], Mapping[str, Array]]


def closed_loop(
    scene: Scene, world: str, policy: str, orders: Orders, starts: RealStarts, settle: int, sense: Sense
) -> ClosedLoop | None:
    """Return the closed loop of some orders; None where all commands are planned.

    Parameters
    ----------
    scene : Scene
        For limits and rate.
    world, policy : str
        Names, for errors.
    orders : Orders
        What is played.
    starts : RealStarts
        From where.
    settle : int
        Rows before row 0.
    sense : callable
        `(place, channels (T, ...)) -> channels (T, ...)`: as the sensors of a start's world read them.
    """
    if not any(orders.begins):
        return None
    rows = orders.commands.shape[1]
    no_noise = np.zeros((rows, len(scene.actuator_ids)))
    pilots = [
        None
        if begin is None
        else Pilot(
            f"{policy} from {start} in {world}",
            partial(checked_begin, begin, scene, policy, world),
            partial(sense, i),
            rows,
            no_noise,
        )
        for i, (begin, start) in enumerate(zip(orders.begins, starts.ids, strict=True))
    ]
    return ClosedLoop(pilots, settle, scene.file.rate_hz, command_limits(scene), STEP_LIMIT_S)


def checked_begin(begin: Callable[[], Step], scene: Scene, policy: str, world: str) -> Step:
    """Return a step that sees contact in every world, and says what a world lacks."""
    step = begin()

    def checked_step(observation: Observation) -> Array:
        readings = with_contact(observation.readings)
        try:
            return step(replace(observation, readings=readings))
        except KeyError as error:
            name = str(error.args[0]) if error.args else ""
            if name in readings or name not in CHANNELS:
                raise
            raise DataError(
                f"policy {policy} reads a channel that the world {world} lacks",
                expected=", ".join(readings),
                found=name,
                where=Where(path=scene.name, channel=name),
                fix="leave this policy out, or play it elsewhere",
            ) from None

    return checked_step


def with_contact(readings: Mapping[str, Array]) -> dict[str, Array]:
    """Return the readings of one row with `contact`, told by the fingertips' forces where no forecast gives it."""
    if CONTACT in readings or "fingertip_force" not in readings:
        return dict(readings)
    flags = fingertip_contact(readings["fingertip_force"][None], ContactRule().threshold_n)
    return {**readings, CONTACT: np.asarray(float(flags.any()))}


def held_commands(orders: Orders, settle: int) -> Array:
    """Return the commands `(n, settle + T, A)` with the first held before row 0."""
    return np.concatenate([np.repeat(orders.commands[:, :1], settle, axis=1), orders.commands], axis=1)
