"""Courses of one episode over time: joints with their commands, forces, and who touches when."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.datasets.elements import actuator_labels, fingertip_labels, joint_labels
from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.reports.chart import Axis, areas, chart, join_markup, line, linear_axis, mark
from candata.reports.document import render
from candata.reports.envelope import bounds, envelope, runs
from candata.reports.joint_units import readable_unit
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


def joints(episode: Episode, units: Mapping[str, str]) -> Markup:
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
    charts = [
        (name, _trace(episode, name, lines[name], readable_unit("joint", name, units)))
        for name in list(lines)[:MOST_TRACES]
    ]
    return _grid(charts, len(lines), [("after", "position"), ("before", "command")])


def command_joints(episode: Episode, joint_names: Sequence[str], count: int) -> tuple[str, ...]:
    """Return the joint that each command is drawn with: by name, else by place where there are equally many."""
    names = actuator_labels(episode.meta, count)
    has_names = episode.meta.actuator_names and episode.meta.joint_names
    return tuple(joint_names) if not has_names and count == len(joint_names) else names


def forces(episode: Episode) -> Markup:
    """Return a chart a fingertip: the force's components, behind them when it touches; empty without forces."""
    if "fingertip_force" not in episode:
        return Markup("")
    force, touch = masked(episode, "fingertip_force"), touches(episode)
    names = fingertip_labels(episode.meta, force.shape[1])
    charts = []
    for i, name in enumerate(names[:MOST_TRACES]):
        lines = {f"axis-{axis}": force[:, i, k] for k, axis in enumerate("xyz")}
        charts.append((name, _trace(episode, name, lines, "N", touch.get(name))))
    key = [(f"axis-{axis}", axis) for axis in "xyz"] + [("touch", "in contact")]
    return _grid(charts, len(names), key)


def timeline(episode: Episode) -> Markup:
    """Return when each fingertip touches, under the phases of the contact; empty where contact is not known."""
    touch = touches(episode)
    if ANY_FINGERTIP not in touch:
        return Markup("")
    time_s, tips = episode.time_s, [name for name in touch if name != ANY_FINGERTIP]
    rows = ["phase", *(tips or ["any"])]
    x = linear_axis([0.0, _length_s(episode)], 8)
    y = Axis(-0.5, len(rows) - 0.5, tuple((float(len(rows) - 1 - k), name) for k, name in enumerate(rows)))
    phases = contact_phases(touch[ANY_FINGERTIP], episode.meta.rate_hz)
    marks = [_strokes(x, y, time_s, phases == p, len(rows) - 1, f"phase {p}") for p in DRAWN_PHASES]
    for k, name in enumerate(rows[1:]):
        marks.append(_strokes(x, y, time_s, touch[name if tips else ANY_FINGERTIP], len(rows) - 2 - k, "touching"))
    label = "contact of each fingertip over time"
    return render("timeline", key=phase_key(), chart=chart(x, y, join_markup(marks), label, 20 * len(rows), "time [s]"))


def phase_key(with_touch: bool = True) -> list[tuple[str, str]]:
    """Return class and name of each phase, and of a fingertip's touch."""
    key = [(f"key-{name}", name) for name in CONTACT_PHASES]
    return [*key, ("key-touch", "in contact")] if with_touch else key


def _strokes(x: Axis, y: Axis, time_s: Array, flags: NDArray[np.bool_], height: float, css_class: str) -> Markup:
    """Return a level stroke wherever a flag stands; in a long episode a column counts when any of its rows does."""
    level = y.y_place(height)
    places = ((x.x_place(start), x.x_place(end)) for start, end in _spans(time_s, flags, _step_s(time_s)))
    steps = "".join(f"M{start} {level}H{max(end, start + 1)}" for start, end in places)
    return mark(f"stroke {css_class}", steps) if steps else Markup("")


def _spans(time_s: Array, flags: NDArray[np.bool_], hold_s: float) -> Iterator[tuple[float, float]]:
    """Yield begin and end of each stretch in which a flag stands; a row counts until the next, the last for `hold_s`.

    Of a long episode a column counts when any of its rows does.
    """
    edges = np.append(time_s, time_s[-1] + hold_s)
    if len(time_s) > TIMELINE_COLUMNS:
        flags = bounds(time_s, flags.astype(float), TIMELINE_COLUMNS)[1] > 0
        edges = np.linspace(0.0, time_s[-1], TIMELINE_COLUMNS + 1)
    yield from ((float(edges[start]), float(edges[end])) for start, end in runs(flags))


def _step_s(time_s: Array) -> float:
    """Return the usual step from row to row [s]."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0


def _length_s(episode: Episode) -> float:
    """Return the time that an axis spans: one period for an episode of one row."""
    return float(episode.time_s[-1]) or 1 / episode.meta.rate_hz


def _trace(
    episode: Episode, name: str, lines: Mapping[str, Array], unit: str, touch: NDArray[np.bool_] | None = None
) -> Markup:
    """Return one chart: lines by class, stretches of contact behind them; empty when no value is valid."""
    if not any(np.isfinite(values).any() for values in lines.values()):
        return Markup("")
    points = {css_class: envelope(episode.time_s, values) for css_class, values in lines.items()}
    x = linear_axis([0.0, _length_s(episode)], 4, " s")
    y = linear_axis([value for _, ys in points.values() for value in ys], 4)
    marks = [] if touch is None else [areas(x, _spans(episode.time_s, touch, 0.0), "touch")]
    marks += [line(x, y, xs, ys, css_class) for css_class, (xs, ys) in points.items()]
    return chart(x, y, join_markup(marks), f"{name} over time", 84, "", unit)


def _grid(charts: Sequence[tuple[str, Markup]], total: int, key: Sequence[tuple[str, str]]) -> Markup:
    """Return charts side by side under their key; empty for none."""
    if not charts:
        return Markup("")
    entries = [(f"key-{css_class}", name) for css_class, name in key]
    return render("traces", charts=charts, key=entries, undrawn_count=total - len(charts))
