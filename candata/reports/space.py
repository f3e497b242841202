"""The path of an object in space with its orientation: an SVG that stands without a script and turns with one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.reports.chart import linear
from candata.reports.envelope import turning_rows
from candata.reports.traces import masked
from candata.rotation import rotate
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Where the drawing is seen from, until it is turned.
AZIMUTH_DEG, ELEVATION_DEG = -55.0, 24.0
#: Half the side of the cube that holds the path, in units of the drawing; half the drawing's width and height.
HALF, REACH_X, REACH_Y = 500, 920, 820
#: Stretches of the path whose extremes are drawn, orientations drawn, and the length of their axes.
STRETCHES, TRIADS, AXIS_LENGTH = 90, 9, 90
#: The least half side of the cube [m]: noise at rest shall not fill the figure.
LEAST_HALF_M = 0.01


def path(episode: Episode) -> str:
    """Return the object's path with its axes at a few instants; empty where no pose is valid."""
    if "object_pose" not in episode:
        return ""
    pose = masked(episode, "object_pose")
    known = np.flatnonzero(~np.isnan(pose).any(axis=1))
    if not len(known):
        return ""
    low, high = pose[known, :3].min(axis=0), pose[known, :3].max(axis=0)
    centre, half_m = (low + high) / 2, max(LEAST_HALF_M, 0.55 * float((high - low).max()))
    points = HALF * (pose[:, :3] - centre) / half_m
    touch = touches(episode).get(ANY_FINGERTIP, np.zeros(len(episode), bool))
    rows = turning_rows(points, STRETCHES)
    marks = [
        *_frame(centre, half_m),
        *_ways(points, rows, touch),
        *_triads(points, pose[:, 3:], known),
        _curve("start", [[points[known[0]]]]),
        _curve("end", [[points[known[-1]]]]),
    ]
    view = f"{-REACH_X} {-REACH_Y} {2 * REACH_X} {2 * REACH_Y}"
    return (
        f'<svg class="space" viewBox="{view}" role="img" aria-label="path of the object in space" '
        f'data-azimuth="{AZIMUTH_DEG:g}" data-elevation="{ELEVATION_DEG:g}">{"".join(marks)}</svg>'
    )


def _frame(centre: Array, half_m: float) -> Iterable[str]:
    """Return the floor's grid, an upright edge, and the numbers along the three axes in cm."""
    axes = [linear([100 * (c - half_m), 100 * (c + half_m)], 4) for c in centre]
    ticks = [
        [(HALF * (v / 100 - c) / half_m, t) for v, t in axis.ticks if abs(v / 100 - c) <= half_m]
        for axis, c in zip(axes, centre, strict=True)
    ]
    floor = [[(at, -HALF, -HALF), (at, HALF, -HALF)] for at, _ in ticks[0]]
    floor += [[(-HALF, at, -HALF), (HALF, at, -HALF)] for at, _ in ticks[1]]
    floor += [[(-HALF, -HALF, -HALF), (-HALF, -HALF, HALF)]]
    floor += [[(-HALF, -HALF, at), (-HALF + 30, -HALF, at)] for at, _ in ticks[2]]
    edge = [[(-HALF, -HALF, -HALF), (HALF, -HALF, -HALF), (HALF, HALF, -HALF), (-HALF, HALF, -HALF),
             (-HALF, -HALF, -HALF)]]  # fmt: skip
    yield _curve("floor", floor)
    yield _curve("floor", edge)
    for places, spot in zip(ticks, (_along_x, _along_y, _along_z), strict=True):
        yield from (_text(spot(at, 55), text) for at, text in places)
    for name, spot in zip("xyz", (_along_x, _along_y, _along_z), strict=True):
        yield _text(spot(0.0, 185), f"{name} [cm]", "title")


def _along_x(at: float, away: float) -> tuple[float, float, float]:
    """Return the place of a text beside the front edge."""
    return at, -HALF - away, -HALF


def _along_y(at: float, away: float) -> tuple[float, float, float]:
    """Return the place of a text beside the right edge."""
    return HALF + away, at, -HALF


def _along_z(at: float, away: float) -> tuple[float, float, float]:
    """Return the place of a text beside the upright edge."""
    return -HALF - away, -HALF, at


def _ways(points: Array, rows: NDArray[np.int64], touch: NDArray[np.bool_]) -> Iterable[str]:
    """Return the path without and with contact: two curves of many strokes."""
    strokes: dict[bool, list[list[Array]]] = {False: [], True: []}
    last: tuple[bool, int] | None = None
    for a, b in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        if np.isnan(points[[a, b]]).any():
            last = None
            continue
        flag = bool(touch[a])
        if last == (flag, a):
            strokes[flag][-1].append(points[b])
        else:
            strokes[flag].append([points[a], points[b]])
        last = (flag, b)
    yield from (_curve("way contact" if flag else "way", strokes[flag]) for flag in (False, True) if strokes[flag])


def _triads(points: Array, quaternions: Array, known: NDArray[np.int64]) -> Iterable[str]:
    """Return the object's axes at rows spread evenly over the valid ones."""
    rows = np.unique(known[np.linspace(0, len(known) - 1, TRIADS).round().astype(int)])
    for k, axis in enumerate("xyz"):
        arrows = rotate(quaternions[rows], np.tile(AXIS_LENGTH * np.eye(3)[k], (len(rows), 1)))
        pairs = zip(points[rows], points[rows] + arrows, strict=True)
        yield _curve(f"axis-{axis}", [[start, end] for start, end in pairs])


def _curve(kind: str, strokes: Sequence[Sequence[Sequence[float] | Array]]) -> str:
    """Return strokes as a path that knows its points in space, so that it can be turned."""
    whole = [[[round(float(v)) for v in point] for point in stroke] for stroke in strokes]
    space = ";".join(",".join(" ".join(map(str, point)) for point in stroke) for stroke in whole)
    flat = "".join("M" + "L".join("{} {}".format(*_seen(p)) for p in stroke) for stroke in whole)
    return f'<path class="{kind}" data-p="{space}" d="{flat}{"h0" if len(whole[0]) == 1 else ""}"/>'


def _text(place: tuple[float, float, float], text: str, kind: str = "") -> str:
    """Return a text at a place in space."""
    x, y = _seen(place)
    space = " ".join(str(round(v)) for v in place)
    return f'<text class="{kind}" data-p="{space}" x="{x}" y="{y}" dy="9">{text}</text>'


def _seen(point: Sequence[float]) -> tuple[int, int]:
    """Return where a point of the cube lies in the drawing: a parallel projection."""
    azimuth, elevation = math.radians(AZIMUTH_DEG), math.radians(ELEVATION_DEG)
    across = -math.sin(azimuth) * point[0] + math.cos(azimuth) * point[1]
    away = math.cos(azimuth) * point[0] + math.sin(azimuth) * point[1]
    return round(across), round(math.sin(elevation) * away - math.cos(elevation) * point[2])
