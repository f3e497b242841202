"""Joints, commands and poses far outside what the scene allows, in all episodes or in some: another unit or zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.lag import at_best, lag_moments
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.bounds import ROWS, Beyond, commands_beyond, joints_beyond
from candata.gap.mismatch.commands import UNIT_WITHIN, Paired
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.swaps import AT_LEAST, in_episodes
from candata.scenes import Scene
from candata.units import TO_SI

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Share of a joint's range by which values brought to another unit may still lie beyond it. Chosen.
SLACK = 0.25
#: Share of the episodes in which it must be seen to be sure, beside `AT_LEAST`; in fewer it is a note. Chosen.
SHARE = 0.05
#: Share of its squared correlation with any command that a joint's with its own must reach to be its own. Chosen.
STEADY = 0.9
#: Units in words.
WORDS = {
    "deg": "degrees",
    "mrad": "milliradians",
    "cm": "centimetres",
    "mm": "millimetres",
    "deg/s": "degrees a second",
    "mm/s": "millimetres a second",
    "mN m": "thousandths of a newton metre",
}


@dataclass(frozen=True)
class _Following:
    """How recorded joints follow commands in some episodes.

    Attributes
    ----------
    servos : (S,) bool
        Servos whose column of the channel lies far outside.
    steady : (S,) bool
        Whether a joint follows its own command about as closely as any other.
    slope : (S,) float64
        By how much a joint moves when its command moves by 1.
    """

    servos: Mask
    steady: Mask
    slope: Array


def range_findings(scene: Scene, recs: Recordings, pairs: Paired | None) -> list[RecordingMismatch]:
    """Return joints and commands that lie far outside their ranges, with the unit that would bring them back.

    Nothing where joints follow another command than their own: then it is the order that is wrong.

    Parameters
    ----------
    pairs : Paired, optional
        The same recordings, joints beside the commands of their servos.
    """
    channels = [b for b in (joints_beyond(scene, recs), commands_beyond(scene, recs)) if b is not None]
    episodes: dict[str, Mask] = {b.channel: np.asarray(b.far.any(1)) for b in channels}
    out = []
    for b in channels:
        some = episodes[b.channel]
        alone = not any((some & e).any() for name, e in episodes.items() if name != b.channel)
        follows = None if pairs is None or not some.any() else _following(b, pairs, some)
        if follows is None or 2 * follows.steady[follows.servos].sum() >= follows.servos.sum():
            out += [_outside(b.of(kind), recs, follows, alone) for kind in b.kinds]
    return out


def _following(b: Beyond, p: Paired, episodes: Mask) -> _Following:
    """Return how joints follow commands in some episodes."""
    found = lag_moments(p.joint[episodes], p.target[episodes], p.moments.lags)
    r2 = np.abs(found.r2())
    best = r2.argmax(0)
    each = at_best(r2, best)
    columns = p.drive.joints if b.channel == "joint_position" else p.drive.columns
    far = np.asarray(b.far[episodes].any(0))[columns]
    return _Following(far, np.diag(each) >= STEADY * each.max(1), np.diag(at_best(found.slope(), best)))


def _outside(b: Beyond, recs: Recordings, follows: _Following | None, alone: bool) -> RecordingMismatch:
    """Return the finding that columns of a channel lie far outside in some episodes.

    Parameters
    ----------
    alone : bool
        Whether the other channel is where it should be in these episodes: then joints tell the factor.
    """
    episodes: Mask = np.asarray(b.far.any(1))
    columns = np.flatnonzero(b.far.any(0))
    slope = np.abs(follows.slope[follows.servos]) if follows is not None and follows.servos.any() and alone else None
    shifted = slope is not None and bool((slope > 1 / 3).all() and (slope < 3).all())
    unit = "" if shifted else _unit(b, columns, slope)
    names = tuple(b.names[c] for c in columns)
    sure = bool(episodes.all() or episodes.sum() >= max(AT_LEAST, SHARE * len(episodes)))
    text = _reach(b, columns) + ("" if episodes.all() else f", at least {in_episodes(recs, episodes)}")
    kind = {"joint_position": "joint_unit", "action": "command_unit"}[b.channel]
    expected = f"{b.channel} in rad (m for slides), within the range that the scene gives"
    if shifted:
        return RecordingMismatch(
            "zero",
            sure,
            f"{b.channel} lies far outside its range, though it moves as it should",
            expected,
            text,
            "give command and joint one zero",
            b.channel,
            names,
        )
    if not unit:
        return RecordingMismatch(
            kind,
            sure and b.channel == "joint_position",
            f"{b.channel} lies far outside the range of the scene",
            expected,
            f"{text}; no known unit brings it back",
            "give its unit or scale in map.yaml, mend the range in the model, or put its columns in order",
            b.channel,
            names,
        )
    other = "" if alone else f", and look at {'action' if b.channel == 'joint_position' else 'joint_position'} too"
    where = "" if episodes.all() else " of these episodes"
    columns_of = unit_setting(b.channel, unit, b.names if b.mixed else ())
    return RecordingMismatch(
        kind,
        sure,
        f"{b.channel} looks like {WORDS[unit]}",
        expected,
        f"{text}: {1 / TO_SI[unit]:.4g} times what fits",
        f"give its unit in map.yaml{where}: {columns_of}{other}",
        b.channel,
        names,
    )


def _reach(b: Beyond, columns: NDArray[np.int64]) -> str:
    """Return how far the farthest column reaches, its range, and how many columns lie outside."""
    size = np.nanmax(np.abs(b.values[..., columns]), axis=(0, 1))
    c = columns[size.argmax()]
    names = [b.names[k] for k in columns]
    others = f" ({len(names)} of {len(b.names)} such columns)" if len(names) > 1 else ""
    return f"{b.names[c]} reaches {size.max():.4g}, its range is {b.low[c]:.4g} to {b.high[c]:.4g}{others}"


def unit_setting(channel: str, unit: str, columns: tuple[str, ...] = ()) -> str:
    """Return how map.yaml says that a channel is in a unit, or some of its columns."""
    if not columns:
        return f"`units: {{{channel}: {unit}}}`"
    more = f" and {len(columns) - 4} more" if len(columns) > 4 else ""
    return f"`units: {{COLUMN: {unit}}}` for the columns of {', '.join(columns[:4])}{more}"


def _unit(b: Beyond, columns: NDArray[np.int64], slope: Array | None) -> str:
    """Return the unit that brings the columns back into their ranges, by the joints' own motion where that tells."""
    choices = b.units[columns[0]]
    if slope is not None:
        factor = float(np.median(slope)) ** (1 if b.channel == "joint_position" else -1)
        near = min(choices, key=lambda u: abs(np.log(factor * TO_SI[u])))
        if abs(np.log(factor * TO_SI[near])) < np.log(UNIT_WITHIN):
            return near
    return next((u for u in choices if _fits(b, columns, TO_SI[u])), "")


def _fits(b: Beyond, columns: NDArray[np.int64], factor: float) -> bool:
    """Tell whether columns lie in their ranges when they are taken times a factor, but for a few rows."""
    values, slack = b.values[..., columns] * factor, SLACK * (b.high - b.low)[columns]
    outside = (values > b.high[columns] + slack) | (values < b.low[columns] - slack)
    return bool((outside.sum((0, 1)) <= ROWS * np.isfinite(values).sum((0, 1))).all())
