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

NAMES = effect_names()
PARAMETERS = [(name, p) for name in NAMES for p in effect(name).parameters]
LABELS = [f"{name}-{p.name}" for name, p in PARAMETERS]
SCENES = ("cube_toss", "xhand_tabletop")
FIRST_FIFTEEN = {
    "actuation_delay", "servo_gain", "torque_limit", "joint_dry_friction", "joint_damping", "armature",
    "object_mass", "object_com", "sliding_friction", "contact_compliance", "friction_cone", "gravity_tilt",
    "pose_latency", "tactile_gain", "tactile_bias",
}  # fmt: skip
#: Long enough to grasp and lift; short enough for the hundred worlds below.
DURATION_S = 1.4


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
    found = [EffectSetting(name=name) for name in NAMES]
    plain = [name for name in NAMES if np.isfinite(flatten(EffectSetting(name=name), scene)).all()]
    return found + [setting(name, base(name, scene), scene) for name in plain]


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


def play(scene, worlds):
    """What `n` worlds read while they play the same grasp."""
    plan = policy("grasp_lift_shake").plan(scene, np.random.default_rng(5), DURATION_S)
    n = len(worlds)
    tile = [np.repeat(a[None], n, axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    return rollout(scene, *tile, worlds).readings


@pytest.fixture(scope="module")
def played(hand):
    """Readings of the nominal world (row 0), of all probes, and the probes' settings."""
    settings = [s for name in NAMES for s in probes(name, hand)]
    return settings, play(hand, [(), *((s,) for s in settings)])


def test_the_first_fifteen_are_there():
    assert set(NAMES) >= FIRST_FIFTEEN


def test_the_identity_changes_nothing_bit_for_bit(hand):
    some = identities(hand)
    for channel, value in play(hand, [(), *((s,) for s in some)]).items():
        for row, given in enumerate(some, start=1):
            assert np.array_equal(value[row], value[0]), f"{given.name} moves {channel}"


@pytest.mark.parametrize("name", NAMES)
def test_every_probe_moves_a_channel(played, name):
    settings, readings = played
    rows = [i + 1 for i, s in enumerate(settings) if s.name == name]
    assert rows
    for row in rows:
        assert any(not np.array_equal(v[row], v[0]) for v in readings.values()), settings[row - 1]


@pytest.mark.parametrize("name", NAMES)
def test_a_reading_effect_moves_only_what_it_says(played, name):
    settings, readings = played
    moves = effect(name).moves
    for row in (i + 1 for i, s in enumerate(settings) if s.name == name and moves):
        assert {c for c, v in readings.items() if not np.array_equal(v[row], v[0])} <= set(moves)


def test_worlds_are_deterministic_and_do_not_see_their_neighbours(hand, played):
    settings, readings = played
    rows = list(range(0, len(settings), 7))
    again = play(hand, [(settings[row],) for row in rows])
    for channel, value in again.items():
        assert np.array_equal(value, readings[channel][[row + 1 for row in rows]]), channel


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
def test_a_value_out_of_bounds_is_refused(hand, name, parameter):
    low, high = parameter.bounds(hand)
    size = parameter.size(hand)
    for value in (low - 1e-3 * (high - low), high + 1e-3 * (high - low), float("nan")):
        given = tuple([value] * size) if size > 1 else value
        with pytest.raises(UsageError) as caught:
            flatten(EffectSetting(name=name, parameters={parameter.name: given}), hand)
        assert str(caught.value).startswith(
            f"{name}: {parameter.name} is not possible in scene xhand_tabletop\n"
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


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_that_cannot_act_is_refused(name):
    scene = load_scene("cube_toss")
    if effect(name).possible(scene):
        build_worlds(scene, [(EffectSetting(name=name),)])
    else:
        with pytest.raises(UsageError, match=f"effect {name} cannot act in scene cube_toss"):
            build_worlds(scene, [(EffectSetting(name=name),)])
