"""Outside causes: each acts where its truth says, and a case without one is the plain world."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UnknownNameError
from candata.gap.blind.cases import alter_with
from candata.gap.blind.draws import draw_outside, possible_outside
from candata.gap.blind.outside_causes import CAUSES
from candata.schema.bench import OutsideCause
from candata.simulate.episodes import EpisodeJob, make_episodes

#: Motions in which every cause shows; a push ends in a release.
POLICIES = ("push", "grasp_lift_shake")


def played(scene, outside, noise_seed=None):
    jobs = [EpisodeJob(f"e{i}", i, name, 1, noise_seed=noise_seed) for i, name in enumerate(POLICIES)]
    noise = scene.file.noise if noise_seed is not None else None
    return make_episodes(scene, jobs, duration_s=1.6, noise=noise, alter=alter_with(scene, outside))


@pytest.fixture(scope="module")
def plain(hand):
    return played(hand, None)


def change(plain, made, channel):
    return max(float(np.abs(a[channel] - b[channel]).max()) for a, b in zip(plain, made, strict=True))


def test_all_causes_can_act_in_the_tabletop_scene(hand):
    assert set(possible_outside(hand)) == set(CAUSES)
    assert {cause.acts_on for cause in CAUSES.values()} == {"joint", "fingertip", "object", "wrist"}


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_changes_what_is_read_and_stays_finite(hand, plain, name):
    made = played(hand, draw_outside(name, hand, np.random.default_rng(2)))
    moved = {c: change(plain, made, c) for c in ("joint_position", "object_pose", "fingertip_force")}
    assert all(np.isfinite(list(moved.values())))
    # More than the declared noise of one reading: 2 mrad or 2 mm, 1 mm, 0.02 N.
    assert moved["fingertip_force"] > 0.02
    if CAUSES[name].kind == "reading":
        assert moved["joint_position"] == moved["object_pose"] == 0
    else:
        assert max(moved["joint_position"] / 2e-3, moved["object_pose"] / 1e-3) > 1


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_without_size_changes_nothing(hand, plain, name):
    drawn = draw_outside(name, hand, np.random.default_rng(2))
    sizes = {
        "x_N",
        "y_N",
        "pull_N",
        "stiffness_Nm_rad",
        "torque_Nm",
        "share",
        "loss",
        "often",
        "width_N",
        "stiffness_N_m",
        "tension_N",
    }
    still = {k: 0.0 if k in sizes else v for k, v in drawn.values.items()}
    made = played(hand, drawn.model_copy(update={"values": still}))
    # Not one bit differs, but for zeros that were added.
    assert max(change(plain, made, c) for c in ("joint_position", "object_pose", "fingertip_force")) < 1e-9


def test_a_wind_pushes_the_object_with_its_force(cube):
    wind = OutsideCause(name="wind", acts_on="object", values={"x_N": 0.37, "y_N": 0.0})
    plain, made = (
        make_episodes(cube, [EpisodeJob("e", 0, "toss", 4)], duration_s=0.1, alter=alter_with(cube, o))[0]
        for o in (None, wind)
    )
    t = (len(plain) - 1) / cube.file.rate_hz
    shift = made["object_pose"][-1, :3] - plain["object_pose"][-1, :3]
    # In flight the cube of 0.37 kg is off by a t^2 / 2 with a = 1 m/s^2; semi-implicit Euler adds half a step.
    assert shift == pytest.approx([t * t / 2, 0, 0], rel=0.02, abs=1e-6)


def test_lost_commands_are_held(hand):
    loss = OutsideCause(name="command_loss", acts_on="joint", values={"often": 1.0, "burst_rows": 1e9, "seed": 1.0})
    made = played(hand, loss)
    assert np.abs(np.diff(made[0]["joint_position"][-20:], axis=0)).max() < 1e-3


def test_another_noise_seed_changes_the_noise_and_not_the_commands(hand):
    first, other = played(hand, None, 1), played(hand, None, 2)
    assert all((a["action"] == b["action"]).all() for a, b in zip(first, other, strict=True))
    assert all((a["joint_position"] != b["joint_position"]).any() for a, b in zip(first, other, strict=True))


def test_an_unknown_cause_lists_those_there_are(hand):
    with pytest.raises(UnknownNameError, match="magnet"):
        draw_outside("magnets", hand, np.random.default_rng(0))
