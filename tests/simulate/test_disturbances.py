"""Noise on commands and kicks: drawn by seed and number, seen in the motion, kept in the episode."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.schema.disturbance import Disturbances, KickDraw
from candata.schema.randomisation import RandomisationFile
from candata.simulate.generate import generate
from candata.simulate.repetition import repeat_episode

SET = {"scene": "xhand_tabletop", "episodes": 2, "seed": 3, "duration_s": 1.0, "workers": 1, "noise": False}
OFTEN = {"interval_s": (0.3, 0.4)}


def episodes(out, disturbances: dict | None, **words) -> list:
    drawn = None if disturbances is None else Disturbances.model_validate(disturbances)
    generate(out, **{**SET, **words}, disturbances=drawn)
    return list(open_dataset(out))


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    return episodes(tmp_path_factory.mktemp("calm") / "set", None, policies=["free_sweep"])


def test_a_kick_adds_its_velocity_at_its_time_and_is_kept(tmp_path, calm):
    kicked = episodes(tmp_path / "set", {"object_kicks": {**OFTEN, "speed_m_s": 1.0}}, policies=["free_sweep"])
    for before, after in zip(calm, kicked, strict=True):
        assert not before.meta.kicks
        kick = after.meta.kicks[0]
        row = round(kick.time_s * after.meta.rate_hz)
        moved = np.asarray(after["object_pose"] - before["object_pose"], float)[:, :3]
        np.testing.assert_array_equal(moved[: row + 1], 0)
        # What the table leaves of it: at least its way up, or along.
        speed = moved[row + 1] * after.meta.rate_hz
        assert np.linalg.norm(speed) > 0.3 * np.linalg.norm([*kick.speed_m_s[:2], max(kick.speed_m_s[2], 0)])
        gaps = np.diff([0.0, *(k.time_s for k in after.meta.kicks)])
        assert (gaps >= 0.3).all()
        assert (gaps <= 0.4).all()
    assert kicked[0].meta.kicks != kicked[1].meta.kicks


def test_a_kick_of_the_hand_moves_what_carries_it(tmp_path, calm):
    kicked = episodes(tmp_path / "set", {"hand_kicks": {**OFTEN, "speed_m_s": 1.0}}, policies=["free_sweep"])
    kick = kicked[0].meta.kicks[0]
    row = round(kick.time_s * kicked[0].meta.rate_hz)
    moved = np.asarray(kicked[0]["joint_position"] - calm[0]["joint_position"], float)
    np.testing.assert_array_equal(moved[: row + 1], 0)
    wrist = moved[row + 1, :3]
    assert wrist @ kick.speed_m_s > 0.8 * np.linalg.norm(wrist) * np.linalg.norm(kick.speed_m_s)
    assert np.linalg.norm(wrist) * kicked[0].meta.rate_hz > 0.2 * np.linalg.norm(kick.speed_m_s)
    np.testing.assert_array_equal(kicked[0]["action"], calm[0]["action"])


def test_noise_on_commands_has_its_size(tmp_path, calm):
    noise = {"command_noise": {"joint_rad": 0.01, "hand_m": 0.002}}
    noisy = episodes(tmp_path / "set", noise, policies=["free_sweep"])
    added = np.concatenate([a["action"] - b["action"] for a, b in zip(noisy, calm, strict=True)])
    np.testing.assert_allclose(added[:, :3].std(0), 0.002, rtol=0.2)
    inner = [3, 5]  # joints whose commands stay clear of their limits
    np.testing.assert_allclose(added[:, inner].std(0), 0.01, rtol=0.2)
    assert abs(np.corrcoef(added[1:, 0], added[:-1, 0])[0, 1]) < 0.3, "white"


def test_a_disturbed_episode_is_made_again(tmp_path):
    drawn = {
        "command_noise": {"joint_rad": 0.01},
        "object_kicks": {**OFTEN, "speed_m_s": 0.2, "turn_rad_s": 2},
        "hand_kicks": {**OFTEN, "speed_m_s": 0.2},
    }
    made = episodes(tmp_path / "set", drawn)
    assert {kick.target for e in made for kick in e.meta.kicks} == {"object", "hand"}
    assert repeat_episode(open_dataset(tmp_path / "set"), made[1].meta.id).meta.kicks == made[1].meta.kicks


def test_a_scene_without_a_hand_that_is_carried_gets_no_kick_of_it(tmp_path):
    words = {"scene": "cube_toss", "duration_s": 0.2}
    with pytest.raises(UsageError, match="nothing carries the hand"):
        episodes(tmp_path / "set", {"hand_kicks": {**OFTEN, "speed_m_s": 0.1}}, **words)
    with pytest.raises(UsageError, match="no position servo"):
        episodes(tmp_path / "set", {"command_noise": {"joint_rad": 0.1}}, **words)


@pytest.mark.parametrize(
    "value",
    [
        {"interval_s": (0.5, 0.4), "speed_m_s": 1},
        {"interval_s": (0.0, 0.4), "speed_m_s": 1},
        {"interval_s": (0.3, 0.4)},
        {"interval_s": (0.3, 0.4), "speed_m_s": -1},
        {"interval_s": (1e-7, 1e-6), "speed_m_s": 1},
        {"interval_s": (0.3, 0.4), "speed_m_s": 1e9},
    ],
)
def test_kicks_that_mean_nothing_are_refused(value):
    with pytest.raises(ValidationError):
        KickDraw.model_validate(value)


def test_a_file_that_draws_nothing_is_refused():
    with pytest.raises(ValidationError, match="effects or disturbances"):
        RandomisationFile.model_validate({"disturbances": {}})
