"""Signatures: what they promise is what a recording shows, and the cache changes nothing but the time."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit import signatures
from candata.gap.fit.signatures import library
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import residual
from candata.gap.run import cache as kept
from candata.gap.run.streams import Streams
from candata.simulate import at_rest, rollout
from tests.gap.conftest import signatures_of


@pytest.fixture(scope="module")
def still(arm, arm_episodes):
    """Recordings of the nominal arm without noise, and the problem they pose."""
    recs = recordings(arm, arm_episodes(noise=False))
    return _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)


def shelf(problem, root, begin=None):
    return library(problem.replayer, problem.recs, begin or problem.begin, problem.plan, problem.raw, root, share=True)


def test_a_signature_is_the_residual_of_a_recording_with_the_effect(arm, arm_episodes, still, planted, tmp_path):
    some = planted("joint_damping", damping_Nms_rad=0.4)
    recs = recordings(arm, arm_episodes(some, noise=False))
    seen = residual(recs, still.plan, replay_all(still.replayer, recs, still.begin, [()])[0])
    (found,) = signatures_of(shelf(still, tmp_path), [some])
    inside = np.isfinite(seen)
    # The recorded world began at the same place: only float32 lies between the two.
    assert found[inside] == pytest.approx(seen[inside], abs=1e-6)
    assert np.abs(seen[inside]).max() > 1e-3


def test_where_none_are_kept_a_signature_is_what_the_effect_takes_off_the_recording(arm, arm_episodes, planted):
    some = planted("joint_damping", damping_Nms_rad=0.4)
    posed = _problem(Replayer(arm), recordings(arm, arm_episodes(some)), Streams(0), None, lambda stage: None)
    left = posed.raw - residual(posed.recs, posed.plan, replay_all(posed.replayer, posed.recs, posed.begin, [some])[0])
    steps = []
    counted = replace(posed.library, replayer=replace(posed.replayer, count=steps.append), memo={})
    (found,) = signatures_of(counted, [some])
    inside = np.isfinite(left)
    assert found[inside] == pytest.approx(left[inside], abs=1e-6)
    # One replay of each episode, where a signature that is kept takes a recording beside it.
    assert sum(steps) == posed.recs.commands.shape[0] * posed.recs.commands.shape[1] * arm.substeps


def test_a_sensor_at_fault_began_elsewhere_and_read_what_was_recorded(arm, arm_episodes, planted, tmp_path):
    """Of its own recording a library knows what was read; of another recording, shared, only the place."""
    offset = np.array([0.08, -0.06])
    some = planted("joint_offset", offset_rad=tuple(offset))
    recs = recordings(arm, arm_episodes(noise=False))
    # At rest its servos hold the readings at the commands: the joints stand off by the offset.
    qpos, qvel = at_rest(arm, len(recs))
    played = rollout(arm, recs.commands, qpos - offset, qvel, [some] * len(recs))
    recs = replace(recs, readings=played.readings)
    own = _problem(Replayer(arm), recs, Streams(0), tmp_path, lambda stage: None, share=True)
    inside = np.isfinite(own.raw)
    (found,), (other,) = (
        signatures_of(part, [some]) for part in (own.library, replace(own.library, own=False, memo={}))
    )
    error, wrong = (np.abs(one[inside] - own.raw[inside]).max() for one in (found, other))
    assert np.abs(own.raw[inside]).max() > 1e-3
    assert error < 0.2 * wrong


def test_a_sensor_that_read_the_start_has_a_signature_where_none_are_shared_too(still, planted, tmp_path):
    """A replay of the recording from another start would be off by the contact that it begins in."""
    sensor, joint = planted("joint_offset", offset_rad=(0.08, -0.06)), planted("armature", armature_kgm2=0.01)
    shared, own = shelf(still, tmp_path), replace(still.library, memo={})
    assert (shared.seen, own.seen, shared.own) == (False, True, True)
    assert np.array_equal(*(signatures_of(part, [sensor])[0] for part in (shared, own)), equal_nan=True)
    assert not np.array_equal(*(signatures_of(part, [joint])[0] for part in (shared, own)), equal_nan=True)


def test_only_the_recording_whose_start_it_is_owns_a_library(still, planted, tmp_path):
    some = planted("joint_offset", offset_rad=(0.08, -0.06))
    moved = replace(still.begin, qpos=still.begin.qpos + 0.01, qpos0=still.begin.qpos0 + 0.01)
    first, again, other = shelf(still, tmp_path), shelf(still, tmp_path), shelf(still, tmp_path, moved)
    assert (first.own, again.own, other.own) == (True, True, False)
    assert [part.take(np.arange(3)).own for part in (first, other)] == [True, False]
    first.keep(some)
    assert not again.lacks(some)
    assert other.lacks(some)


def test_the_cache_gives_what_was_simulated_without_simulating(still, planted, tmp_path):
    some = planted("armature", armature_kgm2=0.01)
    (fresh,) = signatures_of(shelf(still, tmp_path / "other"), [some])
    (made,) = signatures_of(shelf(still, tmp_path), [some])
    steps = []
    counted = replace(still, replayer=replace(still.replayer, count=steps.append))
    (kept,) = signatures_of(shelf(counted, tmp_path), [some])
    assert np.array_equal(made, fresh, equal_nan=True)
    assert np.array_equal(kept, fresh, equal_nan=True)
    assert steps == []


@pytest.mark.parametrize("kept", [True, False])
def test_long_simulations_say_how_far_they_are(still, planted, monkeypatch, tmp_path, kept):
    monkeypatch.setattr(signatures, "BATCH", len(still.recs))
    monkeypatch.setattr(signatures, "TOLD_S", 0.0)
    told = []
    some = [planted("armature", armature_kgm2=x) for x in (0.001, 0.002, 0.003)]
    root = tmp_path if kept else None
    args = (still.replayer, still.recs, still.begin, still.plan, still.raw, root, told.append)
    signatures_of(library(*args, share=kept), some)
    assert [t.partition(",")[0] for t in told] == ["simulating effects: 1 of 3", "simulating effects: 2 of 3"]
    assert all(t.endswith(" s left of these") for t in told)


def test_a_damaged_file_is_made_again(still, planted, tmp_path):
    some = planted("armature", armature_kgm2=0.02)
    (made,) = signatures_of(shelf(still, tmp_path), [some])
    for file in tmp_path.rglob("*.npz"):
        if file.name != "starts.npz":
            data = bytearray(file.read_bytes())
            data[len(data) // 2] ^= 255
            file.write_bytes(data)
    (again,) = signatures_of(shelf(still, tmp_path), [some])
    assert np.array_equal(again, made, equal_nan=True)


@pytest.mark.parametrize(("off_rad", "shared"), [(0.05, True), (0.2, False)])
def test_starts_that_a_biased_sensor_could_have_read_share_signatures(still, tmp_path, off_rad, shared):
    first = shelf(still, tmp_path)
    moved = replace(still.begin, qpos=still.begin.qpos + off_rad, qpos0=still.begin.qpos0 + off_rad)
    second = shelf(still, tmp_path, moved)
    assert (second.folder == first.folder) is shared
    assert np.array_equal(second.begin.qpos, first.begin.qpos if shared else moved.qpos)


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_starts_that_count_as_the_same_the_nearest_is_taken_whichever_was_first(still, tmp_path, first):
    def moved(off_rad: float):
        return replace(still.begin, qpos=still.begin.qpos + off_rad, qpos0=still.begin.qpos0 + off_rad)

    both = (0.0, 0.15) if first == 0 else (0.15, 0.0)
    kept_at = {off: shelf(still, tmp_path, moved(off)).folder for off in both}
    assert [shelf(still, tmp_path, moved(off)).folder for off in (0.06, 0.09)] == [kept_at[0.0], kept_at[0.15]]


def test_other_commands_have_other_signatures(still, tmp_path):
    recs = replace(still.recs, commands=still.recs.commands + 1e-6)
    other = library(still.replayer, recs, still.begin, still.plan, still.raw, tmp_path, share=True)
    assert other.folder.parent != shelf(still, tmp_path).folder.parent


def test_a_slower_sensor_has_other_signatures(still, tmp_path):
    """Of the same commands: what is held between readings moves by other residuals, and so do its nulls."""
    rows = np.broadcast_to(np.arange(still.recs.commands.shape[1]) // 3 * 3, still.recs.commands.shape[:2])
    recs = [replace(still.recs, sources={"joint_position": some}) for some in (rows, np.maximum(rows - 1, 0))]
    parts = [
        library(still.replayer, one, still.begin, still.plan, still.raw, tmp_path, share=True)
        for one in (still.recs, *recs)
    ]
    assert len({part.folder.parent for part in parts}) == 3


def test_another_supply_has_other_signatures(still, tmp_path):
    folders = set()
    for share in (None, 1.0, 0.9):
        supply = None if share is None else np.full_like(still.recs.commands, share)
        recs = replace(still.recs, supply=supply)
        part = library(still.replayer, recs, still.begin, still.plan, still.raw, tmp_path, share=True)
        folders.add(part.folder.parent)
    assert len(folders) == 3


def test_nulls_are_the_same_with_and_without_the_cache(still, tmp_path):
    noise = still.replayer.scene.file.noise
    fresh = shelf(still, None).nulls(noise)
    shelf(still, tmp_path).nulls(noise)
    assert np.array_equal(shelf(still, tmp_path).nulls(noise), fresh, equal_nan=True)


def test_a_cache_that_cannot_be_written_is_no_harm(still, planted, tmp_path):
    (tmp_path / "signatures").write_text("a file where a folder should be")
    (found,) = signatures_of(shelf(still, tmp_path), [planted("armature", armature_kgm2=0.02)])
    assert np.isfinite(found).any()


@pytest.mark.parametrize("share", [True, None], ids=["signatures", "what was seen"])
def test_what_was_used_longest_ago_goes_when_the_cache_is_full(still, planted, tmp_path, monkeypatch, share):
    some = planted("armature", armature_kgm2=0.01)

    def begun(more: float):
        recs = replace(still.recs, commands=still.recs.commands + more)
        return library(still.replayer, recs, still.begin, still.plan, still.raw, tmp_path, share=share)

    first = begun(0.0)
    signatures_of(first, [some])
    monkeypatch.setattr(kept, "LIMIT_BYTES", 10)
    second = begun(1e-6)
    signatures_of(second, [some])
    assert (first.folder.exists(), second.folder.exists()) == (True, True)  # somebody may be at work with it
    monkeypatch.setattr(kept, "IN_USE_S", -1.0)
    signatures_of(begun(2e-6), [some])
    assert (first.folder.exists(), second.folder.exists()) == (False, False)


def test_a_set_that_is_used_again_stays_longest(still, planted, tmp_path):
    first = library(still.replayer, still.recs, still.begin, still.plan, still.raw, tmp_path)
    signatures_of(first, [planted("armature", armature_kgm2=0.01)])
    os.utime(first.folder, (1, 1))
    library(still.replayer, still.recs, still.begin, still.plan, still.raw, tmp_path)
    assert first.folder.stat().st_mtime > 1


def test_a_library_that_may_only_be_read_serves(still, tmp_path, monkeypatch):
    first = shelf(still, tmp_path)

    def refused(*_):
        raise PermissionError(1, "not yours")

    monkeypatch.setattr(os, "utime", refused)
    assert shelf(still, tmp_path).folder == first.folder


def test_without_a_cache_nothing_is_simulated_twice(still, planted):
    steps = []
    counted = replace(still, replayer=replace(still.replayer, count=steps.append))
    found = shelf(counted, None)
    some = planted("armature", armature_kgm2=0.01)
    (first,) = signatures_of(found, [some])
    done = len(steps)
    (again,) = signatures_of(found, [some])
    assert done > 0
    assert len(steps) == done
    assert again is first
