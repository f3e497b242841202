"""Logs become episodes: one grid, calibrated forces, gaps marked, nothing invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import content_hash
from candata.errors import DataError, UsageError
from candata.record.importing import import_log
from tests.record.made_logs import (
    JOINTS,
    RECIPE,
    START,
    TIPS,
    beside,
    make_log,
    pose_stream,
    scene,
    swing,
    without,
    wrist,
)


def test_the_grid_has_the_rate_and_begins_when_all_have_begun():
    log = make_log()
    for recipe, rate in ((RECIPE, 83.0), (RECIPE.model_copy(update={"rate_hz": 50.0}), 50.0)):
        episode = import_log("run.mcap", log, recipe).episode
        assert np.allclose(np.diff(episode["time_ns"]) * 1e-9, 1 / rate, rtol=0, atol=1e-9)
        assert episode.meta.rate_hz == rate
        # After 3 s of calibration, on the next state; until the last command.
        assert 3.0 <= (episode["time_ns"][0] - log.state_time_ns[0]) * 1e-9 < 3.0 + 1 / 83
        assert np.abs(log.state_time_ns - episode["time_ns"][0]).min() < 10  # whole nanoseconds
        assert 0 <= (log.command_time_ns[-1] - episode["time_ns"][-1]) * 1e-9 < 1 / rate
    late = import_log("run.mcap", log, RECIPE, [beside(pose_stream(first_s=5.0, last_s=9.0))])
    assert 5.0 <= (late.episode["time_ns"][0] - START) * 1e-9 < 5.03
    assert (late.episode["time_ns"][-1] - START) * 1e-9 < 9.0
    assert late.details["left_out_s"]["before"] == pytest.approx(5.0, abs=0.03)
    assert late.details["left_out_s"]["after"] == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("rate_hz", [20.0, 80.0, 83.0, 120.0])
def test_joints_lie_on_the_motion_and_commands_within_half_a_step(rate_hz):
    episode = import_log("run.mcap", make_log(), RECIPE.model_copy(update={"rate_hz": rate_hz})).episode
    at = episode["time_ns"]
    # A chord of a sine of 3 rad/s over 12 ms is off by at most (w h)^2 / 8.
    assert np.abs(episode["joint_position"] - swing(at)).max() < (3 / 83) ** 2 / 8 + 1e-6
    # The command in force in the middle of the step was sent at most one device period before: 3 rad/s of change.
    middle = swing(at + round(0.5e9 / rate_hz))
    assert np.abs(episode["action"] - middle).max() < 3 / 83 + 1e-6
    assert not episode.meta.invalid_counts


def test_one_late_stamp_does_not_shift_the_grid():
    log = make_log()
    at = int(np.searchsorted(log.state_time_ns, log.state_time_ns[0] + 3_000_000_000))
    stamps = log.state_time_ns.copy()
    stamps[at] += 5_000_000
    first = import_log("run.mcap", replace(log, state_time_ns=stamps), RECIPE).episode["time_ns"][0]
    assert np.abs(log.state_time_ns - first).min() < 10


def test_jitter_below_half_a_period_moves_nothing_into_another_row(rng):
    log = make_log()
    jitter = rng.integers(0, 4_000_000, (2, len(log.state_time_ns)))  # ns; a third of the period
    counts = np.arange(len(log.state_time_ns), dtype=np.int16)[:, None, None] + np.zeros((1, 2, 3), np.int16)
    log = replace(log, force_counts=counts, joint_target=np.arange(len(counts))[:, None] + np.zeros((1, 3)))
    log = replace(log, state_time_ns=log.state_time_ns + jitter[0], command_time_ns=log.command_time_ns + jitter[1])
    episode = import_log("run.mcap", log, RECIPE).episode
    assert not episode.meta.invalid_counts
    assert (np.diff(episode["action"][:, 0]) == 1).all()
    # Counts of 0.1 N less a bias of one, in float32 near 80.
    assert np.allclose(episode["fingertip_force"][:, 0, 0], 0.1 * (episode["action"][:, 0] - 1), rtol=0, atol=1e-5)


def test_a_gap_is_marked_and_nothing_crosses_it():
    log = make_log()
    lost = np.zeros(len(log.state_time_ns), bool)
    lost[500:520] = True
    found = import_log("run.mcap", without(log, lost), RECIPE).episode
    time_ns, edge = found["time_ns"], log.state_time_ns[[499, 520]]
    inside = (time_ns > edge[0]) & (time_ns < edge[1])
    assert inside.sum() in (20, 21)  # the row on a stamp lies on either side by rounding to nanoseconds
    assert np.array_equal(~found.valid("joint_position"), inside)
    assert np.isnan(found["joint_position"][inside]).all()
    for channel in ("fingertip_force", "fingertip_contact", "contact", "taxels"):
        assert np.abs(np.flatnonzero(~found.valid(channel))[[0, -1]] - np.flatnonzero(inside)[[0, -1]]).max() <= 1
    assert found.valid("action").all()
    assert found.meta.invalid_counts["joint_position"] == inside.sum()
    assert f"rows marked invalid by gaps: joint_position {inside.sum()}, " in " ".join(
        import_log("run.mcap", without(log, lost), RECIPE).notes
    )


def test_a_gap_of_commands_and_of_poses_is_marked_in_them_alone():
    log = make_log()
    lost = np.zeros(len(log.command_time_ns), bool)
    lost[600:610] = True
    pose = pose_stream()
    keep = np.ones(len(pose.time_ns), bool)
    keep[400:430] = False
    holes = replace(pose, time_ns=pose.time_ns[keep], values=pose.values[keep])
    episode = import_log("run.mcap", without(log, lost, commands=True), RECIPE, [beside(holes)]).episode
    assert set(episode.meta.invalid_counts) == {"action", "object_pose"}
    assert episode.meta.invalid_counts["action"] == pytest.approx(11, abs=1)
    assert episode.meta.invalid_counts["object_pose"] == pytest.approx(31 * 83 / 60, abs=1.5)
    valid = episode.valid("object_pose")
    seconds = (episode["time_ns"] - START) * 1e-9
    assert np.abs(episode["object_pose"][valid, 0] - seconds[valid]).max() < 1e-6  # float32 below 10


def test_what_waited_for_a_held_up_reader_is_invalid():
    log = make_log(rate_hz=80)
    first, size = 400, 4
    time_ns = log.state_time_ns.copy()
    # Four frames fill the port while the reader sleeps for 300 ms, the others are dropped; then it reads all four.
    time_ns[first : first + size] = time_ns[first] + 300_000_000 - np.arange(size)[::-1] * 8_380_000
    log = replace(log, state_time_ns=time_ns)
    dropped = np.zeros(len(time_ns), bool)
    dropped[first + size : first + 25] = True
    found = import_log("run.mcap", without(log, dropped), RECIPE)
    assert any("read late in a burst after a gap: 4 states, 0 commands" in note for note in found.notes)
    episode = found.episode
    valid, time_ns = episode.valid("joint_position"), episode["time_ns"]
    assert 0 < (~valid).sum() < 30
    # Linear between rows of 12.5 ms: 3 rad/s squared, times 12.5 ms squared, over 8.
    assert np.abs(episode["joint_position"] - swing(time_ns))[valid].max() < 1e-3
    assert not episode.valid("taxels")[np.searchsorted(time_ns, log.state_time_ns[first + 1])]


def test_what_an_adapters_timer_holds_is_late_and_no_gap():
    log, recipe = make_log(rate_hz=50), RECIPE.model_copy(update={"rate_hz": 50.0})
    tick = 16_000_000
    read = -(-log.state_time_ns // tick) * tick
    log = replace(log, state_time_ns=read, command_time_ns=read - 1000, read_time_ns=read)
    found = import_log("run.mcap", log, recipe)
    (note,) = [note for note in found.notes if "bursts" in note]
    assert "every 16 ms" in note
    # Steps of 16 and 32 ms: by the median step the longer ones would be gaps.
    assert not found.episode.meta.invalid_counts
    assert not any("read late" in note for note in found.notes)
    lost = np.zeros(len(read), bool)
    lost[250:256] = True
    gone = import_log("run.mcap", without(log, lost), recipe).episode
    assert gone.meta.invalid_counts["joint_position"] == pytest.approx(7, abs=1)


def test_readings_that_are_not_finite_are_a_gap():
    pose = pose_stream()
    values = pose.values.copy()
    values[400:430] = np.nan
    episode = import_log("run.mcap", make_log(), RECIPE, [beside(replace(pose, values=values))]).episode
    assert episode.meta.invalid_counts["object_pose"] == pytest.approx(31 * 83 / 60, abs=1.5)


def test_the_first_row_has_a_command():
    log = make_log()
    lost = np.zeros(len(log.command_time_ns), bool)
    lost[10:300] = True  # commands before the calibration ended, then none for a while
    episode = import_log("run.mcap", without(log, lost, commands=True), RECIPE).episode
    assert episode.valid("action").all()
    assert episode["time_ns"][0] >= log.command_time_ns[299]


def test_forces_are_calibrated_and_contact_follows_the_threshold():
    log = make_log()
    counts = log.force_counts.copy()
    counts[400:500, 0, 2] += 3  # 0.3 N: not above the threshold
    counts[600:700, 1, 0] -= 4
    episode = import_log("run.mcap", replace(log, force_counts=counts), RECIPE).episode
    assert np.unique(np.round(episode["fingertip_force"][:, 0, 2], 6)).tolist() == pytest.approx([0.0, 0.3])
    assert not episode["fingertip_contact"][:, 0].any()
    assert episode["fingertip_contact"][:, 1].sum() == 100
    assert episode["contact"].sum() == 100
    assert episode.meta.contact_rule.model_dump() == {
        "method": "sum_abs",
        "threshold_n": 0.3,
        "newton_per_count": 0.1,
    }
    half = import_log(
        "run.mcap", replace(log, force_counts=counts), RECIPE.model_copy(update={"newton_per_count": 0.05})
    )
    assert not half.episode["contact"].any()
    assert half.details["contact_share_by_newton_per_count"]["0.1"] > 0
    assert half.episode.meta.newton_per_count == 0.05


def test_without_calibration_only_when_asked():
    log = replace(make_log(), calibration=None)
    with pytest.raises(DataError, match="no calibration") as caught:
        import_log("run.mcap", log, RECIPE)
    assert "--uncalibrated" in str(caught.value)
    raw = import_log("run.mcap", log, RECIPE.model_copy(update={"uncalibrated": True}))
    assert np.allclose(raw.episode["fingertip_force"], 0.1)
    assert any("not calibrated" in note for note in raw.notes)
    assert raw.details["calibration"] is None


def test_saturated_readings_are_counted_where_an_end_means_something():
    log = make_log()
    counts, taxels = log.force_counts.copy(), log.taxel_counts.copy()
    counts[:, :, 2] = 0  # an unsigned axis rests at its end
    counts[400:410, 0, 2] = 255
    counts[405:420, 0, 0] = -128  # of one reading, two axes count once
    counts[:50, 1, 1] = 127  # while it was calibrated
    taxels[500:507, 1, 2:4, 1] = 127
    found = import_log("run.mcap", replace(log, force_counts=counts, taxel_counts=taxels), RECIPE)
    saturated = found.details["saturated"]
    assert saturated["force"] == {"thumb": 20, "index": 0}
    assert saturated["taxels"] == {"thumb": 0, "index": 14}
    assert abs(saturated["state_frames"] - len(found.episode)) <= 1
    assert "saturated readings: 20 of fingertips, 14 of taxels" in found.notes[1]


def test_taxels_are_copied_never_averaged():
    episode = import_log("run.mcap", make_log(), RECIPE.model_copy(update={"rate_hz": 20.0})).episode
    assert episode["taxels"].dtype == np.int16
    assert (episode["taxels"][:, 1, 1, 1] == 7).all()
    log = make_log()
    last = np.searchsorted(log.state_time_ns - round(0.5e9 / 83), episode["time_ns"]) - 1
    assert np.array_equal(episode["taxels"][:, 0, 0, 0], last % 100)


def test_joints_are_merged_by_name_the_table_first_or_as_the_scene_says():
    companions = [beside(wrist(), wrist("action"), pose_stream())]
    plain = import_log("run.mcap", make_log(), RECIPE, companions).episode
    assert plain.meta.joint_names == plain.meta.actuator_names == ("w0", "w1", *JOINTS)
    assert plain["joint_position"][0, :2].tolist() == [5, 6]
    roles = scene(joints=("j2", "w1", "j0", "w0", "j1"), actuators=("w1", "j0", "j1"))
    recipe = RECIPE.model_copy(update={"roles": roles, "scene": "s"})
    episode = import_log("run.mcap", make_log(rate_hz=80), recipe, companions).episode
    assert episode.meta.joint_names == ("j2", "w1", "j0", "w0", "j1")
    assert episode.meta.actuator_names == ("w1", "j0", "j1", "j2", "w0")
    assert episode.meta.fingertip_names == TIPS[::-1]
    assert (episode["joint_position"][:, [1, 3]] == [6, 5]).all()
    assert np.abs(episode["joint_position"][:, 2] - swing(episode["time_ns"])[:, 0]).max() < 1e-3
    assert (episode["taxels"][:, 0, 1, 1] == 7).all()  # the index finger's, now first
    assert (episode.meta.scene, episode.meta.rate_hz) == ("s", 80)


def test_what_the_wire_carries_is_not_taken_twice():
    twice = import_log("run.mcap", make_log(), RECIPE, [beside(wrist(names=("w0", "j1")))])
    assert twice.episode.meta.joint_names == ("w0", *JOINTS)
    assert any("joint_position of j1 not taken; the wire carries it" in note for note in twice.notes)
    assert np.abs(twice.episode["joint_position"][:, 2]).max() <= 1
    none = import_log("run.mcap", make_log(), RECIPE, [beside(wrist(names=("j0", "j1")))])
    assert none.episode.meta.joint_names == JOINTS
    with pytest.raises(DataError, match="two files hold object_pose"):
        import_log("run.mcap", make_log(), RECIPE, [beside(pose_stream()), beside(pose_stream())])


def test_a_scene_whose_joints_nobody_brings_is_refused():
    recipe = RECIPE.model_copy(update={"roles": scene()})
    with pytest.raises(DataError, match="joint_position lacks joints of the scene") as caught:
        import_log("run.mcap", make_log(rate_hz=80), recipe)
    assert "bring w0, w1 by --with TABLE" in str(caught.value)


def test_a_scene_of_something_else_is_refused():
    recipe = RECIPE.model_copy(update={"roles": scene(joints=(), actuators=())})
    with pytest.raises(DataError, match="the scene has none of the hand's joints") as caught:
        import_log("run.mcap", make_log(rate_hz=80), recipe)
    assert "a scene without joints" in str(caught.value)


def test_a_rate_that_makes_up_nearly_every_row_is_refused():
    with pytest.raises(UsageError, match=r"far above the hand's[^$]*at most 1600 Hz for a hand of 80 Hz"):
        import_log("run.mcap", make_log(rate_hz=80), RECIPE.model_copy(update={"rate_hz": 1e9}))


def test_a_log_without_commands_has_no_action():
    log = make_log()
    log = replace(log, command_time_ns=log.command_time_ns[:0], joint_target=log.joint_target[:0])
    assert "action" not in import_log("run.mcap", log, RECIPE).episode


def test_another_clock_is_refused_with_both_spans():
    shifted = replace(pose_stream(), time_ns=pose_stream().time_ns - START)
    with pytest.raises(DataError, match="was not recorded while the log was") as caught:
        import_log("run.mcap", make_log(), RECIPE, [beside(shifted)])
    text = str(caught.value)
    assert "2025-10-09T08:53:20.001Z (1760000000.001 s)" in text
    assert "1970-01-01T00:00:00.000Z (0.000 s)" in text
    wild = replace(pose_stream(), time_ns=pose_stream().time_ns * 5)
    with pytest.raises(DataError, match="was not recorded"):
        import_log("run.mcap", make_log(), RECIPE, [beside(wild)])


def test_too_little_is_said_with_the_spans():
    with pytest.raises(DataError, match="too little is left") as caught:
        import_log("run.mcap", make_log(seconds=2.9), RECIPE)
    assert "when the calibration ended" in str(caught.value)
    with pytest.raises(DataError, match="too little is left"):
        import_log("run.mcap", make_log(), RECIPE, [beside(pose_stream(last_s=2.0))])


def test_no_states():
    empty = without(make_log(), np.ones(830, bool))
    with pytest.raises(DataError, match="the log holds no states") as caught:
        import_log("run.mcap", empty, RECIPE)
    assert "830 commands, no states" in str(caught.value)


def test_the_clocks_are_told_apart_and_a_torn_log_is_noted():
    seconds = np.arange(10) * 1_000_000_000
    moved = tuple({"clock": {"monotonic_ns": int(s), "wall_ns": int(s) + START + 40_000_000}} for s in seconds)
    log = replace(make_log(), statistics=(*moved, {"rate_hz": 1.0}), torn=True, damaged_chunks=2)
    log = replace(log, meta=log.meta.model_copy(update={"wall_offset_ns": START}))
    found = import_log("run.mcap", log, RECIPE, [beside(pose_stream())])
    assert found.episode.meta.alignment.offset_s == pytest.approx(0.04)
    assert found.episode.meta.alignment.drift_ppm == pytest.approx(0, abs=1e-6)
    assert any("by up to 0.040 s" in note for note in found.notes)
    assert any("torn or damaged (2 chunks lost)" in note for note in found.notes)


def test_the_same_inputs_give_the_same_episode_and_digest():
    first, second = (import_log("run.mcap", make_log(), RECIPE, [beside(pose_stream())]) for _ in range(2))
    assert content_hash(first.episode) == content_hash(second.episode)
    assert (first.digest, first.details) == (second.digest, second.details)
    changed = (
        import_log("run.mcap", make_log(), RECIPE.model_copy(update={"threshold_n": 0.4}), [beside(pose_stream())]),
        import_log("run.mcap", replace(make_log(), sha256="f" * 64), RECIPE, [beside(pose_stream())]),
        import_log("run.mcap", make_log(), RECIPE, [replace(beside(pose_stream()), digest="2" * 64)]),
    )
    assert len({first.digest, *(c.digest for c in changed)}) == 4
