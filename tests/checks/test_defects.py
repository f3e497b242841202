"""Each defect, injected into clean simulated data, is found by a rule that names it; clean data raise no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from candata.checks import check, defects, rule_names
from candata.datasets import open_dataset
from candata.effects import effect, effect_names
from candata.errors import DataError, UnknownNameError
from candata.scenes import assemble
from candata.scenes.contract import SCENES
from candata.schema.effect import EffectSetting
from tests.checks.conftest import simulated
from tests.checks.test_silent_mistakes import SAID

#: The ten of other validators' test.
TEN = (
    "contact_inverted",
    "force_in_grams",
    "force_late",
    "force_drift",
    "finger_dead",
    "force_saturated",
    "force_nan",
    "pose_in_millimetres",
    "quaternion_not_unit",
    "quaternion_swapped",
)
#: The weakest size at which each is found when all ten episodes of the hand have it, as measured; a rule that gets
#: better moves these.
WEAKEST = {
    "force_in_grams": 10.0,
    "force_late": 0.0125,
    "force_drift": 0.25,
    "force_saturated": 6.0,
    "force_nan": 0.0,
    "pose_in_millimetres": 100.0,
    "quaternion_not_unit": 0.002,
}
#: Defects that the tosses show, and those that take the scene.
TOSS = (
    "pose_in_millimetres",
    "quaternion_not_unit",
    "quaternion_swapped",
    "rows_dropped",
    "time_jump",
    "fall_scaled",
    "pose_lost",
)
WITH_SCENE = ("joint_beyond_limits", "object_sunk", "object_far")
#: Defects that only the scene's own motion tells.
AGAINST_MOTION = (
    "all_in_degrees",
    "commands_in_degrees",
    "force_in_kilograms",
    "tips_exchanged",
    "joints_exchanged",
    "commands_exchanged",
    "stamps_scaled",
)
OTHERS = (
    "joint_dead",
    "rows_dropped",
    "rows_dropped_unseen",
    "time_jump",
    "clock_drift",
    "action_shifted",
    "joint_in_degrees",
    "encoder_spiked",
    "joint_stuck",
    "supply_sagged",
    "torque_off",
)


def rng():
    return np.random.default_rng(0)


def caught(judged, raws, name, scene=None):
    """Rules that find a defect, of those that should."""
    return {f.rule for f in judged(raws, scene=scene, rules=defects.defect(name).rules)}


def test_the_ten_are_there_and_every_defect_names_rules():
    assert set(TEN) <= set(defects.names())
    assert {*TEN, *TOSS, *WITH_SCENE, *AGAINST_MOTION, *OTHERS, *SAID} == set(defects.names())
    for name in defects.names():
        assert set(defects.defect(name).rules) <= set(rule_names())


def test_clean_episodes_raise_no_alarm(hand, tosses, hand_scene, toss_scene, judged):
    for episodes, scene in ((hand, hand_scene), (tosses, toss_scene)):
        assert judged((defects.as_stored(e) for e in episodes), scene=scene) == []


@pytest.mark.parametrize("name", [*TEN, *OTHERS])
def test_a_defect_of_all_episodes_is_found(hand, judged, name):
    assert caught(judged, defects.inject(hand, name, rng()), name)


#: All rules look at whole sets again and again: the fast suite takes three of the ten.
SOME = ("force_late", "finger_dead", "quaternion_swapped")


@pytest.mark.parametrize("name", [*SOME, *(pytest.param(n, marks=pytest.mark.slow) for n in TEN if n not in SOME)])
def test_a_defect_of_three_in_ten_is_found_in_no_other_episode(hand, judged, name):
    raws = list(defects.inject(hand, name, rng(), share=0.3))
    harmed = {raw.id for raw, e in zip(raws, hand, strict=True) if raw.stored_hash != defects.as_stored(e).stored_hash}
    found = judged(raws)
    assert {f.rule for f in found} & set(defects.defect(name).rules)
    assert {f.episode for f in found if f.episode} <= harmed


@pytest.mark.parametrize(("name", "severity"), WEAKEST.items())
def test_the_weakest_that_is_found(hand, judged, name, severity):
    assert caught(judged, defects.inject(hand, name, rng(), severity=severity), name)


@pytest.mark.parametrize("name", ["force_in_grams", "force_late", "force_drift", "finger_dead", "force_saturated"])
def test_it_is_found_where_flags_were_derived_from_the_damaged_forces(hand, judged, name):
    raws = [defects.with_derived_flags(raw) for raw in defects.inject(hand, name, rng())]
    assert caught(judged, raws, name)


@pytest.mark.parametrize("name", TOSS)
def test_a_defect_of_tosses_is_found(tosses, judged, name):
    assert caught(judged, defects.inject(tosses, name, rng()), name)


@pytest.mark.parametrize("name", AGAINST_MOTION)
def test_what_the_scenes_own_motion_contradicts_in_half_of_the_episodes_is_an_error(light, light_scene, judged, name):
    """In all of them: `test_silent_mistakes.py` and `test_scene_match.py`."""
    found = judged(defects.inject(light, name, rng(), share=0.5), light_scene, ["scene_match"])
    assert "error" in {f.level for f in found}


@pytest.mark.parametrize("name", WITH_SCENE)
def test_a_defect_against_the_scene_is_found(hand, hand_scene, judged, name):
    assert caught(judged, defects.inject(hand, name, rng()), name, hand_scene)


@pytest.mark.parametrize("rows", [1.0, 2.0])
def test_commands_logged_a_row_late_are_found_against_the_scene(hand, hand_scene, judged, rows):
    (found,) = judged(defects.inject(hand, "action_shifted", rng(), severity=rows), hand_scene, ["command_lag"])
    assert found.level == "warning"
    # A tenth of a row: lags are read off correlations of noisy speeds.
    assert found.evidence["shift_rows"] == pytest.approx(-rows, abs=0.1)


def test_commands_of_single_episodes_logged_a_row_late_are_found_without_a_scene(hand_scene, judged):
    sweeps = [e for e in simulated(hand_scene, 40, duration_s=1.6) if e.meta.task in ("free_sweep", "push")]
    raws = [defects.as_stored(e) for e in sweeps]
    raws[3] = defects.with_defect(sweeps[3], "action_shifted", rng(), 1.0)
    assert [f.episode for f in judged(raws, rules=["command_lag"])] == [sweeps[3].meta.id]


@pytest.mark.parametrize(
    ("commands", "joints", "found"),
    [
        (180 / np.pi, 180 / np.pi, {"action", "joint_position"}),
        (180 / np.pi, 1.0, {"action"}),
    ],
)
def test_commands_in_degrees_are_found_beside_joints_in_either(hand, judged, commands, joints, found):
    raws = [defects.as_stored(e) for e in hand]
    arrays = raws[2].arrays
    columns = {
        name: (arrays[name] * factor).astype(arrays[name].dtype)
        for name, factor in (("action", commands), ("joint_position", joints))
    }
    raws[2] = defects.with_arrays(raws[2], {**arrays, **columns})
    assert {f.channel for f in judged(raws, rules=["scale"])} == found


def test_commands_for_as_little_motion_as_their_joints_make_are_in_no_other_unit(hand_scene, judged):
    # A push moves the closed fingers 0.03 times as far as a grasp: nearly a degree to a radian.
    late = simulated(hand_scene, 10, effects=[EffectSetting(name="actuation_delay", parameters={"delay_s": 0.015})])
    assert judged(map(defects.as_stored, late), rules=["scale"]) == []


def test_a_duplicate_is_found_and_names_its_original(hand, judged):
    (found,) = judged([*map(defects.as_stored, hand), defects.with_other_id(defects.as_stored(hand[3]), "again")])
    assert (found.rule, found.episode, found.evidence["same_as"]) == ("duplicates", "again", hand[3].meta.id)


def test_a_cut_of_an_episode_is_a_duplicate_too(hand, judged):
    raw = defects.with_other_id(defects.as_stored(hand[0]), "cut")
    cut = defects.with_arrays(raw, {n: a[20:] for n, a in raw.arrays.items()})
    found = judged([*map(defects.as_stored, hand), cut])
    assert [(f.rule, f.episode) for f in found] == [("duplicates", "cut")]


def test_forces_of_the_other_sign_in_the_recorded_half(hand, judged):
    def real(raw):
        raw = defects.with_other_id(raw, f"real-{raw.id}")
        flipped = {**raw.arrays, "fingertip_force": -raw.arrays["fingertip_force"]}
        return defects.with_arrays(raw, flipped, raw.meta_json.replace('"source":"sim"', '"source":"real"'))

    raws = [defects.as_stored(e) for e in hand]
    other = [defects.as_stored(e) for e in simulated_again(hand)]
    (found,) = judged([*raws, *map(real, other)], rules=["conventions", "duplicates", "schema"])
    assert (found.rule, found.problem) == ("conventions", "forces have the other sign")


def simulated_again(hand):
    """The same motions with other noise: not duplicates."""
    noise = np.random.default_rng(3)
    for episode in hand:
        arrays = dict(episode.arrays)
        arrays["joint_position"] = arrays["joint_position"] + noise.normal(0, 1e-4, arrays["joint_position"].shape)
        yield type(episode)(episode.meta, arrays)


def test_gaps_that_are_flagged_raise_no_alarm(hand, judged):
    raws = []
    for raw in defects.inject(hand, "force_nan", rng()):
        valid = np.isfinite(raw.arrays["fingertip_force"]).all(axis=(1, 2))
        raws.append(defects.with_arrays(raw, {**raw.arrays, "fingertip_force_valid": valid}))
    assert judged(raws) == []


@pytest.mark.parametrize(
    "keep", [("object_pose",), ("joint_position", "action"), ("fingertip_force", "joint_position")]
)
def test_fewer_channels_raise_no_alarm(hand, judged, keep):
    raws = (defects.as_stored(e) for e in hand)
    some = [defects.with_arrays(r, {n: a for n, a in r.arrays.items() if n in ("time_ns", *keep)}) for r in raws]
    assert judged(some) == []


@pytest.mark.parametrize("rate_hz", [1480 / 40, 1480.0])
def test_tosses_at_other_rates_raise_no_alarm_and_show_the_same(judged, rate_hz):
    scene = at_rate("cube_toss", rate_hz)
    episodes = simulated(scene, 12)
    assert judged(map(defects.as_stored, episodes), scene=scene) == []
    for name in ("pose_in_millimetres", "quaternion_not_unit", "quaternion_swapped"):
        assert caught(judged, defects.inject(episodes, name, rng()), name), name


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [400 / 13, 400.0])
def test_the_hand_at_other_rates_raises_no_alarm_and_shows_the_ten(judged, rate_hz):
    scene = at_rate("xhand_tabletop", rate_hz)
    episodes = simulated(scene, 10)
    assert judged(map(defects.as_stored, episodes), scene=scene) == []
    for name in TEN:
        assert caught(judged, defects.inject(episodes, name, rng()), name), name


def at_rate(name, rate_hz):
    builtin = SCENES.load(name)
    file = builtin.file.model_copy(update={"rate_hz": rate_hz})
    return assemble.assemble(name, file, builtin.build(), builtin.policies)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["hand_scene", "toss_scene"])
def test_mild_effects_are_no_defects(request, judged, which):
    scene = request.getfixturevalue(which)
    for name in effect_names():
        if effect(name).possible(scene):
            episodes = simulated(scene, 10, effects=[mild(name, scene)])
            assert judged(map(defects.as_stored, episodes), scene=scene) == [], name


def mild(name, scene):
    """The effect at a quarter of the way to its largest probe."""
    values = {}
    for p in effect(name).parameters:
        own = p.neutral(scene) if p.neutral else p.identity(scene)
        probe = p.probes(scene)[-1]
        value = probe if p.choices or p.enumerated else own + 0.25 * (probe - own)
        if p.choices:
            values[p.name] = p.choices[int(value)]
        else:
            values[p.name] = float(value) if p.size(scene) == 1 else (float(value),) * p.size(scene)
    return EffectSetting(name=name, parameters=values)


def test_what_is_written_is_what_was_injected(tmp_path, hand):
    root = defects.write(tmp_path / "bad", defects.inject(hand[:3], "quaternion_not_unit", rng(), share=0.3))
    found = [f for f in check(open_dataset(root), deep=True, rules=["hashes", "quaternions"])]
    assert [f.rule for f in found] == ["quaternions"]


def test_the_source_is_left_as_it_is(hand):
    before = [defects.as_stored(e).stored_hash for e in hand]
    for name in TEN:
        list(defects.inject(hand, name, rng()))
    assert [defects.as_stored(e).stored_hash for e in hand] == before


def test_a_wrong_name_and_a_missing_channel_are_errors(tosses):
    with pytest.raises(UnknownNameError, match="force_late"):
        list(defects.inject(tosses, "force_lat", rng()))
    with pytest.raises(DataError, match="no fingertip_force"):
        list(defects.inject(tosses, "force_late", rng()))
