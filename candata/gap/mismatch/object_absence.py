"""Recordings that do not say where the object was: what it does to the hand is not compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.starts import starts
from candata.scenes.traits import is_toss
from candata.schema.contact import fingertip_contact

#: Time before and after a touch that is left out [s]: contact may be felt by links without sensors before a fingertip
#: feels it, and servos need a few of their time constants to forget it.
BEFORE_S, AFTER_S = 0.1, 0.3
NOTE = (
    "no object_pose: where the object was is not known; joints are compared away from contact only, forces not at all"
)


def without_object(replayer: Replayer, recs: Recordings) -> Recordings:
    """Return recordings whose joints are not compared near a touch, real or simulated, and whose forces are left out.

    Where the object's place was recorded, or the scene has none, they are returned as they are.
    """
    scene = replayer.scene
    if scene.object_id is None or "object_pose" in recs.readings or is_toss(scene):
        return recs
    touch = replay_all(replayer, recs, starts(scene, recs), [()])[0]["touch"] > 0
    if "fingertip_force" in recs.readings:
        touch |= np.stack([fingertip_contact(np.nan_to_num(f)) for f in recs.readings["fingertip_force"]]).any(2)
    rate = scene.file.rate_hz
    near = widened(touch, round(BEFORE_S * rate), round(AFTER_S * rate))
    readings = {n: v for n, v in recs.readings.items() if n != "fingertip_force"}
    if "joint_position" in readings:
        readings["joint_position"] = np.where(near[:, :, None], np.nan, readings["joint_position"])
    return replace(recs, readings=readings, notes=(*recs.notes, NOTE))


def widened(flags: NDArray[np.bool_], before: int, after: int) -> NDArray[np.bool_]:
    """Return `(E, T)` flags that begin `before` rows earlier and end `after` rows later."""
    out = flags.copy()
    for shift in range(1, before + 1):
        out[:, :-shift] |= flags[:, shift:]
    for shift in range(1, after + 1):
        out[:, shift:] |= flags[:, :-shift]
    return out
