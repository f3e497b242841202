"""Filmstrips of closed loops: recorded, simulated and forecast, at the same moments."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.reports.evaluation_film import COLUMNS, films
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from tests.reports.evaluations import make_evaluation, make_track


@pytest.fixture
def tossed(tmp_path):
    """A dataset of one episode of a cube, and the track of it."""
    track, scene = make_track(), load_scene("cube_toss")
    pose = np.repeat(np.concatenate([track.truth[:1].repeat(8, axis=0), track.truth[1:]]), 2, axis=0)
    meta = EpisodeMeta(id=track.id, source="sim", rate_hz=20.0)
    folder = create_dataset(tmp_path / "set", name="set")
    arrays = {"time_ns": np.arange(len(pose)) * 50_000_000, "object_pose": pose}
    append(folder, [Episode(meta, arrays)], Lineage(operation="test"))
    return open_dataset(folder), replace(track, scene=scene)


def test_three_rows_show_the_simulator_and_the_best_model(tossed, no_gl, small_pictures):
    dataset, track = tossed
    (strip,) = films(make_evaluation(), dataset, [track]).values()
    assert re.findall(r'<span class="who \w+">(\w+)</span>', strip) == ["recorded", "simulator", "first"]
    pictures = re.findall(r'src="([^"]+)"', strip)
    assert len(pictures) == 3 * COLUMNS
    # All begin with the same pose and end with another.
    recorded, simulated, forecast = (pictures[k * COLUMNS : (k + 1) * COLUMNS] for k in range(3))
    assert recorded[0] == simulated[0] == forecast[0]
    assert len({recorded[-1], simulated[-1], forecast[-1]}) == 3
    assert "0.70 s" in strip
    assert "3.20 s" in strip


def test_without_a_scene_or_with_poses_that_are_not_finite_there_is_no_film(tossed, no_gl, small_pictures):
    dataset, track = tossed
    assert films(make_evaluation(), dataset, [replace(track, scene=None)]) == {}
    track.poses["first"][-1] = np.nan
    assert films(make_evaluation(), dataset, [track]) == {}
    assert films(make_evaluation(), dataset, []) == {}
