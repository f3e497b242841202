"""Every effect of the folder keeps the contract, whatever it is."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import effect, effect_names, flatten, setting
from candata.errors import UnknownNameError, UsageError
from candata.policies import policy
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import rollout
from candata.simulate.seal import draw_parameter
from candata.simulate.world import build_worlds
from tests.effects.gripper import play_grip

NAMES = effect_names()
PARAMETERS = [(name, p) for name in NAMES for p in effect(name).parameters]
LABELS = [f"{name}-{p.name}" for name, p in PARAMETERS]
SCENES = ("cube_toss", "xhand_tabletop")
#: The table of the design, whole.
FIXED_NAMES = {
    "actuation_delay", "servo_gain", "servo_damping", "torque_limit", "backlash", "joint_offset",
    "joint_dry_friction", "joint_damping", "armature",
    "object_mass", "object_com", "object_size", "object_inertia",
    "sliding_friction", "torsional_friction", "rolling_friction", "anisotropic_friction", "contact_compliance",
    "contact_damping",
    "friction_cone", "impratio", "integrator", "time_step", "solimp_width",
    "gravity_tilt", "support_height",
    "pose_latency", "pose_bias", "pose_rotation_bias", "pose_scale", "tactile_gain", "tactile_bias",
    "tactile_dead_band", "tactile_lag", "clock_drift",
}  # fmt: skip
#: Long enough to grasp and lift; short enough for the hundred worlds below.
DURATION_S = 1.4


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
    """What worlds read while they play the same grasp."""
    if scene.name != "xhand_tabletop":
        return play_grip(scene, worlds, **options).readings
    plan = policy("grasp_lift_shake").plan(scene, np.random.default_rng(5), DURATION_S)
    n = len(worlds)
    tile = [np.repeat(a[None], n, axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    return rollout(scene, *tile, worlds, **options).readings


@pytest.fixture(scope="module", params=["hand", "gripper"])
def world(request):
    """A scene with contacts of geoms, and one with explicit contact pairs."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def played(world):
    """Readings of the nominal world (row 0), of all probes, and the probes' settings."""
    settings = [s for name in possible(world) for s in probes(name, world)]
    return settings, play(world, [(), *((s,) for s in settings)])


def rows_of(name: str, settings) -> list[int]:
    """Rows of an effect's probes; skips where it cannot act."""
    rows = [i + 1 for i, s in enumerate(settings) if s.name == name]
    return rows or pytest.skip("cannot act there")


def test_the_names_of_the_design_are_there():
    assert set(NAMES) >= FIXED_NAMES


def test_every_effect_can_act_where_contacts_are_explicit(gripper):
    assert possible(gripper) == list(NAMES)


def test_the_identity_changes_nothing_bit_for_bit(world):
    some = identities(world)
    for channel, value in play(world, [(), *((s,) for s in some)]).items():
        for row, given in enumerate(some, start=1):
            assert np.array_equal(value[row], value[0]), f"{given.name} moves {channel}"


@pytest.mark.parametrize("name", NAMES)
def test_every_probe_moves_a_channel(played, name):
    settings, readings = played
    for row in rows_of(name, settings):
        assert any(not np.array_equal(v[row], v[0]) for v in readings.values()), settings[row - 1]
        assert all(np.isfinite(v[row]).all() for v in readings.values()), settings[row - 1]


@pytest.mark.parametrize("name", NAMES)
def test_a_reading_effect_moves_only_what_it_says(played, name):
    settings, readings = played
    moves = effect(name).moves
    for row in rows_of(name, settings) if moves else []:
        assert {c for c, v in readings.items() if not np.array_equal(v[row], v[0])} <= set(moves)


def test_worlds_are_deterministic_and_do_not_see_their_neighbours(world, played):
    settings, readings = played
    rows = list(range(0, len(settings), 7))
    again = play(world, [(settings[row],) for row in rows])
    for channel, value in again.items():
        assert np.array_equal(value, readings[channel][[row + 1 for row in rows]]), channel


@pytest.mark.parametrize("name", ["time_step", "clock_drift", "backlash", "joint_offset", "integrator"])
def test_a_world_alone_is_the_world_in_company(world, played, name):
    settings, readings = played
    row = rows_of(name, settings)[-1]
    for channel, value in play(world, [(settings[row - 1],)], threads=2).items():
        assert np.array_equal(value[0], readings[channel][row]), channel


@pytest.mark.parametrize("name", NAMES)
def test_neutral_is_what_the_scene_has(world, name):
    if not effect(name).possible(world):
        pytest.skip("cannot act there")
    for p in effect(name).parameters:
        assert (p.neutral is None) == np.isfinite(p.identity(world)), "one of the two"
        own = p.neutral(world) if p.neutral else p.identity(world)
        low, high = p.bounds(world)
        assert low <= own <= high
        assert own not in p.probes(world)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("name", NAMES)
def test_setting_and_vector_are_two_views_of_one_thing(scene, name, rng):
    model = load_scene(scene)
    if not effect(name).possible(model):
        pytest.skip("cannot act there")
    x = np.concatenate([draw_parameter(p, model, rng) for p in effect(name).parameters])
    given = setting(name, x, model)
    assert np.array_equal(flatten(given, model), x)
    assert EffectSetting.model_validate_json(given.model_dump_json()) == given


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS, ids=LABELS)
@pytest.mark.parametrize("scene", SCENES)
def test_draws_and_probes_lie_within_the_bounds(scene, name, parameter, rng):
    model = load_scene(scene)
    if not effect(name).possible(model):
        pytest.skip("cannot act there")
    low, high = parameter.bounds(model)
    drawn = np.concatenate([draw_parameter(parameter, model, rng) for _ in range(30)])
    for values in (drawn, np.array(parameter.probes(model)), np.ravel(parameter.draws(model))):
        assert ((low <= values) & (values <= high)).all()
    identity = parameter.identity(model)
    assert np.isnan(identity) or low <= identity <= high
    assert parameter.source


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS, ids=LABELS)
def test_a_value_out_of_bounds_is_refused(gripper, name, parameter):
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


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_can_be_asked_about_any_scene(name):
    scene = load_scene("cube_toss")
    for p in effect(name).parameters:
        own = p.neutral(scene) if p.neutral else p.identity(scene)
        assert np.isfinite([own, *p.bounds(scene), *p.probes(scene), *np.ravel(p.draws(scene))]).all()
    assert isinstance(effect(name).possible(scene), bool)


def test_a_wrong_parameter_lists_the_known(hand):
    with pytest.raises(UnknownNameError, match="kp_scale"):
        flatten(EffectSetting(name="servo_gain", parameters={"kp": 2.0}), hand)


def test_a_wrong_word_lists_the_choices(hand):
    with pytest.raises(UnknownNameError, match="elliptic, pyramidal"):
        flatten(EffectSetting(name="friction_cone", parameters={"cone": "round"}), hand)


def test_a_wrong_size_is_refused(hand):
    with pytest.raises(UsageError, match=r"3 number\(s\)"):
        flatten(EffectSetting(name="object_com", parameters={"offset_m": (0.01, 0.0)}), hand)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_that_cannot_act_is_refused(name):
    scene = load_scene("cube_toss")
    if effect(name).possible(scene):
        build_worlds(scene, [(EffectSetting(name=name),)])
    else:
        with pytest.raises(UsageError, match=f"effect {name} cannot act in scene cube_toss"):
            build_worlds(scene, [(EffectSetting(name=name),)])
