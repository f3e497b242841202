"""The unit of an effort that servos report as a current, a duty or a torque in a unit that nobody knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.effort import effort_law
from candata.gap.recordings import Recordings
from candata.gap.replay import Replayer, replay_all
from candata.gap.starts import starts
from candata.gap.velocity import joint_velocity

Array = NDArray[np.float64]
#: Share of the variance of a recorded effort that a line through the simulator's torque and speed must foretell for the
#: effort to count. Chosen: what foretells less tells nothing of the unit.
FORETOLD = 0.25
#: Most episodes in which the unit of an effort is read. Chosen: three numbers a joint are known from far fewer.
LAW_EPISODES = 20


def with_effort_unit(
    replayer: Replayer, recs: Recordings, reference: Recordings | None = None
) -> tuple[Recordings, Recordings | None]:
    """Return recordings, and their reference, with an effort of unknown unit as torque [N m; N of slides].

    The recorded effort e is taken as e = a tau + b w + c, tau the torque and w the speed of the nominal replay: a
    current has b = 0, a duty holds the back-EMF (V = R tau / K + K w). It is fitted to the reference where there is
    one, so that a change of size tells; else to the recordings, and then its size tells nothing. A joint whose effort
    does not follow the simulator's is not compared.

    Parameters
    ----------
    replayer : Replayer
    recs : Recordings
    reference : Recordings, optional
    """
    if "joint_effort" not in recs.readings or not recs.unscaled_effort:
        return recs, reference
    source = recs if reference is None else reference
    if "joint_effort" not in source.readings:
        return without_channel(recs, "joint_effort"), reference
    part = source.take(np.arange(len(source))[:LAW_EPISODES])
    begin = starts(replayer.scene, part)
    played = replay_all(replayer, part, begin, [()])[0]
    rate_hz = replayer.scene.file.rate_hz
    laws = [
        effort_law(part.readings["joint_effort"][..., j], played["joint_effort"][..., j], speed)
        for j, speed in enumerate(np.moveaxis(joint_velocity(played["joint_position"], rate_hz), -1, 0))
    ]
    law = np.array([weights if share >= FORETOLD else np.full(3, np.nan) for weights, share in laws])
    lost = [name for name, row in zip(replayer.scene.file.joints, law, strict=True) if np.isnan(row).any()]
    notes = (*recs.notes, _told(lost, len(law), reference is not None))
    changed = [_as_torque(r, law, rate_hz) for r in (recs, *((reference,) if reference is not None else ()))]
    changed = [without_channel(r, "joint_effort") if len(lost) == len(law) else r for r in changed]
    first = replace(changed[0], notes=notes, unscaled_effort=reference is None)
    return first, replace(changed[1], unscaled_effort=False) if reference is not None else None


def _told(lost: list[str], count: int, has_reference: bool) -> str:
    """Return the note on an effort of unknown unit."""
    if len(lost) == count:
        return "joint_effort has no unit and does not follow the simulator's torques: it is not compared"
    left_out = f"; that of {', '.join(lost)} does not follow the simulator's and is not compared" if lost else ""
    how = "its size is told by the reference" if has_reference else "its shape over time is compared, its size is not"
    return f"joint_effort has no unit: {how}{left_out}"


def without_channel(recs: Recordings, channel: str) -> Recordings:
    """Return recordings without a channel."""
    return replace(recs, readings={n: v for n, v in recs.readings.items() if n != channel})


def _as_torque(recs: Recordings, law: Array, rate_hz: float) -> Recordings:
    """Return recordings with the torque that a law `(J, 3)` reads from their effort and their own speed."""
    speed = joint_velocity(recs.readings["joint_position"], rate_hz)
    torque = (recs.readings["joint_effort"] - law[:, 2] - law[:, 1] * speed) / law[:, 0]
    return replace(recs, readings=recs.readings | {"joint_effort": torque})
