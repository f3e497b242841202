"""Labels of contact: who meets the object whatever the force, and taxels that add up to the fingertip's force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.datasets import open_dataset
from candata.datasets.summary import summarise
from candata.errors import UsageError
from candata.scenes import load_scene
from candata.scenes.labels import with_labels
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout, with_effects
from candata.simulate.contact_labels import NEWTON_PER_COUNT, TAXELS, taxel_counts, taxel_directions
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.generate import generate
from candata.simulate.repetition import repeat_episode

#: A feather rests on the block with 0.1 N, a foot stands on the table with 2 N, a third tip hangs in the air.
XML = """<mujoco><option timestep="0.002"/><worldbody>
<geom name="table" type="plane" size="1 1 .1"/>
<body name="block" pos="0 0 .03"><freejoint/><geom type="box" size=".03 .03 .03" mass=".1"/></body>
<body pos="0 0 .0749"><joint name="feather" type="slide" axis="0 0 1" damping=".1"/>
  <geom name="feather" type="sphere" size=".015" mass=".0102"/></body>
<body pos=".3 0 .0149"><joint name="foot" type="slide" axis="0 0 1" damping="5"/>
  <geom name="foot" type="sphere" size=".015" mass=".204"/></body>
<body name="idle" pos="-.3 0 .5"><joint name="idle" type="slide" axis="0 0 1" stiffness="1000" damping="5"/>
  <geom name="idle_tip" type="sphere" size=".015" mass=".01"/><geom type="sphere" pos="0 0 .03" size=".01"/></body>
</worldbody></mujoco>"""
ROLES = """model: scene.xml
rate_hz: 100
object: block
support: table
joints: [feather, foot, idle]
fingertips: [feather, foot, idle]
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.xml").write_text(XML)
    (tmp_path / "scene.yaml").write_text(ROLES)
    return load_scene(tmp_path / "scene.yaml")


def settled(scene):
    """The last of 40 rows at rest: forces (F, 3), and labels."""
    trajectory = rollout(scene, np.zeros((1, 40, 0)), *at_rest(scene, 1), [()])
    labels = {name: values[0, -1] for name, values in trajectory.labels.items()}
    return trajectory.readings["fingertip_force"][0, -1], labels


def test_collision_hears_a_feather_and_not_the_table(scene):
    force, labels = settled(with_labels(scene))
    assert np.abs(force).sum(axis=1) == pytest.approx([0.1, 2.0, 0.0], abs=0.02)  # a sphere sinks in a little
    assert labels["collision"].tolist() == [True, False, False]


def test_taxels_feel_the_force_where_the_contact_is(scene):
    force, labels = settled(with_labels(scene, True))
    assert labels["taxel_force"].sum(axis=1) == pytest.approx(force, abs=1e-5)  # float32
    pressed = np.abs(labels["taxel_force"][1]).sum(axis=1)
    assert taxel_directions()[pressed.argmax()] @ [0, 0, -1] > 0.95  # the lattice's taxels are 0.3 rad apart
    assert pressed[taxel_directions()[:, 2] > 0].max() < 0.05 * pressed.max()
    assert not labels["taxel_force"][2].any()


@given(
    st.lists(st.floats(-20, 20), min_size=6, max_size=6),
    st.floats(-3, 3),
    st.integers(0, 2**32 - 1),
)
def test_counts_sum_to_the_reading_whatever_was_felt(forces, beyond, seed):
    share = np.random.default_rng(seed).dirichlet(np.full(TAXELS, 0.1), 2)[:, :, None]
    felt = share * np.reshape(forces, (2, 1, 3))
    felt[1] *= seed % 2  # without contact half of the time
    reading = np.reshape(forces, (2, 3)) + beyond
    counts = taxel_counts(felt, reading)
    # half a count, and what float64 leaves of a sum of 120
    assert np.abs(counts.sum(axis=1) * NEWTON_PER_COUNT - reading).max() <= NEWTON_PER_COUNT / 2 + 1e-9


def test_labels_change_no_bit_of_the_motion_and_the_scene_keeps_its_digest():
    scene = load_scene("gripper_tabletop")
    digest, job = scene.digest, EpisodeJob("e", 0, "squeeze", 1)
    options = {"duration_s": 0.6, "noise": scene.file.noise}
    (plain,) = make_episodes(scene, [job], **options)
    (labelled,) = make_episodes(with_labels(scene, True), [job], **options)
    assert set(labelled.arrays) - set(plain.arrays) == {"fingertip_collision", "taxels"}
    assert all(np.array_equal(plain[name], labelled[name]) for name in plain.arrays)
    assert with_labels(scene, True).digest == scene.digest == digest
    assert labelled.meta.newton_per_count == NEWTON_PER_COUNT
    assert labelled["fingertip_collision"].any()
    assert not labelled["fingertip_collision"].all()
    total = labelled["taxels"].sum(axis=2) * labelled.meta.newton_per_count
    assert np.abs(total - labelled["fingertip_force"]).max() <= NEWTON_PER_COUNT / 2 + 1e-5  # forces are float32


def test_worlds_with_other_physics_steps_are_labelled_too():
    scene = with_labels(load_scene("gripper_tabletop"))
    finer = EffectSetting(name="time_step", parameters={"time_step_s": 0.0025})
    jobs = [EpisodeJob(name, 0, "squeeze", 1, effects) for name, effects in (("a", ()), ("b", (finer,)))]
    alone = [make_episodes(scene, [job], duration_s=0.4)[0] for job in jobs]
    together = make_episodes(scene, jobs, duration_s=0.4)
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one["fingertip_collision"], other["fingertip_collision"])
        assert one["fingertip_collision"].any()


def test_a_set_holds_its_labels_and_is_made_again_with_them(tmp_path):
    generate(tmp_path / "set", "gripper_tabletop", 2, 1, duration_s=0.6, policies=("squeeze",), taxels=True, workers=1)
    dataset = open_dataset(tmp_path / "set")
    episode = dataset.episode(dataset.ids[1])
    assert episode["taxels"].shape == (30, 3, TAXELS, 3)
    assert repeat_episode(dataset, dataset.ids[1]).arrays.keys() == episode.arrays.keys()
    summary = summarise(dataset)
    collision = np.concatenate([e["fingertip_collision"] for e in dataset])
    differs = np.concatenate([e["fingertip_collision"] != e["fingertip_contact"] for e in dataset])
    assert list(summary.collision_shares.values()) == pytest.approx(collision.mean(axis=0).tolist())
    assert list(summary.label_disagreements.values()) == pytest.approx(differs.mean(axis=0).tolist())
    assert differs.any()


def test_a_scene_with_given_effects_has_no_labels():
    scene = with_effects(
        load_scene("gripper_tabletop"), [EffectSetting(name="object_mass", parameters={"mass_scale": 2})]
    )
    with pytest.raises(UsageError, match="cannot be labelled"):
        with_labels(scene)
