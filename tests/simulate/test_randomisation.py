"""Effects drawn for each episode: by seed and number alone, within their ranges, kept in the episode."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.effects import flatten
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.schema.randomisation import RandomEffect, RandomisationFile
from candata.schema.scene import Noise, Tracker
from candata.simulate.generate import Withheld, generate
from candata.simulate.randomisation import check_randomisation, drawn_effects
from candata.simulate.repetition import repeat_episode

TOSS = {"scene": "cube_toss", "episodes": 18, "seed": 7, "duration_s": 0.2}
#: Draws from which shares and means are taken.
DRAWS = 2000


def effect_of(name, share=1.0, element=None, **parameters) -> RandomEffect:
    return RandomEffect.model_validate({"name": name, "element": element, "share": share, "parameters": parameters})


MASS = effect_of("object_mass", mass_scale={"uniform": [0.7, 1.5]})
SOMETIMES = effect_of("sliding_friction", share=0.3, scale={"choice": [0.5, 2.0]})


@pytest.fixture(scope="module")
def toss():
    return load_scene("cube_toss")


@pytest.fixture(scope="module")
def gripper():
    return load_scene("gripper_tabletop")


def draws(scene, effect, count=DRAWS) -> list[EffectSetting]:
    """The settings of one effect over many episodes, where it is there."""
    return [setting for index in range(count) for setting in drawn_effects([effect], scene, 1, index)]


def test_each_episode_keeps_its_draw_and_is_simulated_with_it(tmp_path):
    # A tilt is seen in flight already.
    tilt = effect_of("gravity_tilt", tilt_x_rad={"normal": [0.0, 0.05]})
    generate(tmp_path / "set", **TOSS, randomisation=[tilt, SOMETIMES], workers=1)
    episodes = list(open_dataset(tmp_path / "set"))
    assert len({e.meta.effects[0].parameters["tilt_x_rad"] for e in episodes}) == 18
    assert {len(e.meta.effects) for e in episodes} == {1, 2}
    # A set of one episode's draw, the same seed: that episode bit for bit, and no other.
    generate(tmp_path / "plain", **{**TOSS, "episodes": 3}, effects=episodes[2].meta.effects, workers=1)
    plain = list(open_dataset(tmp_path / "plain"))
    is_same = [np.array_equal(a["object_pose"], b["object_pose"]) for a, b in zip(episodes[:3], plain, strict=True)]
    assert is_same == [False, False, True]


def test_neither_workers_nor_the_length_of_a_set_change_a_draw(tmp_path):
    first = generate(tmp_path / "one", **TOSS, randomisation=[MASS, SOMETIMES], workers=1)
    second = generate(tmp_path / "two", **TOSS, randomisation=[MASS, SOMETIMES], workers=2)
    assert first.digest == second.digest
    generate(tmp_path / "grown", **{**TOSS, "episodes": 3}, randomisation=[MASS, SOMETIMES], workers=1)
    grown = generate(tmp_path / "grown", **TOSS, randomisation=[MASS, SOMETIMES], workers=1)
    assert grown.digest == first.digest


def test_a_set_of_objects_is_randomised_too(tmp_path):
    sizes = effect_of("object_size", scale={"normal": [1.0, 0.05]})
    generate(tmp_path / "set", **{**TOSS, "episodes": 2}, objects=("can",), randomisation=[sizes], workers=1)
    first, second = open_dataset(tmp_path / "set")
    assert first.meta.object == "can"
    assert first.meta.effects != second.meta.effects


def test_another_randomisation_under_the_same_ids_is_refused(tmp_path):
    short = {**TOSS, "episodes": 2, "workers": 1}
    generate(tmp_path / "set", **short, randomisation=[MASS])
    with pytest.raises(UsageError, match="made from another configuration"):
        generate(tmp_path / "set", **short, randomisation=[SOMETIMES])


def test_an_effect_that_is_added_changes_no_other_draw(toss):
    for index in range(20):
        alone = drawn_effects([MASS], toss, 3, index)
        assert drawn_effects([MASS, SOMETIMES], toss, 3, index)[:1] == alone
        assert drawn_effects([MASS], toss, 4, index) != alone


def test_a_share_is_the_probability_that_an_effect_is_there(toss):
    # Three standard errors of 2000 draws of probability 0.3 are 0.031.
    assert len(draws(toss, SOMETIMES)) / DRAWS == pytest.approx(0.3, abs=0.031)
    assert draws(toss, effect_of("object_mass", share=0.0, mass_scale=1.5)) == []


def test_distributions_are_what_they_say(toss):
    uniform = np.array([s.parameters["mass_scale"] for s in draws(toss, MASS)])
    assert (uniform.min() >= 0.7, uniform.max() <= 1.5) == (True, True)
    # Four standard errors: 0.8 / sqrt(12 * 2000) of the uniform mean, 0.1 / sqrt(2000) of the normal one.
    assert uniform.mean() == pytest.approx(1.1, abs=0.021)
    normal = np.array(
        [s.parameters["mass_scale"] for s in draws(toss, effect_of("object_mass", mass_scale={"normal": [1.0, 0.1]}))]
    )
    assert normal.mean() == pytest.approx(1.0, abs=0.009)
    assert normal.std() == pytest.approx(0.1, abs=0.007)
    assert {s.parameters["scale"] for s in draws(toss, SOMETIMES)} == {0.5, 2.0}
    assert {s.parameters["mass_scale"] for s in draws(toss, effect_of("object_mass", mass_scale=1.5), 3)} == {1.5}


def test_a_normal_distribution_is_cut_to_the_range_of_the_effect(gripper):
    friction = effect_of("joint_dry_friction", element="left_end", frictionloss_Nm={"normal": [0.0, 0.02]})
    settings = draws(gripper, friction, 200)
    assert {s.element for s in settings} == {"left_end"}
    values = np.concatenate([flatten(s, gripper) for s in settings])
    # The lower half is redrawn, not moved to the bound: half a normal distribution has the mean 0.8 sd.
    assert (values > 0).all()
    assert values.mean() == pytest.approx(0.02 * np.sqrt(2 / np.pi), rel=0.25)


def test_each_number_of_a_vector_is_drawn_on_its_own(gripper):
    (setting,) = drawn_effects([effect_of("pose_bias", bias_m={"uniform": [-0.002, 0.002]})], gripper, 1, 0)
    assert len(set(setting.parameters["bias_m"])) == 3
    offset = effect_of("joint_offset", element="left_end", offset_rad={"normal": [0.0, 0.01]})
    (setting,) = drawn_effects([offset], gripper, 1, 0)
    assert isinstance(setting.parameters["offset_rad"], float)


def test_words_are_chosen(gripper):
    cone = effect_of("friction_cone", cone={"choice": ["pyramidal", "elliptic"]})
    check_randomisation([cone], gripper)
    assert {s.parameters["cone"] for s in draws(gripper, cone, 20)} == {"pyramidal", "elliptic"}


@pytest.mark.parametrize(
    ("effect", "error", "text"),
    [
        (effect_of("object_mas", mass_scale=1.5), UnknownNameError, "did you mean 'object_mass'"),
        (effect_of("object_mass", mass=1.5), UnknownNameError, "one of mass_scale"),
        (effect_of("object_mass", element="left_end", mass_scale=1.5), UsageError, "object_mass has no elements"),
        (
            effect_of("armature", element="elbow", armature_kgm2=0.01),
            UnknownNameError,
            "unknown joint or group 'elbow'",
        ),
        (
            effect_of("object_mass", mass_scale={"uniform": [0.5, 90]}),
            UsageError,
            "mass_scale is not possible in scene",
        ),
        (
            effect_of("object_mass", mass_scale={"choice": [1.0, -2.0]}),
            UsageError,
            "mass_scale is not possible in scene",
        ),
        (effect_of("object_mass", mass_scale=-1.0), UsageError, "mass_scale is not possible in scene"),
        (effect_of("friction_cone", cone={"uniform": [0, 1]}), UsageError, r"choice: \[pyramidal, elliptic\]"),
        (effect_of("friction_cone", cone={"choice": ["round"]}), UnknownNameError, "one of elliptic, pyramidal"),
    ],
)
def test_what_cannot_be_drawn_is_one_clear_error(gripper, effect, error, text):
    with pytest.raises(error, match=text):
        check_randomisation([effect], gripper)


def test_an_effect_that_cannot_act_in_the_scene_is_refused(toss):
    with pytest.raises(UsageError, match="effect armature cannot act in scene cube_toss"):
        check_randomisation([effect_of("armature", share=0.0, armature_kgm2=0.01)], toss)


def test_a_normal_distribution_that_never_meets_the_range_leaves_nothing_behind(tmp_path):
    far = effect_of("object_mass", share=0.2, mass_scale={"normal": [-5.0, 0.01]})
    with pytest.raises(UsageError) as caught:
        generate(tmp_path / "set", **TOSS, randomisation=[far])
    assert str(caught.value).startswith("object_mass: no draw of mass_scale is possible in scene cube_toss\n")
    assert "1,000 draws outside, of normal: [-5, 0.01]" in str(caught.value)
    assert not (tmp_path / "set").exists()


def test_drawn_effects_mix_with_no_others(tmp_path):
    given = EffectSetting(name="object_mass", parameters={"mass_scale": 1.5})
    with pytest.raises(UsageError, match="effects and a randomisation at once"):
        generate(tmp_path / "set", **TOSS, effects=[given], randomisation=[MASS])
    with pytest.raises(UsageError, match="a randomisation and a withheld effect at once"):
        generate(tmp_path / "set", **TOSS, randomisation=[MASS], withheld=Withheld("any", tmp_path / "seal.json"))
    assert list(tmp_path.iterdir()) == []


def test_so_many_effects_act_together_as_the_file_says(gripper):
    file = RandomisationFile.model_validate(
        {
            "together": [1, 2],
            "effects": [
                {"name": "object_mass", "parameters": {"mass_scale": 1.5}},
                {"name": "sliding_friction", "parameters": {"scale": 0.5}},
                {"name": "servo_gain", "parameters": {"kp_scale": 0.7}},
            ],
        }
    )
    drawn = [drawn_effects(file.effects, gripper, 1, index, file.together) for index in range(600)]
    sizes = np.array([len(effects) for effects in drawn])
    # Four standard errors of 600 draws of probability 0.5 are 0.082; each effect acts in half of the episodes.
    assert set(sizes) == {1, 2}
    assert (sizes == 1).mean() == pytest.approx(0.5, abs=0.082)
    for effect in file.effects:
        share = np.mean([effect.name in [s.name for s in effects] for effects in drawn])
        assert share == pytest.approx(0.5, abs=0.082)


@pytest.mark.parametrize(
    ("together", "share", "error"),
    [([2, 1], 1.0, "at most 1 effects"), ([0, 2], 1.0, "at most 1 effects"), ([1, 1], 0.5, "together and share")],
)
def test_numbers_of_effects_that_cannot_be_are_refused(together, share, error):
    mass = {"name": "object_mass", "share": share, "parameters": {"mass_scale": 1.5}}
    with pytest.raises(UsageError, match=error):
        RandomisationFile.parse({"together": together, "effects": [mass]}, "the file")


def test_the_noise_of_a_set_may_be_another_than_the_scenes(tmp_path):
    set_options = {"scene": "cube_toss", "episodes": 1, "seed": 1, "duration_s": 0.3, "workers": 1}
    slow = Noise(tracker=Tracker(rate_hz=15, delay_s=0.05))
    generate(tmp_path / "quiet", **set_options, noise=False)
    generate(tmp_path / "slow", **set_options, noise=slow)
    (quiet,), (tracked,) = (list(open_dataset(tmp_path / name)) for name in ("quiet", "slow"))
    rows = len(np.unique(tracked.arrays["object_pose"], axis=0))
    assert rows < len(np.unique(quiet.arrays["object_pose"], axis=0)) / 4
    again = repeat_episode(open_dataset(tmp_path / "slow"), tracked.meta.id)
    np.testing.assert_array_equal(again.arrays["object_pose"], tracked.arrays["object_pose"])
