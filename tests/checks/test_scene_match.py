"""Units, orders and rates against the scene: the words of each error, and silence where worlds differ in physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.checks import defects
from candata.gap.blind.draws import draw_labels
from candata.scenes import load_scene
from candata.schema.episode import Episode
from tests.checks.conftest import simulated

SET = ("scene_match",)


def changed(raws, share=1, **columns):
    """Stored episodes with channels multiplied, in every `share`-th."""
    for i, raw in enumerate(raws):
        some = {n: (raw.arrays[n] * f).astype(raw.arrays[n].dtype) for n, f in columns.items() if i % share == 0}
        yield defects.with_arrays(raw, {**raw.arrays, **some})


@pytest.fixture(scope="module")
def raws(light):
    return [defects.as_stored(e) for e in light]


MILLIMETRES = np.r_[[1e3] * 3, [1] * 4]


@pytest.mark.parametrize(
    ("columns", "words", "fix"),
    [
        ({"joint_position": 180 / np.pi}, ("joint_position looks like degrees", "57.3 times what fits"), ": deg}"),
        ({"action": 180 / np.pi}, ("action looks like degrees", "57.3 times what fits"), ": deg}"),
        ({"joint_position": 1e3}, ("looks like milliradians", "1000 times what fits"), ": mrad}"),
        ({"fingertip_force": 1 / 9.80665}, ("not in newton", "(kgf: 0.102)"), "{fingertip_force: kgf}"),
        ({"fingertip_force": 1 / 9.80665e-3}, ("not in newton", "(gf: 102)"), "{fingertip_force: gf}"),
        ({"fingertip_force": 1e3}, ("not in newton", "(mN: 1000)"), "{fingertip_force: mN}"),
        ({"object_pose": MILLIMETRES}, ("looks like millimetres", "1000 times what fits"), "{object_pose: mm}"),
        (
            {"object_pose": MILLIMETRES ** (2 / 3)},
            ("looks like centimetres", "100 times what fits"),
            "{object_pose: cm}",
        ),
    ],
)
@pytest.mark.parametrize("share", [1, 2])
def test_a_unit_is_named_with_its_factor_and_the_episodes(raws, light_scene, judged, columns, words, fix, share):
    found = judged(changed(raws, share, **columns), light_scene, SET)[0]
    assert found.level == "error"
    assert set(columns) == {found.channel}
    assert words[0].replace("not in", "of some episodes is not in" if share == 2 else "not in") in found.message
    assert fix in found.remedy
    assert share == 1 or "episodes looked at" in found.message
    # What a group of episodes reads beside another is said as their ratio.
    assert words[1] in found.message or (share == 2 and words[1][1:].split(":")[0] in found.message)


def test_joints_and_commands_that_are_both_in_degrees_are_found_by_their_ranges(raws, light_scene, judged):
    both = changed(raws, joint_position=180 / np.pi, action=180 / np.pi)
    found = {f.channel: f for f in judged(both, light_scene, SET) if "degrees" in f.message}
    assert set(found) == {"joint_position", "action"}
    assert found["joint_position"].remedy.endswith("and look at action too")


def test_one_wild_row_is_no_unit(raws, light_scene, judged):
    array = raws[0].arrays["joint_position"].copy()
    array[30] = 500.0
    spike = defects.with_arrays(raws[0], {**raws[0].arrays, "joint_position": array})
    assert not [f for f in judged([spike, *raws[1:]], light_scene, SET) if f.level == "error"]


@pytest.mark.parametrize(("factor", "words"), [(2.0, "100 Hz, 2 times that"), (0.5, "25 Hz, 0.5 times that")])
def test_a_rate_that_is_not_the_scenes_says_its_factor(light, light_scene, judged, factor, words):
    meta = [e.meta.model_copy(update={"rate_hz": factor * e.meta.rate_hz}) for e in light]
    arrays = [dict(e.arrays) | {"time_ns": (e["time_ns"] / factor).astype(np.int64)} for e in light]
    raws = [defects.as_stored(Episode(m, a)) for m, a in zip(meta, arrays, strict=True)]
    assert words in judged(raws, light_scene, SET)[0].message


@pytest.mark.parametrize("factor", [2.0, 0.5, 1e-6])
def test_a_rate_that_is_not_the_stamps_is_an_error_without_a_scene(raws, judged, factor):
    rng = np.random.default_rng(0)
    found = judged([defects.with_defect(r, "stamps_scaled", rng, factor) for r in raws], rules=["time"])
    assert {f.level for f in found} == {"error"}
    assert all(("another unit of time" if factor < 0.1 else "2 times as") in f.message for f in found)


def test_every_other_episode_is_seen_in_a_set_of_any_size(light_scene, judged):
    """Of 24 episodes twelve are played: evenly spaced, they would be all those that are exchanged, or none."""
    many = simulated(light_scene, 24, duration_s=1.2)
    rng = np.random.default_rng(0)
    for odd in (0, 1):
        mixed = [
            defects.with_defect(e, "joints_exchanged", rng) if i % 2 == odd else defects.as_stored(e)
            for i, e in enumerate(many)
        ]
        (found,) = [f for f in judged(mixed, light_scene, SET) if f.level == "error"]
        assert "right_end" not in found.message
        assert "thumb_base follows the command of thumb_end" in found.message
        assert "of 12 episodes looked at" in found.message


def test_a_scene_of_other_joints_is_not_compared(raws, judged):
    assert judged(raws, load_scene("xhand_tabletop"), SET) == []


def test_without_a_scene_it_is_not_checked(raws, judged):
    assert judged(raws, None, SET) == []


def test_worlds_with_effects_are_no_contradiction(light_scene, judged):
    labels = draw_labels(light_scene, {"one": 6, "pair": 3, "local": 3}, np.random.default_rng(5))
    for label in labels:
        made = simulated(light_scene, 6, effects=label.effects, duration_s=1.2)
        found = [f for f in judged(map(defects.as_stored, made), light_scene, SET) if f.level == "error"]
        assert found == [], label


def test_forces_of_a_gain_are_no_unit_and_those_of_a_world_with_a_gain_are(raws, light_scene, judged):
    noise = light_scene.file.noise
    assert noise is not None
    quiet = replace(light_scene, file=light_scene.file.model_copy(update={"noise": None}))
    for gain in (0.5, 2.0):
        assert judged(changed(raws, fingertip_force=gain), quiet, SET) == []
