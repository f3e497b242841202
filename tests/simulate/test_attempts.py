"""Sets with wanted outcomes, and sets of which some episodes cannot be made."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import open_dataset, pending_parts
from candata.datasets.quarantine import read_quarantine
from candata.errors import DataError, UsageError
from candata.policies import policy
from candata.simulate import attempts, episodes
from candata.simulate.generate import generate
from candata.simulate.repetition import repeat_episode

MIX = {"success": 0.5, "fail": 0.5}
GRASPS = {
    "scene": "gripper_tabletop",
    "episodes": 20,
    "seed": 3,
    "policies": ("grasp_lift_shake",),
    "outcomes": MIX,
    "duration_s": 2.0,
}
TOSS = {"scene": "cube_toss", "episodes": 20, "seed": 7, "duration_s": 0.2, "workers": 1}


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """Grasps of which half fail, made in one process."""
    root = tmp_path_factory.mktemp("grasps") / "set"
    generate(root, **GRASPS, workers=1)
    return open_dataset(root)


def test_the_mix_is_met_and_each_episode_says_what_was_drawn(grasps):
    metas = [grasps.episode(name).meta for name in grasps.ids]
    assert Counter(m.outcome == "success" for m in metas) == {True: 10, False: 10}
    for meta in metas:
        assert (meta.outcome == "success") == (meta.labels["wanted_outcome"] == "success")
    failed = [m.labels for m in metas if m.outcome != "success"]
    assert all(m["grip_scale"] < 1 or m["aim_x_m"] != 0 or m["lead_s"] != 0 for m in failed)
    assert max(m["attempt"] for m in failed) > 0


def test_shards_and_workers_change_nothing(grasps, tmp_path):
    first = generate(tmp_path / "set", **GRASPS, workers=1, shard=(2, 2))
    assert sum(part.episodes for part in first.parts) == 4
    assert generate(tmp_path / "set", **GRASPS, workers=2, shard=(1, 2)).digest == grasps.digest


def test_an_episode_of_a_later_attempt_is_made_again_bit_for_bit(grasps):
    name = next(n for n in grasps.ids if grasps.episode(n).meta.labels["attempt"] > 1)
    assert repeat_episode(grasps, name).meta == grasps.episode(name).meta


def test_a_run_that_was_stopped_ends_as_one_that_was_not(grasps, tmp_path):
    def stop(_count: int) -> None:
        if pending_parts(tmp_path / "set"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path / "set", **GRASPS, workers=1, progress=stop)
    assert generate(tmp_path / "set", **GRASPS, workers=1).digest == grasps.digest


def test_an_outcome_that_no_draw_gives_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(attempts, "MOST_ATTEMPTS", 3)
    asked = {**GRASPS, "episodes": 2, "policies": ("push",), "outcomes": {"topple": 1.0}, "duration_s": 1.0}
    with pytest.raises(DataError) as caught:
        generate(tmp_path / "set", **asked, workers=1)
    assert "no draw gave the outcome topple\n  expected: topple in one of 3 draws of push\n" in str(caught.value)


def test_a_policy_without_a_goal_is_refused_where_outcomes_are_wanted(tmp_path):
    with pytest.raises(UsageError, match="policies with a goal: grasp_lift_shake, push"):
        generate(tmp_path / "set", **{**GRASPS, "policies": ("free_sweep",)})
    assert not (tmp_path / "set").exists()


def test_a_policy_that_cannot_act_is_refused_where_outcomes_are_wanted(tmp_path):
    with pytest.raises(UsageError, match="policy push cannot act in scene cube_toss"):
        generate(tmp_path / "set", **{**TOSS, "policies": ("push",), "outcomes": MIX})


def sometimes(change, share):
    """A policy whose plans are changed in a share of the episodes, as the seed decides."""
    plain = policy("toss")

    def plan(scene, rng, duration_s):
        is_changed = rng.random() < share
        made = plain.plan(scene, rng, duration_s)
        return replace(made, **change(made)) if is_changed else made

    return lambda _name: replace(plain, plan=plan)


def not_finite(plan):
    return {"qvel": np.full_like(plan.qvel, np.nan)}


def wrong_size(plan):
    return {"commands": np.zeros((len(plan.commands), 3))}


def in_the_table(plan):
    qpos = plan.qpos.copy()
    qpos[2] = -0.05
    return {"qpos": qpos}


@pytest.fixture
def breaking(monkeypatch):
    """Let `toss` make plans that cannot be played, in a share of the episodes."""
    return lambda change, share=0.3: monkeypatch.setattr(episodes, "policy", sometimes(change, share))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (not_finite, "policy toss plans what cannot be played"),
        (wrong_size, "policy toss plans what cannot be played"),
        (in_the_table, "the object starts inside"),
    ],
)
def test_what_cannot_be_made_is_left_out_with_its_reason(tmp_path, breaking, change, problem):
    breaking(change)
    generate(tmp_path / "set", **TOSS)
    data, left_out = open_dataset(tmp_path / "set"), read_quarantine(tmp_path / "set")
    assert 0 < len(left_out) < 20
    assert sorted([*data.ids, *left_out]) == [f"cube_toss-s7-{i:06d}" for i in range(20)]
    assert all(e.problem.startswith(problem) for e in left_out.values())


def test_what_is_left_out_changes_nothing_in_the_rest(tmp_path, breaking):
    hashes = {}
    for share in (0.0, 0.3):
        breaking(not_finite, share)
        generate(tmp_path / f"{share}", **TOSS)
        data = open_dataset(tmp_path / f"{share}")
        hashes[share] = dict(data.contents(data.ids))
    assert 0 < len(hashes[0.3]) < 20
    assert hashes[0.3] == {name: hashes[0.0][name] for name in hashes[0.3]}


def test_the_same_again_tries_nothing_anew(tmp_path, breaking):
    breaking(not_finite)
    first = generate(tmp_path / "set", **TOSS)
    files = sorted(tmp_path.rglob("*.json"))
    breaking(not_finite, 0.0)
    assert generate(tmp_path / "set", **TOSS) == first
    assert sorted(tmp_path.rglob("*.json")) == files


def test_a_stopped_run_leaves_out_the_same(tmp_path, breaking):
    breaking(not_finite)
    whole = generate(tmp_path / "whole", **TOSS)

    def stop(_count: int) -> None:
        if pending_parts(tmp_path / "set"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path / "set", **TOSS, progress=stop)
    assert generate(tmp_path / "set", **TOSS).digest == whole.digest
    assert read_quarantine(tmp_path / "set") == read_quarantine(tmp_path / "whole")


def test_strict_ends_at_the_first(tmp_path, breaking):
    breaking(not_finite)
    with pytest.raises(DataError, match=r"qvel of shape \(6,\), all finite"):
        generate(tmp_path / "set", **TOSS, strict=True)


def test_a_set_of_which_all_fail_is_an_error(tmp_path, breaking):
    breaking(not_finite, 1.0)
    with pytest.raises(DataError, match="policy toss plans what cannot be played"):
        generate(tmp_path / "set", **TOSS)
