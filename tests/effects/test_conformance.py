"""Every effect of the folder keeps the contract, whatever it is: alone by its suite, and all together on a hand."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from candata.effects import EFFECTS, effect, effect_names, flatten, setting
from candata.errors import UnknownNameError, UsageError
from candata.policies import policy
from candata.schema.effect import EffectSetting
from candata.simulate import rollout
from candata.testing import EffectConformance
from tests.effects.gripper import play_grip, write_scene
from tests.effects.pan_tilt import play_neck, write_neck
from tests.suites import suites

NAMES = effect_names()
#: The table of the design, whole.
FIXED_NAMES = {
    "actuation_delay",
    "servo_gain",
    "servo_damping",
    "torque_limit",
    "backlash",
    "joint_offset",
    "joint_dry_friction",
    "joint_damping",
    "armature",
    "object_mass",
    "object_com",
    "object_size",
    "object_inertia",
    "sliding_friction",
    "torsional_friction",
    "rolling_friction",
    "anisotropic_friction",
    "contact_compliance",
    "contact_damping",
    "friction_cone",
    "impratio",
    "integrator",
    "time_step",
    "solimp_width",
    "gravity_tilt",
    "support_height",
    "pose_latency",
    "pose_bias",
    "pose_rotation_bias",
    "pose_scale",
    "tactile_gain",
    "tactile_bias",
    "tactile_dead_band",
    "tactile_lag",
    "clock_drift",
}
#: Long enough to grasp and lift; short enough for the hundred worlds below.
DURATION_S = 1.4
with tempfile.TemporaryDirectory() as folder:
    #: A scene whose contacts are explicit pairs: every effect can act in it but those of links, which weigh too little.
    GRIPPER = write_scene(Path(folder))
    #: A scene whose links the drives feel.
    NECK = write_neck(Path(folder))


class OnTheGripper(EffectConformance):
    """Played in two scenes in one of which every effect can act; asked about one in which few can."""

    scenes = (GRIPPER, NECK, "cube_toss")

    def play(self, scene, worlds):
        if scene is NECK:
            return play_neck(scene, worlds)
        return play_grip(scene, worlds).readings if scene is GRIPPER else super().play(scene, worlds)


globals().update(suites(OnTheGripper, EFFECTS, "effect"))


def possible(scene) -> list[str]:
    """The effects that can act in a scene."""
    return [name for name in NAMES if effect(name).possible(scene)]


def base(name: str, scene) -> np.ndarray:
    """The effect's vector at the identity, zero where it replaces the model's values."""
    return np.nan_to_num(flatten(EffectSetting(name=name), scene))


def probes(name: str, scene) -> list[EffectSetting]:
    """One setting a probe value and component, the others at the identity."""
    found, start = [], 0
    for p in effect(name).parameters:
        for component in range(p.size(scene)):
            for value in p.probes(scene):
                x = flatten(EffectSetting(name=name), scene)
                x[start + component] = value
                found.append(setting(name, x, scene))
        start += p.size(scene)
    return found


def identities(scene) -> list[EffectSetting]:
    """Every effect without parameters, and spelled out at its identity where it has one."""
    names = possible(scene)
    found = [EffectSetting(name=name) for name in names]
    plain = [name for name in names if np.isfinite(flatten(EffectSetting(name=name), scene)).all()]
    return found + [setting(name, base(name, scene), scene) for name in plain]


def play(scene, worlds, **options):
    """What worlds of the hand read while they play the same grasp."""
    plan = policy("grasp_lift_shake").plan(scene, np.random.default_rng(5), DURATION_S)
    n = len(worlds)
    tile = [np.repeat(a[None], n, axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    return rollout(scene, *tile, worlds, **options).readings


@pytest.fixture(scope="module")
def played(hand):
    """Readings of the nominal world (row 0), of all probes, and the probes' settings."""
    settings = [s for name in possible(hand) for s in probes(name, hand)]
    return settings, play(hand, [(), *((s,) for s in settings)])


def rows_of(name: str, settings) -> list[int]:
    """Rows of an effect's probes; skips where it cannot act."""
    rows = [i + 1 for i, s in enumerate(settings) if s.name == name]
    return rows or pytest.skip("cannot act there")


def test_the_names_of_the_design_are_there():
    assert set(NAMES) >= FIXED_NAMES


def test_the_identity_changes_nothing_bit_for_bit(hand):
    some = identities(hand)
    for channel, value in play(hand, [(), *((s,) for s in some)]).items():
        for row, given in enumerate(some, start=1):
            assert np.array_equal(value[row], value[0]), f"{given.name} moves {channel}"


@pytest.mark.parametrize("name", NAMES)
def test_every_probe_moves_a_channel(played, name):
    settings, readings = played
    for row in rows_of(name, settings):
        assert any(not np.array_equal(v[row], v[0]) for v in readings.values()), settings[row - 1]
        assert all(np.isfinite(v[row]).all() for v in readings.values()), settings[row - 1]


def test_worlds_are_deterministic_and_do_not_see_their_neighbours(hand, played):
    settings, readings = played
    rows = list(range(0, len(settings), 7))
    again = play(hand, [(settings[row],) for row in rows])
    for channel, value in again.items():
        assert np.array_equal(value, readings[channel][[row + 1 for row in rows]]), channel


@pytest.mark.parametrize("name", ["time_step", "clock_drift", "backlash", "joint_offset", "integrator"])
def test_a_world_alone_is_the_world_in_company(hand, played, name):
    settings, readings = played
    row = rows_of(name, settings)[-1]
    for channel, value in play(hand, [(settings[row - 1],)], threads=2).items():
        assert np.array_equal(value[0], readings[channel][row]), channel


@pytest.mark.parametrize("name", ["object_mass", "object_com", "integrator"])
def test_a_value_out_of_bounds_is_refused_with_the_bounds(gripper, name):
    (parameter,) = effect(name).parameters
    low, high = parameter.bounds(gripper)
    size = parameter.size(gripper)
    for value in (low - 1e-3 * (high - low), high + 1e-3 * (high - low), float("nan")):
        given = tuple([value] * size) if size > 1 else value
        with pytest.raises(UsageError) as caught:
            flatten(EffectSetting(name=name, parameters={parameter.name: given}), gripper)
        assert str(caught.value).startswith(
            f"{name}: {parameter.name} is not possible in scene {gripper.name}\n"
            f"  expected: {size} number(s) in [{low:g}, {high:g}] {parameter.unit}\n"
        )


def test_a_wrong_parameter_lists_the_known(hand):
    with pytest.raises(UnknownNameError, match="kp_scale"):
        flatten(EffectSetting(name="servo_gain", parameters={"kp": 2.0}), hand)


def test_a_wrong_word_lists_the_choices(hand):
    with pytest.raises(UnknownNameError, match="elliptic, pyramidal"):
        flatten(EffectSetting(name="friction_cone", parameters={"cone": "round"}), hand)


def test_a_wrong_size_is_refused(hand):
    with pytest.raises(UsageError, match=r"3 number\(s\)"):
        flatten(EffectSetting(name="object_com", parameters={"offset_m": (0.01, 0.0)}), hand)
