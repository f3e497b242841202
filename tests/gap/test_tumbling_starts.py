"""Where a toss of an object with joints starts: its mass centre falls, its frame does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candata.gap.data.recordings import Recordings
from candata.gap.replay.starts import reach, starts
from candata.rotation import difference, normalise
from candata.scenes import load_scene
from candata.simulate import rollout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "elbow_tosses" / "scene.yaml"
COUNT, ROWS = 6, 70


@pytest.fixture(scope="module")
def elbow():
    return load_scene(EXAMPLE)


@pytest.fixture(scope="module")
def thrown(elbow):
    """Noise-free tosses that tumble while the hinge turns, and their true states."""
    rng = np.random.default_rng(3)
    qpos = np.repeat(np.array(elbow.model.qpos0)[None], COUNT, axis=0)
    qvel = np.zeros((COUNT, elbow.model.nv))
    qpos[:, 2] = 0.35
    qpos[:, 3:7] = normalise(rng.standard_normal((COUNT, 4)))
    qpos[:, 7] = rng.uniform(-2, 2, COUNT)
    qvel[:, :6] = rng.uniform(-1, 1, (COUNT, 6)) * [1, 1, 0.2, 5, 5, 5]
    qvel[:, 6] = rng.uniform(-6, 6, COUNT)
    played = rollout(elbow, np.zeros((COUNT, ROWS, 0)), qpos, qvel, [()] * COUNT, keep_state=True)
    ids = tuple(map(str, range(COUNT)))
    readings = dict(played.readings)
    return Recordings(ids, ids, np.zeros((COUNT, ROWS, 0)), readings, np.full(COUNT, ROWS), False), played


def test_the_start_is_the_true_state(elbow, thrown):
    recs, played = thrown
    found = starts(elbow, recs)
    each = np.arange(COUNT)
    assert (found.rows > 15).all()  # 0.35 m of fall last longer than 0.1 s
    true_q, true_v = played.qpos[each, found.rows], played.qvel[each, found.rows]
    # Rates are means over seven rows on both sides (0.05 s): a constant change cancels, what remains is small.
    np.testing.assert_allclose(found.qpos[:, :3], true_q[:, :3], atol=5e-4)
    assert np.linalg.norm(difference(found.qpos[:, 3:7], true_q[:, 3:7]), axis=1).max() < 0.005
    np.testing.assert_allclose(found.qpos[:, 7], true_q[:, 7], atol=0.005)
    np.testing.assert_allclose(found.qvel[:, :3], true_v[:, :3], atol=0.01)
    np.testing.assert_allclose(found.qvel[:, 3:6], true_v[:, 3:6], atol=0.05)
    np.testing.assert_allclose(found.qvel[:, 6], true_v[:, 6], atol=0.05)


def test_a_parabola_of_the_frame_would_be_wrong(elbow, thrown):
    """The frame's own fit, which ignores the joint, misses the speed by more than the mass centre's."""
    recs, played = thrown
    alone = replace(recs, readings={"object_pose": recs.readings["object_pose"]})
    found, each = starts(elbow, alone), np.arange(COUNT)
    miss = np.abs(found.qvel[:, :3] - played.qvel[each, found.rows][:, :3]).max()
    assert miss > 0.03  # the mass centre's own fit stays below 0.01


def test_the_reach_counts_the_links(elbow):
    # Hinge 0.0695 m from link 1's frame, box 0.035 m beyond it, half diagonal 0.0612 m.
    assert reach(elbow) == pytest.approx(np.hypot(0.035, 0.06) + 0.035 + np.sqrt(0.05**2 + 2 * 0.025**2))


def test_rows_without_the_hinge_are_left_out(elbow, thrown):
    recs, _ = thrown
    gappy = replace(recs, readings={n: v.copy() for n, v in recs.readings.items()})
    gappy.readings["joint_position"][:, 3:5] = np.nan
    found = starts(elbow, gappy)
    np.testing.assert_array_equal(found.rows, starts(elbow, recs).rows)
    assert np.isfinite(found.qpos).all()
