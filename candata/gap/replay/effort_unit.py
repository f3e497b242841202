"""The unit of an effort that servos report as a current, a duty or a torque in a unit that nobody knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.data.velocity import joint_velocity
from candata.gap.replay.effort import effort_law
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.starts import starts

Array = NDArray[np.float64]
#: Share of the variance of a recorded effort that a line through the simulator's torque and speed must foretell for the
#: effort to count. Chosen: what foretells less tells nothing of the unit.
FORETOLD = 0.25
#: How many times the simulated torque an effort in N m may be, or the other way round, before its unit is not believed.
#: Chosen: a servo's gain is searched from 0.1 to 8, and mN m are off by 1,000.
MOST_TIMES = 20.0
#: Most episodes in which the unit of an effort is read. Chosen: three numbers a joint are known from far fewer.
LAW_EPISODES = 20


def with_effort_unit(
    replayer: Replayer, recs: Recordings, reference: Recordings | None = None
) -> tuple[Recordings, Recordings | None]:
    """Return recordings, and their reference, with an effort of unknown unit as torque [N m; N of slides].

    An effort in N m is taken as it is, unless it is more than `MOST_TIMES` off the simulated torque. Of another one the
    recorded effort e is taken as e = a tau + b w + c, tau the torque and w the speed of the nominal replay: a
    current has b = 0, a duty holds the back-EMF (V = R tau / K + K w). It is fitted to the reference where there is
    one, so that a change of size tells; else to the recordings, and then its size tells nothing. A joint whose effort
    does not follow the simulator's is not compared.

    Parameters
    ----------
    replayer : Replayer
    recs : Recordings
    reference : Recordings, optional
    """
    if "joint_effort" not in recs.readings:
        return recs, reference
    source = recs if reference is None else reference
    if "joint_effort" not in source.readings or source.unscaled_effort != recs.unscaled_effort:
        note = "joint_effort is not compared: the recordings and the reference hold it in different units, or not both"
        return _without_effort(replace(recs, notes=(*recs.notes, note))), reference
    law, times = _laws(replayer, source)
    wrong = [t for t in times if not 1 / MOST_TIMES <= t <= MOST_TIMES]
    if not recs.unscaled_effort and not wrong:
        return recs, reference
    why = f"is {wrong[0]:.2g} times the simulated torque: its unit is not believed" if wrong else ""
    lost = [name for name, row in zip(replayer.scene.file.joints, law, strict=True) if np.isnan(row).any()]
    note = _told("has no unit" if recs.unscaled_effort else why, lost, len(law), reference is not None)

    def converted(some: Recordings) -> Recordings:
        return _without_effort(some) if len(lost) == len(law) else _as_torque(some, law, replayer.scene.file.rate_hz)

    new = replace(converted(recs), notes=(*recs.notes, note), unscaled_effort=reference is None)
    return new, None if reference is None else replace(converted(reference), unscaled_effort=False)


def _laws(replayer: Replayer, source: Recordings) -> tuple[Array, list[float]]:
    """Return each joint's law `(J, 3)`, NaN where effort does not follow torque, and how many times a torque it is."""
    part = source.take(np.arange(len(source))[:LAW_EPISODES])
    played = replay_all(replayer, part, starts(replayer.scene, part), [()])[0]
    speed = joint_velocity(played["joint_position"], replayer.scene.file.rate_hz)
    effort, torque = part.readings["joint_effort"], played["joint_effort"]
    laws = [effort_law(effort[..., j], torque[..., j], speed[..., j]) for j in range(effort.shape[2])]
    followed = [weights for weights, share in laws if share >= FORETOLD]
    law = np.array([weights if share >= FORETOLD else np.full(3, np.nan) for weights, share in laws])
    return law, [abs(float(weights[0])) for weights in followed]


def _told(why: str, lost: list[str], count: int, has_reference: bool) -> str:
    """Return the note on an effort of unknown unit."""
    if len(lost) == count:
        return f"joint_effort {why}, and does not follow the simulator's torques: it is not compared"
    left_out = f"; that of {', '.join(lost)} does not follow the simulator's and is not compared" if lost else ""
    how = "its size is told by the reference" if has_reference else "its shape over time is compared, its size is not"
    return f"joint_effort {why}: {how}{left_out}"


def _without_effort(recs: Recordings) -> Recordings:
    """Return recordings without their effort."""
    return replace(recs, readings={n: v for n, v in recs.readings.items() if n != "joint_effort"})


def _as_torque(recs: Recordings, law: Array, rate_hz: float) -> Recordings:
    """Return recordings with the torque that a law `(J, 3)` reads from their effort and their own speed."""
    speed = joint_velocity(recs.readings["joint_position"], rate_hz)
    torque = (recs.readings["joint_effort"] - law[:, 2] - law[:, 1] * speed) / law[:, 0]
    return replace(recs, readings=recs.readings | {"joint_effort": torque})
