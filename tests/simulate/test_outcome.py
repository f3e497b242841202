"""Outcomes from true motions: each word on the motion that it is for, and on the scripted policies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from candata.policies._contract import Goal
from candata.rotation import exp
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes, planned, tried_episodes
from candata.simulate.outcome import ObjectMotion, outcome

RATE_HZ, ROWS = 50.0, 100
#: Corners of a box 6 x 6 x 12 cm, and points on a ball of 3 cm (Fibonacci's lattice).
BOX = np.array(list(itertools.product((-0.03, 0.03), (-0.03, 0.03), (-0.06, 0.06))))
TURNS = np.arange(500) * np.pi * (3 - np.sqrt(5))
HEIGHTS = np.linspace(-1, 1, 500)
BALL = 0.03 * np.stack([np.sqrt(1 - HEIGHTS**2) * np.cos(TURNS), np.sqrt(1 - HEIGHTS**2) * np.sin(TURNS), HEIGHTS], 1)
LIFT, PUSH = Goal(lift_m=0.03, held_s=0.4), Goal(place_m=np.array([0.1, 0.0, 0.0]), place_tolerance_m=0.03)


def rows(*pairs):
    """A value at each row, linear between (row, value) pairs."""
    return np.interp(np.arange(ROWS), *zip(*pairs, strict=True))


def motion(height=0.0, along=0.0, turn=None, held=(), touch=None, surface=BOX):
    """A motion of which fingertips press in the rows `held`, and anything touches in the rows `touch`."""
    pose = np.zeros((ROWS, 7))
    pose[:, 0], pose[:, 2] = along, height
    pose[:, 3:] = exp(np.zeros((ROWS, 3)) if turn is None else turn)
    tips, touched = np.zeros((ROWS, 3), bool), np.zeros(ROWS, bool)
    for span in (held,) if held else ():
        tips[slice(*span), :2] = touched[slice(*span)] = True
    for span in (touch,) if touch else ():
        touched[slice(*span)] = True
    return ObjectMotion(pose, touched, tips, surface, np.zeros(3), RATE_HZ)


def about_y(angles_rad):
    return np.stack([np.zeros(ROWS), angles_rad, np.zeros(ROWS)], axis=1)


LIFTED = rows((20, 0.0), (40, 0.05), (70, 0.05), (90, 0.0))
TURNED = {angle: np.roll(about_y(rows((20, 0.0), (50, angle), (90, 0.0))), 1, axis=1) for angle in (0.5, 0.75)}
TIPPED = about_y(rows((30, 0.0), (50, np.pi / 2)))
#: Height of the centre of the tipped box above its first: it lies on a side.
LYING_M = -0.03


@pytest.mark.parametrize(
    ("goal", "made", "word"),
    [
        (LIFT, motion(LIFTED, held=(15, 92)), "success"),
        (LIFT, motion(rows((20, 0.0), (40, 0.05), (60, 0.05), (65, 0.0)), held=(15, 60)), "drop"),
        (LIFT, motion(rows((20, 0.0), (30, 0.02), (50, 0.0)), held=(15, 92)), "slip"),
        (LIFT, motion(held=(15, 40)), "slip"),
        (LIFT, motion(along=rows((20, 0.0), (40, 0.05)), touch=(20, 40)), "miss"),
        (LIFT, motion(), "miss"),
        (LIFT, motion(rows((30, 0.0), (50, LYING_M)), turn=TIPPED, touch=(30, 50)), "topple"),
        (LIFT, motion(rows((60, 0.0), (70, -0.4))), "drop"),
        (PUSH, motion(along=rows((20, 0.0), (60, 0.09)), touch=(20, 60)), "success"),
        (PUSH, motion(along=rows((20, 0.0), (60, 0.05)), touch=(20, 60)), "slip"),
        (PUSH, motion(), "miss"),
        (PUSH, motion(rows((30, 0.0), (50, LYING_M)), rows((30, 0.0), (50, 0.09)), TIPPED, touch=(30, 50)), "topple"),
        (Goal(topple=True), motion(rows((30, 0.0), (50, LYING_M)), turn=TIPPED, touch=(30, 50)), "success"),
        (Goal(topple=True), motion(touch=(30, 50)), "miss"),
        (Goal(slip=True), motion(rows((30, 0.0), (50, LYING_M)), turn=TIPPED, held=(15, 50)), "topple"),
        (Goal(slip=True), motion(held=(15, 50)), "success"),
        (Goal(turn_rad=0.7), motion(turn=about_y(rows((20, 0.0), (50, 0.75), (90, 0.0))), held=(10, 92)), "slip"),
        (
            Goal(turn_rad=0.7),
            motion(turn=TURNED[0.75], held=(15, 92)),
            "success",
        ),
        (Goal(turn_rad=0.7), motion(turn=TURNED[0.5], held=(15, 92)), "slip"),
        (Goal(slip=True), motion(rows((20, 0.0), (40, 0.05), (60, 0.05), (65, 0.0)), held=(15, 60)), "success"),
        (Goal(slip=True), motion(LIFTED.max() * rows((20, 0.0), (40, 1.0)), held=(15, 100)), "slip"),
    ],
)
def test_each_motion_has_its_word(goal, made, word):
    assert outcome(goal, made) == word


def test_a_ball_that_rolls_has_not_toppled():
    rolled = motion(
        along=rows((20, 0.0), (60, 0.06)), turn=about_y(rows((20, 0.0), (60, 2.0))), touch=(20, 60), surface=BALL
    )
    assert outcome(Goal(lift_m=0.03), rolled) == "miss"


def test_a_slim_box_with_soft_edges_topples_though_it_hardly_rises():
    # 6 x 16 x 21 cm without what lies within 1 cm of its edges: tipping raises it by 1.9 mm.
    sides = np.array([0.03, 0.08, 0.105])
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 3), axis=-1).reshape(-1, 3) * sides
    surface = grid[((sides - np.abs(grid)) < 0.01).sum(1) == 1]
    made = motion(rows((30, 0.0), (50, 0.03 - 0.105)), turn=TIPPED, touch=(30, 50), surface=surface)
    assert outcome(Goal(topple=True), made) == "success"


def test_an_object_put_down_from_low_was_not_dropped():
    lowered = rows((20, 0.0), (40, 0.05), (70, 0.05), (85, 0.012), (90, 0.0))
    assert outcome(LIFT, motion(lowered, held=(15, 85))) == "success"


@pytest.fixture(scope="module")
def carton():
    return load_scene("gripper_tabletop")


def test_the_scripted_grasp_lifts_and_the_push_arrives(carton):
    jobs = [EpisodeJob(f"{name}-{i}", i, name, 1) for name in ("grasp_lift_shake", "push") for i in range(2)]
    assert [e.meta.outcome for e in make_episodes(carton, jobs, duration_s=3.2)] == ["success"] * 4


def test_the_same_commands_miss_an_object_that_stands_elsewhere(carton):
    jobs = [EpisodeJob("near", 0, "grasp_lift_shake", 1), EpisodeJob("far", 0, "grasp_lift_shake", 1)]
    plans = [planned(carton, job, 3.2) for job in jobs]
    plans[1].qpos[carton.object_qpos + 1] += 0.2
    episodes, _ = tried_episodes(carton, jobs, duration_s=3.2, plans=plans)
    assert [e.meta.outcome for e in episodes] == ["success", "miss"]


def test_an_episode_that_means_nothing_with_the_object_has_no_outcome(carton):
    (episode,) = make_episodes(carton, [EpisodeJob("e", 0, "free_sweep", 1)], duration_s=0.2)
    assert episode.meta.outcome is None
