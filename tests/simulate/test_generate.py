"""Generated sets: the same for a seed whoever makes them, resumed, refused, appended."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

from candata.datasets import get_cloud, open_dataset, pending_parts
from candata.datasets.merging import merge
from candata.errors import MissingExtraError, UnknownNameError, UsageError
from candata.schema.effect import EffectSetting
from candata.simulate.generate import generate

#: Short tosses: two chunks, a fraction of a second of work.
TOSS = {"scene": "cube_toss", "episodes": 20, "seed": 7, "duration_s": 0.3, "workers": 1}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The digest of the short tosses, made in one process."""
    return generate(tmp_path_factory.mktemp("generate") / "set", **TOSS).digest


def test_workers_change_nothing(tmp_path, reference):
    version = generate(tmp_path / "set", **{**TOSS, "workers": 2})
    assert version.digest == reference
    assert [part.episodes for part in version.parts] == [16, 4]


def test_another_seed_is_another_set(tmp_path, reference):
    assert generate(tmp_path / "set", **{**TOSS, "seed": 8}).digest != reference


def test_the_same_again_adds_nothing(tmp_path, reference):
    first = generate(tmp_path / "set", **TOSS)
    files = sorted(tmp_path.rglob("*.*"))
    told = []
    assert generate(tmp_path / "set", **TOSS, progress=told.append) == first
    assert sorted(tmp_path.rglob("*.*")) == files
    assert told == [20]


def test_a_larger_set_goes_on_from_a_smaller(tmp_path, reference):
    generate(tmp_path / "set", **{**TOSS, "episodes": 3})
    version = generate(tmp_path / "set", **TOSS)
    assert version.digest == reference
    assert version.number == 2
    assert len(version.lineage) == 1


def test_a_failure_in_the_middle_publishes_nothing_and_is_gone_on_from(tmp_path, reference):
    def stop(_count: int) -> None:
        if pending_parts(tmp_path / "set"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path / "set", **TOSS, progress=stop)
    assert len(pending_parts(tmp_path / "set")) == 1
    told = []
    version = generate(tmp_path / "set", **TOSS, progress=told.append)
    assert version.digest == reference
    assert told == [16, 4]
    assert pending_parts(tmp_path / "set") == ()


def test_a_killed_run_is_gone_on_from(tmp_path):
    whole = {"scene": "cube_toss", "episodes": 160, "seed": 7, "workers": 2}
    words = ["generate-sim", "--scene", "cube_toss", "--episodes", "160", "--seed", "7", "--jobs", "2"]
    command = [sys.executable, "-m", "candata_cli.main", *words, "--out", str(tmp_path / "set")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as run:
        deadline_s = time.monotonic() + 60
        while not list(tmp_path.glob("set/parts/*/part.json")) and time.monotonic() < deadline_s:
            time.sleep(0.005)
        run.kill()
        # The workers inherited the pipes: this returns once they have ended, by themselves.
        run.communicate(timeout=30)
    assert not list(tmp_path.glob("set/versions/*.json")), "killed before the end"
    version = generate(tmp_path / "set", **whole)
    assert version.digest == generate(tmp_path / "fresh", **whole).digest


def test_another_configuration_for_the_same_ids_is_refused(tmp_path):
    generate(tmp_path / "set", **TOSS)
    with pytest.raises(UsageError) as caught:
        generate(tmp_path / "set", **{**TOSS, "duration_s": 0.4})
    assert str(caught.value) == (
        "the dataset holds episodes of these ids, made from another configuration\n"
        "  expected: duration_s 0.3\n"
        "  found: duration_s 0.4\n"
        f"  where: {tmp_path / 'set'}, episode cube_toss-s7-000000\n"
        "  do: choose another --seed or another --out"
    )


def test_another_configuration_with_other_ids_is_added(tmp_path):
    generate(tmp_path / "set", **{**TOSS, "episodes": 2})
    version = generate(tmp_path / "set", **{**TOSS, "episodes": 2, "seed": 8, "duration_s": 0.4})
    data = open_dataset(tmp_path / "set")
    assert data.ids == tuple(f"cube_toss-s{seed}-00000{i}" for seed in (7, 8) for i in (0, 1))
    assert [step.seeds for step in version.lineage] == [(7,), (8,)]


def test_lineage_says_how(tmp_path):
    mass = EffectSetting(name="object_mass", parameters={"mass_scale": 1.5})
    version = generate(tmp_path / "set", **{**TOSS, "episodes": 2}, effects=[mass], noise=False)
    (step,) = version.lineage
    assert step.operation == "generate-sim"
    assert step.seeds == (7,)
    assert step.sealed is None
    assert set(step.tools) == {"candata", "mujoco", "python"}
    expected = {"scene": "cube_toss", "policies": ["toss"], "duration_s": 0.3, "noise": False}
    assert expected.items() <= step.details.items()
    assert step.details["effects"] == [mass.model_dump(mode="json")]
    assert open_dataset(tmp_path / "set").episode("cube_toss-s7-000001").meta.effects == (mass,)


def test_policies_take_turns_and_the_object_has_a_cloud(tmp_path):
    asked = ("push", "free_sweep")
    generate(tmp_path / "set", "xhand_tabletop", 3, 1, policies=asked, duration_s=0.1, workers=1)
    episodes = list(open_dataset(tmp_path / "set"))
    assert [e.meta.task for e in episodes] == ["push", "free_sweep", "push"]
    cloud = get_cloud(tmp_path / "set", episodes[0].meta.point_cloud)
    assert cloud.shape == (512, 3)
    assert np.abs(cloud).max() == pytest.approx(0.06, abs=1e-6)


def test_a_user_s_scene_has_its_own_ids(tmp_path, user_scene):
    scene = user_scene(
        '<geom name="floor" type="plane" size="1 1 .1"/><body name="box" pos="0 0 0.1"><freejoint/>'
        '<geom type="box" size=".03 .03 .03"/></body>',
        "rate_hz: 100\nobject: box\nsupport: floor\n",
    )
    generate(tmp_path / "set", scene.name, 1, 1, duration_s=0.1, workers=1)
    (episode,) = open_dataset(tmp_path / "set")
    assert episode.meta.id == "scene0-s1-000000"
    assert episode.meta.task == "toss"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"episodes": 0}, "--episodes is too small"),
        ({"seed": -1}, "--seed is too small"),
        ({"duration_s": 0.01}, "the episodes are too short"),
        ({"policies": ["push"]}, "policy push cannot act in scene cube_toss"),
        (
            {"effects": [EffectSetting(name="tactile_gain")]},
            "effect tactile_gain cannot act in scene cube_toss",
        ),
    ],
)
def test_what_cannot_be_made_leaves_nothing_behind(tmp_path, change, text):
    with pytest.raises(UsageError, match=text):
        generate(tmp_path / "set", **{**TOSS, **change})
    assert not (tmp_path / "set").exists()


def test_an_unknown_policy_lists_the_known(tmp_path):
    with pytest.raises(UnknownNameError, match="free_sweep"):
        generate(tmp_path / "set", **TOSS, policies=["sweep"])


def test_all_shards_are_the_whole_set(tmp_path, reference):
    shards = [generate(tmp_path / "set", **TOSS, shard=(number, 2)) for number in (2, 1)]
    assert [sum(part.episodes for part in version.parts) for version in shards] == [4, 20]
    assert shards[1].digest == reference


def test_shards_of_their_own_merge_into_the_whole_set(tmp_path, reference):
    for number in (1, 2):
        generate(tmp_path / f"{number}", **TOSS, shard=(number, 2))
    merged = merge([open_dataset(tmp_path / f"{number}") for number in (1, 2)], tmp_path / "whole")
    assert merged.digest == reference


@pytest.mark.parametrize(
    ("shard", "text"), [((3, 2), "no such shard"), ((0, 2), "no such shard"), ((3, 3), "at most 2")]
)
def test_a_shard_that_is_none_is_refused(tmp_path, shard, text):
    with pytest.raises(UsageError, match=text):
        generate(tmp_path / "set", **TOSS, shard=shard)
    assert not (tmp_path / "set").exists()


def test_without_ray_one_line_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError) as caught:
        generate(tmp_path / "set", **TOSS, ray="local")
    assert str(caught.value) == 'ray is not installed\n  do: pip install "candata[cluster]"'
    assert not (tmp_path / "set").exists()
