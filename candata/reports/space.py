"""Paths of an object in space: an SVG that stands without a script and turns with one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.reports.chart import join_markup, linear_axis
from candata.reports.envelope import turning_rows
from candata.reports.numbers import digits
from candata.reports.traces import masked
from candata.rotation import rotate
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Direction that the drawing is seen from, until it is turned.
AZIMUTH_DEG, ELEVATION_DEG = -55.0, 24.0
#: Half the side of the cube that holds the path, in units of the drawing; half the drawing's width and height.
CUBE_HALF, VIEW_HALF_X, VIEW_HALF_Y = 500, 920, 820
#: Stretches of the path whose extremes are drawn, orientations drawn, and the length of their axes.
STRETCHES, TRIADS, AXIS_LENGTH = 90, 9, 90
#: Points of a path that show their time when pointed at.
POINTS_WITH_TIME = 24
#: The least half side of the cube [m]: noise at rest shall not fill the figure.
LEAST_HALF_M = 0.01
#: The least half side of the cube around the paths of a closed loop [m].
LEAST_LOOP_HALF_M = 0.03
#: Room around a path, as a share of its longest side.
CUBE_MARGIN = 0.55


def path(episode: Episode) -> Markup:
    """Return the object's path with its axes at a few instants; empty where no pose is valid."""
    if "object_pose" not in episode:
        return Markup("")
    pose = masked(episode, "object_pose")
    valid_rows = np.flatnonzero(~np.isnan(pose).any(axis=1))
    if not len(valid_rows):
        return Markup("")
    centre, half_m = _cube(pose[valid_rows, :3], LEAST_HALF_M)
    points = CUBE_HALF * (pose[:, :3] - centre) / half_m
    touch = touches(episode).get(ANY_FINGERTIP, np.zeros(len(episode), bool))
    rows = turning_rows(points, STRETCHES)
    marks = [
        *_frame(centre, half_m),
        *_path_by_contact(points, rows, touch),
        *_triads(points, pose[:, 3:], valid_rows),
        _curve("start", [[points[valid_rows[0]]]]),
        _curve("end", [[points[valid_rows[-1]]]]),
    ]
    return _drawing(marks, "path of the object in space")


def paths(
    positions: Mapping[str, Array], time_s: Array, css_classes: Mapping[str, str], held_names: Sequence[str]
) -> Markup:
    """Return the paths of several forecasters in one cube, the last of them on top.

    Parameters
    ----------
    positions : mapping of str to (T, 3) float64 [m]
        By the name that shows when a path is pointed at.
    time_s : (T,) float64 [s]
    css_classes : mapping of str to str
        Class of each path.
    held_names : sequence of str
        Names of the paths that the cube holds; the others may leave it.
    """
    centre, half_m = _cube(np.concatenate([positions[name] for name in held_names]), LEAST_LOOP_HALF_M)
    marks = list(_frame(centre, half_m))
    for name, position in positions.items():
        points = CUBE_HALF * (position - centre) / half_m
        points = points[: _rows_in_view(points)]
        rows = turning_rows(points, STRETCHES)
        marks.append(_curve(f"loop {css_classes[name]}", [points[rows]], name))
        for k in np.unique(np.linspace(0, len(points) - 1, POINTS_WITH_TIME).round().astype(int)).tolist():
            place = ", ".join(digits(100 * value) for value in position[k])
            marks.append(_curve("point", [[points[k]]], f"{name}, {time_s[k]:.2f} s: {place} cm"))
    start = CUBE_HALF * (positions[held_names[0]][0] - centre) / half_m
    marks.append(_curve("start", [[start]], "the loop begins here"))
    return _drawing(marks, "paths of the object in space")


def _cube(position: Array, least_half_m: float) -> tuple[Array, float]:
    """Return centre and half side [m] of the cube that holds the finite ones of the positions (N, 3)."""
    finite = position[np.isfinite(position).all(axis=1)]
    low, high = finite.min(axis=0), finite.max(axis=0)
    return (low + high) / 2, max(least_half_m, CUBE_MARGIN * float((high - low).max()))


def _rows_in_view(points: Array) -> int:
    """Return how many rows pass before a path is not finite or outside of the drawing from any side; one at least."""
    outside_rows = np.flatnonzero(~(np.linalg.norm(points, axis=1) <= 2 * VIEW_HALF_X))
    return max(int(outside_rows[0]), 1) if len(outside_rows) else len(points)


def _drawing(marks: Iterable[Markup], label: str) -> Markup:
    """Return the drawing around some marks."""
    return Markup(
        '<svg class="space" viewBox="{} {} {} {}" role="img" aria-label="{}" data-azimuth="{:g}" data-elevation="{:g}">'
        "{}</svg>"
    ).format(
        -VIEW_HALF_X,
        -VIEW_HALF_Y,
        2 * VIEW_HALF_X,
        2 * VIEW_HALF_Y,
        label,
        AZIMUTH_DEG,
        ELEVATION_DEG,
        join_markup(marks),
    )


def _frame(centre: Array, half_m: float) -> Iterable[Markup]:
    """Return the floor's grid, an upright edge, and the numbers along the three axes in cm."""
    h = CUBE_HALF
    axes = [linear_axis([100 * (c - half_m), 100 * (c + half_m)], 6) for c in centre]
    ticks = [
        [(h * (v / 100 - c) / half_m, t) for v, t in axis.ticks if abs(v / 100 - c) <= half_m]
        for axis, c in zip(axes, centre, strict=True)
    ]
    grid = [[(place, -h, -h), (place, h, -h)] for place, _ in ticks[0]]
    grid += [[(-h, place, -h), (h, place, -h)] for place, _ in ticks[1]]
    grid += [[(-h, -h, -h), (-h, -h, h)]]
    grid += [[(-h, -h, place), (-h + 30, -h, place)] for place, _ in ticks[2]]
    yield _curve("floor", grid)
    yield _curve("floor", [[(-h, -h, -h), (h, -h, -h), (h, h, -h), (-h, h, -h), (-h, -h, -h)]])
    for tick_places, text_place in zip(ticks, (_x_text_place, _y_text_place, _z_text_place), strict=True):
        yield from (_text(text_place(place, 55), text) for place, text in tick_places)
    for name, text_place in zip("xyz", (_x_text_place, _y_text_place, _z_text_place), strict=True):
        yield _text(text_place(0.0, 185), f"{name} [cm]", "title")


def _x_text_place(place: float, distance: float) -> tuple[float, float, float]:
    """Return the place of a text beside the front edge."""
    return place, -CUBE_HALF - distance, -CUBE_HALF


def _y_text_place(place: float, distance: float) -> tuple[float, float, float]:
    """Return the place of a text beside the right edge."""
    return CUBE_HALF + distance, place, -CUBE_HALF


def _z_text_place(place: float, distance: float) -> tuple[float, float, float]:
    """Return the place of a text beside the upright edge."""
    return -CUBE_HALF - distance, -CUBE_HALF, place


def _path_by_contact(points: Array, rows: NDArray[np.int64], touch: NDArray[np.bool_]) -> Iterable[Markup]:
    """Return the path without and with contact: two curves of many strokes."""
    strokes: dict[bool, list[list[Array]]] = {False: [], True: []}
    stroke_end: tuple[bool, int] | None = None
    for a, b in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        if np.isnan(points[[a, b]]).any():
            stroke_end = None
            continue
        in_contact = bool(touch[a])
        if stroke_end == (in_contact, a):
            strokes[in_contact][-1].append(points[b])
        else:
            strokes[in_contact].append([points[a], points[b]])
        stroke_end = (in_contact, b)
    css_classes = {False: "way", True: "way contact"}
    yield from (_curve(css_classes[flag], strokes[flag]) for flag in (False, True) if strokes[flag])


def _triads(points: Array, quaternions: Array, valid_rows: NDArray[np.int64]) -> Iterable[Markup]:
    """Return the object's axes at rows spread evenly over the valid ones."""
    rows = np.unique(valid_rows[np.linspace(0, len(valid_rows) - 1, TRIADS).round().astype(int)])
    for k, axis in enumerate("xyz"):
        arrows = rotate(quaternions[rows], np.tile(AXIS_LENGTH * np.eye(3)[k], (len(rows), 1)))
        pairs = zip(points[rows], points[rows] + arrows, strict=True)
        yield _curve(f"axis-{axis}", [[start, end] for start, end in pairs])


def _curve(css_class: str, strokes: Sequence[Sequence[Sequence[float] | Array] | Array], tooltip: str = "") -> Markup:
    """Return strokes as a path that knows its points in space, so that it can be turned."""
    points = [[[round(float(v)) for v in point] for point in stroke] for stroke in strokes]
    in_space = ";".join(",".join(" ".join(map(str, point)) for point in stroke) for stroke in points)
    steps = "".join("M" + "L".join("{} {}".format(*_projected_point(p)) for p in stroke) for stroke in points)
    title = Markup("<title>{}</title>").format(tooltip) if tooltip else ""
    return Markup('<path class="{}" data-p="{}" d="{}{}">{}</path>').format(
        css_class, in_space, steps, "h0" if len(points[0]) == 1 else "", title
    )


def _text(place: tuple[float, float, float], text: str, css_class: str = "") -> Markup:
    """Return a text at a place in space."""
    x, y = _projected_point(place)
    in_space = " ".join(str(round(v)) for v in place)
    return Markup('<text class="{}" data-p="{}" x="{}" y="{}" dy="9">{}</text>').format(css_class, in_space, x, y, text)


def _projected_point(point: Sequence[float]) -> tuple[int, int]:
    """Return where a point of the cube lies in the drawing: a parallel projection."""
    azimuth, elevation = math.radians(AZIMUTH_DEG), math.radians(ELEVATION_DEG)
    across = -math.sin(azimuth) * point[0] + math.cos(azimuth) * point[1]
    depth = math.cos(azimuth) * point[0] + math.sin(azimuth) * point[1]
    return round(across), round(math.sin(elevation) * depth - math.cos(elevation) * point[2])
