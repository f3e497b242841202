"""Courses of one episode over time: joints with their commands, forces, and who touches when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from candata.datasets.elements import actuator_labels, fingertip_labels, joint_labels
from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.reports.chart import PLANE, Axis, chart, line, linear
from candata.reports.envelope import bounds, envelope, runs
from candata.reports.joint_units import readable
from candata.schema.episode import Episode
from candata.schema.phases import CONTACT_PHASES, contact_phases

Array = NDArray[np.float64]
#: Traces drawn of one kind; a hand has fewer.
MOST_TRACES = 40
#: Phases in the order drawn: where a column of a long timeline holds several, the short ones stay in sight.
DRAWN_PHASES = ("free", "sustained", "release", "onset")
#: Columns of a timeline: a touch shorter than one is drawn as wide as one.
TIMELINE_COLUMNS = 600


def masked(episode: Episode, channel: str) -> Array:
    """Return a channel as `(T, ...) float64`, NaN where it is not valid."""
    values = np.array(episode[channel], float)
    values[~episode.valid(channel)] = np.nan
    return values


def joints(episode: Episode, units: Mapping[str, str]) -> str:
    """Return a chart a joint: position, and the command that bears its name; empty without either."""
    lines: dict[str, dict[str, Array]] = {}
    if "joint_position" in episode:
        position = masked(episode, "joint_position")
        names = joint_labels(episode.meta, position.shape[1])
        lines = {name: {"after": position[:, i]} for i, name in enumerate(names)}
    if "action" in episode:
        action = masked(episode, "action")
        for i, name in enumerate(command_joints(episode, list(lines), action.shape[1])):
            lines[name] = {"before": action[:, i], **lines.get(name, {})}
    cells = [_cell(episode, name, lines[name], readable("joint", name, units)) for name in list(lines)[:MOST_TRACES]]
    return _grid(cells, len(lines), [("after", "position"), ("before", "command")])


def command_joints(episode: Episode, joints: Sequence[str], count: int) -> tuple[str, ...]:
    """Return the joint that each command is drawn with: by name, else by place where there are equally many."""
    names = actuator_labels(episode.meta, count)
    unnamed = not episode.meta.actuator_names or not episode.meta.joint_names
    return tuple(joints) if unnamed and count == len(joints) else names


def forces(episode: Episode) -> str:
    """Return a chart a fingertip: the force's components, behind them when it touches; empty without forces."""
    if "fingertip_force" not in episode:
        return ""
    force, touch = masked(episode, "fingertip_force"), touches(episode)
    names = fingertip_labels(episode.meta, force.shape[1])
    cells = []
    for i, name in enumerate(names[:MOST_TRACES]):
        lines = {f"axis-{axis}": force[:, i, k] for k, axis in enumerate("xyz")}
        cells.append(_cell(episode, name, lines, "N", touch.get(name)))
    key = [(f"axis-{axis}", axis) for axis in "xyz"] + [("touch", "in contact")]
    return _grid(cells, len(names), key)


def timeline(episode: Episode) -> str:
    """Return when each fingertip touches, under the phases of the contact; empty where contact is not known."""
    found = touches(episode)
    if ANY_FINGERTIP not in found:
        return ""
    time_s, tips = episode.time_s, [name for name in found if name != ANY_FINGERTIP]
    rows = ["phase", *(tips or ["any"])]
    x = linear([0.0, _length_s(episode)], 8)
    y = Axis(-0.5, len(rows) - 0.5, tuple((float(len(rows) - 1 - k), name) for k, name in enumerate(rows)))
    phases = contact_phases(found[ANY_FINGERTIP], episode.meta.rate_hz)
    marks = "".join(_strokes(x, y, time_s, phases == p, len(rows) - 1, f"phase {p}") for p in DRAWN_PHASES)
    for k, name in enumerate(rows[1:]):
        marks += _strokes(x, y, time_s, found[name if tips else ANY_FINGERTIP], len(rows) - 2 - k, "touching")
    drawn = chart(x, y, marks, "contact of each fingertip over time", 20 * len(rows), "time [s]")
    return f'{phase_key()}<div class="named">{drawn}</div>'


def phase_key(touch: bool = True) -> str:
    """Return the colours of the phases, and that of a fingertip's touch."""
    spans = "".join(f'<span class="key-{name}">{name}</span>' for name in CONTACT_PHASES)
    spans += '<span class="key-touch">in contact</span>' if touch else ""
    return f'<p class="sub key">{spans}</p>'


def _strokes(x: Axis, y: Axis, time_s: Array, flags: NDArray[np.bool_], at: float, kind: str) -> str:
    """Return a level stroke wherever a flag stands; in a long episode a column counts when any of its rows does."""
    if len(time_s) > TIMELINE_COLUMNS:
        flags = bounds(time_s, flags.astype(float), TIMELINE_COLUMNS)[1] > 0
        edges = np.linspace(0.0, time_s[-1], TIMELINE_COLUMNS + 1)
    else:
        step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
        edges = np.append(time_s, time_s[-1] + step)
    down = round(PLANE * (1 - y.share(at)))
    spans = ((round(PLANE * x.share(edges[a])), round(PLANE * min(x.share(edges[b]), 1.0))) for a, b in runs(flags))
    d = "".join(f"M{a} {down}H{max(b, a + 1)}" for a, b in spans)
    return f'<path class="stroke {kind}" d="{d}"/>' if d else ""


def _length_s(episode: Episode) -> float:
    """Return the time that an axis spans: one period for an episode of one row."""
    return float(episode.time_s[-1]) or 1 / episode.meta.rate_hz


def _cell(
    episode: Episode, name: str, lines: Mapping[str, Array], unit: str, touch: NDArray[np.bool_] | None = None
) -> str:
    """Return one chart under its name: lines by class, stretches of contact behind them."""
    time_s = episode.time_s
    drawn = {kind: envelope(time_s, values) for kind, values in lines.items()}
    x, y = linear([0.0, _length_s(episode)], 4, " s"), linear([v for _, ys in drawn.values() for v in ys], 4)
    marks = "" if touch is None else _areas(x, time_s, touch)
    marks += "".join(line(x, y, xs, ys, kind) for kind, (xs, ys) in drawn.items())
    if not any(np.isfinite(values).any() for values in lines.values()):
        return f'<div><p>{escape(name)}</p><p class="sub small">no valid value</p></div>'
    return f"<div><p>{escape(name)}</p>{chart(x, y, marks, f'{name} over time', 84, '', unit)}</div>"


def _areas(x: Axis, time_s: Array, flags: NDArray[np.bool_]) -> str:
    """Return upright areas where a flag stands."""
    if len(time_s) > TIMELINE_COLUMNS:
        flags = bounds(time_s, flags.astype(float), TIMELINE_COLUMNS)[1] > 0
        time_s = np.linspace(0.0, time_s[-1], TIMELINE_COLUMNS)
    spans = ((time_s[a], time_s[min(b, len(time_s) - 1)]) for a, b in runs(flags))
    places = ((round(PLANE * x.share(a)), round(PLANE * x.share(b))) for a, b in spans)
    d = "".join(f"M{a} 0H{max(b, a + 1)}V{PLANE}H{a}Z" for a, b in places)
    return f'<path class="touch" d="{d}"/>' if d else ""


def _grid(cells: Sequence[str], total: int, key: Sequence[tuple[str, str]]) -> str:
    """Return charts side by side under their key; empty for none."""
    if not cells:
        return ""
    spans = "".join(f'<span class="key-{kind}">{escape(name)}</span>' for kind, name in key)
    note = f'<p class="note">{total - len(cells)} more are not drawn.</p>' if total > len(cells) else ""
    return f'<p class="sub key">{spans}</p><div class="multiples wide">{"".join(cells)}</div>{note}'
