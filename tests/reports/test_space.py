from __future__ import annotations

import re

import numpy as np

from candata.reports.space import path
from candata.schema.episode import Episode, EpisodeMeta


def make_episode(position, quaternion=(1, 0, 0, 0), **arrays):
    rows = len(position)
    pose = np.c_[position, np.tile(quaternion, (rows, 1))]
    return Episode(
        EpisodeMeta(id="e", source="sim", rate_hz=80.0),
        {"time_ns": np.arange(rows) * 12_500_000, "object_pose": pose} | arrays,
    )


def points(svg, kind):
    """Return the strokes of a class as lists of points in space."""
    strokes = re.search(rf'class="{kind}" data-p="([^"]*)"', svg)
    return [[tuple(map(int, p.split())) for p in stroke.split(",")] for stroke in strokes[1].split(";")]


def test_the_path_fills_the_cube_and_keeps_its_shape():
    svg = path(make_episode([[0, 0, 0], [0.1, 0, 0], [0.1, 0.05, 0.02]]))
    (way,) = points(svg, "way")
    assert abs(way[1][0] - way[0][0] - 2 * (way[2][1] - way[1][1])) <= 3  # whole units of the drawing
    assert max(abs(v) for point in way for v in point) <= 500


def test_axes_turn_with_the_object():
    svg = path(make_episode([[0, 0, 0]], quaternion=(np.sqrt(0.5), 0, 0, np.sqrt(0.5))))
    ((start, end),) = points(svg, "axis-x")
    assert tuple(np.subtract(end, start)) == (0, 90, 0)


def test_contact_is_a_stroke_of_its_own_and_gaps_break_the_path():
    position = np.linspace(0, 0.1, 8)[:, None] * [1, 0, 0]
    touch, valid = np.arange(8) >= 5, np.arange(8) != 2
    svg = path(make_episode(position, contact=touch, object_pose_valid=valid))
    assert [len(stroke) for stroke in points(svg, "way")] == [2, 3]
    assert [len(stroke) for stroke in points(svg, "way contact")] == [3]


def test_noise_at_rest_does_not_fill_the_cube(rng):
    svg = path(make_episode(rng.normal(size=(50, 3)) * 1e-4))
    assert max(abs(v) for stroke in points(svg, "way") for point in stroke for v in point) < 40
