"""An episode is made again bit for bit from what is kept of it; what keeps it from being so is named."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from candata.datasets import append, create_dataset, get_cloud, open_dataset, put_cloud
from candata.datasets.merging import merge
from candata.errors import DataError, UsageError
from candata.scenes import load_scene
from candata.scenes.object_making import ObjectSource, make_object
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata.schema.randomisation import RandomEffect
from candata.simulate.generate import Withheld, generate
from candata.simulate.repetition import repeat_episode, store_repeated

TILT = RandomEffect.model_validate(
    {"name": "gravity_tilt", "share": 0.7, "parameters": {"tilt_x_rad": {"normal": [0.0, 0.05]}}}
)
TOSS = {"scene": "cube_toss", "episodes": 3, "seed": 7, "duration_s": 0.2, "workers": 1}


@pytest.fixture(scope="module")
def tosses(tmp_path_factory):
    """Three tosses, each with its own tilt."""
    folder = tmp_path_factory.mktemp("repetition") / "set"
    generate(folder, **TOSS, randomisation=[TILT])
    return open_dataset(folder)


def same(first: Episode, second: Episode) -> bool:
    """Whether two episodes hold the same bits and say the same."""
    arrays = all(np.array_equal(first[name], second[name]) for name in first.arrays)
    return arrays and first.arrays.keys() == second.arrays.keys() and first.meta == second.meta


def stored(path, dataset, change=lambda arrays: arrays, **steps) -> object:
    """A copy of a dataset with other values, or another lineage."""
    (step,) = dataset.lineage
    lineage = step.model_copy(update=steps)
    episodes = [Episode(e.meta, change(dict(e.arrays))) for e in dataset]
    append(create_dataset(path), episodes, lineage)
    return open_dataset(path)


def test_every_episode_of_a_mixed_set_is_made_again(tmp_path):
    generate(tmp_path / "set", "gripper_tabletop", 5, 3, duration_s=0.3, randomisation=[TILT], workers=1)
    data = open_dataset(tmp_path / "set")
    assert len({e.meta.task for e in data}) == 5
    for name in data.ids:
        assert same(repeat_episode(data, name), data.episode(name))


def test_an_episode_without_noise_or_effects_is_made_again(tmp_path):
    generate(tmp_path / "set", **TOSS, noise=False)
    data = open_dataset(tmp_path / "set")
    assert same(repeat_episode(data, data.ids[2]), data.episode(data.ids[2]))


def test_a_merged_set_still_tells_how_its_episodes_were_made(tmp_path, tosses):
    """Both sets have the seed, the scene and the motion; the one whose episode comes out the same is taken."""
    generate(tmp_path / "longer", **{**TOSS, "episodes": 5, "duration_s": 0.3})
    longer = open_dataset(tmp_path / "longer")
    late = [longer.episode(name) for name in longer.ids[3:]]
    append(create_dataset(tmp_path / "late"), late, longer.lineage[0])
    put_cloud(tmp_path / "late", get_cloud(longer.path, late[0].meta.point_cloud))
    merge([open_dataset(tmp_path / "late"), tosses], tmp_path / "both")
    both = open_dataset(tmp_path / "both")
    assert len(both) == 5
    for name in both.ids:
        assert same(repeat_episode(both, name), both.episode(name))


def test_an_object_in_a_folder_is_found_where_it_is_named(tmp_path):
    trimesh.creation.box((0.05, 0.03, 0.02)).export(tmp_path / "block.stl")
    make_object(ObjectSource(tmp_path / "block.stl", "block", 0.1), tmp_path / "block", drops=20)
    block = str(tmp_path / "block")
    generate(tmp_path / "set", **TOSS, objects=("can", block))
    data = open_dataset(tmp_path / "set")
    assert same(repeat_episode(data, data.ids[0]), data.episode(data.ids[0]))
    with pytest.raises(UsageError, match="the object block is no registered one"):
        repeat_episode(data, data.ids[1])
    assert same(repeat_episode(data, data.ids[1], objects=[block]), data.episode(data.ids[1]))


def test_a_policy_file_is_asked_for_and_checked(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    scene = load_scene("gripper_tabletop")
    low, high = scene.model.actuator_ctrlrange[scene.actuator_ids].T
    for name, share in (("half", 0.5), ("other", 0.4)):
        row = low + share * (high - low)
        columns = {n: np.full(20, v) for n, v in zip(scene.file.actuator_names, row, strict=True)}
        pq.write_table(
            pa.table({"time_s": np.arange(20) / scene.file.rate_hz, **columns}), tmp_path / f"{name}.parquet"
        )
    generate(tmp_path / "set", "gripper_tabletop", 2, 1, policy_file=tmp_path / "half.parquet", workers=1)
    data = open_dataset(tmp_path / "set")
    with pytest.raises(UsageError, match="the episode played a policy file, which a dataset does not keep"):
        repeat_episode(data, data.ids[1])
    with pytest.raises(DataError, match="the policy file is not the one that the episode played"):
        repeat_episode(data, data.ids[1], policy_file=tmp_path / "other.parquet")
    assert same(repeat_episode(data, data.ids[1], policy_file=tmp_path / "half.parquet"), data.episode(data.ids[1]))


def test_a_scene_that_has_changed_is_named(tmp_path, user_scene):
    floor = '<geom name="floor" type="plane" size="1 1 .1"/><body name="box" pos="0 0 0.1"><freejoint/>'
    roles = "rate_hz: 100\nobject: box\nsupport: floor\n"
    scene, heavier = (
        user_scene(f'{floor}<geom type="box" mass="{kg}" size=".03 .03 .03"/></body>', roles) for kg in (0.1, 0.2)
    )
    generate(tmp_path / "set", **{**TOSS, "scene": scene.name})
    data = open_dataset(tmp_path / "set")
    assert same(repeat_episode(data, data.ids[0]), data.episode(data.ids[0]))
    with pytest.raises(DataError) as caught:
        repeat_episode(data, data.ids[0], scene=heavier.name)
    said = str(caught.value)
    assert said.startswith("the scene is not the one that the episode was made in\n")
    assert (scene.digest[:12] in said, heavier.digest[:12] in said) == (True, True)
    assert "the versions are the same" in said


def test_an_episode_that_differs_in_one_bit_is_refused_with_what_differs(tmp_path, tosses):
    def nudge(arrays):
        pose = arrays["object_pose"].copy()
        pose[-1, 0] = np.nextafter(pose[-1, 0], np.float32(9), dtype=np.float32)
        return arrays | {"object_pose": pose}

    tools = {**tosses.lineage[0].tools, "mujoco": "3.0.0"}
    nudged = stored(tmp_path / "nudged", tosses, nudge, tools=tools)
    with pytest.raises(DataError) as caught:
        repeat_episode(nudged, nudged.ids[1])
    said = str(caught.value)
    assert said.startswith("the episode is not the same when it is made again\n")
    assert "found: others in object_pose; mujoco 3.0.0 then, " in said
    # Another version alone is no difference.
    old = stored(tmp_path / "old", tosses, tools=tools)
    assert same(repeat_episode(old, old.ids[1]), tosses.episode(old.ids[1]))


def test_what_was_not_generated_or_is_withheld_is_refused(tmp_path, tosses):
    generate(tmp_path / "set", **TOSS, withheld=Withheld("object_mass", tmp_path / "seal.json"))
    withheld = open_dataset(tmp_path / "set")
    with pytest.raises(UsageError, match="a withheld set: its seed and effects are sealed"):
        repeat_episode(withheld, withheld.ids[0])
    append(create_dataset(tmp_path / "imported"), tosses, Lineage(operation="import"))
    imported = open_dataset(tmp_path / "imported")
    bare = stored(tmp_path / "bare", tosses, details={"scene": "cube_toss"})
    with pytest.raises(UsageError, match="required key `scene_digest` is missing"):
        repeat_episode(bare, bare.ids[0])
    with pytest.raises(UsageError, match="the lineage does not say how the episode was made"):
        repeat_episode(imported, imported.ids[0])


def test_an_episode_made_again_is_stored_with_its_cloud_and_origin(tmp_path, tosses):
    name = tosses.ids[1]
    for _ in range(2):  # the second adds nothing
        version = store_repeated(tmp_path / "out", tosses, repeat_episode(tosses, name))
        assert version.number == 1
    out = open_dataset(tmp_path / "out")
    assert same(out.episode(name), tosses.episode(name))
    cloud = out.episode(name).meta.point_cloud
    np.testing.assert_array_equal(get_cloud(out.path, cloud), get_cloud(tosses.path, cloud))
    assert same(repeat_episode(out, name), tosses.episode(name))


def test_the_effects_of_the_episode_decide(tmp_path, tosses):
    """An episode that says other effects than it was made with does not come out the same."""
    (step,) = tosses.lineage
    tilted = EffectSetting(name="gravity_tilt", parameters={"tilt_x_rad": 0.2})
    episodes = [Episode(e.meta.model_copy(update={"effects": (tilted,)}), e.arrays) for e in tosses]
    append(create_dataset(tmp_path / "wrong"), episodes, step)
    with pytest.raises(DataError, match="others in object_pose; the versions are the same"):
        repeat_episode(open_dataset(tmp_path / "wrong"), tosses.ids[0])
