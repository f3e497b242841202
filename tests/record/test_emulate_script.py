"""What an emulated hand says: counts, the still stretch, clipping, and episodes that cannot be played."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.record.devices import device
from candata.record.emulate_script import ceiling_hz, joined, tip_pattern, to_counts, write_script
from candata.schema.episode import Episode, EpisodeMeta

XHAND = device("xhand")
WRIST = ("wrist_x", "wrist_y")


def make(rows: int = 20, force: float = 3.0, **changes) -> Episode:
    """An episode with a wrist before the hand's joints and the fingertips in another order than the device's."""
    rng = np.random.default_rng(2)
    tips = XHAND.fingertip_names[::-1]
    fields = {
        "joint_names": (*WRIST, *XHAND.joint_names),
        "actuator_names": (*XHAND.joint_names, *WRIST),
        "fingertip_names": tips,
    }
    arrays = {
        "time_ns": np.arange(rows) * 12_500_000,
        "joint_position": rng.normal(size=(rows, 14)),
        "action": rng.normal(size=(rows, 14)),
        "fingertip_force": rng.uniform(-1, 1, (rows, 5, 3)) + np.array([0, 0, force]),
        "object_pose": np.tile([0.1, 0.2, 0.3, 1, 0, 0, 0], (rows, 1)),
    }
    arrays |= changes.pop("arrays", {})
    for name in changes.pop("without", ()):
        del arrays[name]
    return Episode(
        EpisodeMeta(**{"id": "e", "source": "sim", "rate_hz": 80, "task": "push"} | fields | changes), arrays
    )


def write(episode: Episode, **options):
    return write_script(episode, "xhand", XHAND, **options)


def test_the_pattern_is_a_share_of_the_whole():
    shares = tip_pattern(120)
    # 120 roundings of float64.
    assert shares.sum() == pytest.approx(1, abs=1e-14)
    assert (shares > 0).all()
    np.testing.assert_allclose(shares, shares[::-1], rtol=1e-12)  # the middle of the rows is the middle of the pattern
    assert np.argmax(shares) in (54, 55, 64, 65)


def test_counts_are_rounded_and_clipped_and_the_clipped_are_counted():
    force = np.array([[[1.04, -1.06, 3.0]], [[12.74, -12.84, -0.04]], [[12.76, -12.86, -0.06]], [[0, 0, 25.56]]])
    counts, clipped = to_counts(force, XHAND, 0.1)
    assert counts[:, 0].tolist() == [[10, -11, 30], [127, -128, 0], [127, -128, 0], [0, 0, 255]]
    assert clipped.tolist() == [0, 0, 3, 1]


def test_half_a_count_below_zero_is_no_clipped_count():
    counts, clipped = to_counts(np.array([[0, 0, np.float32(-0.05)]]), XHAND, 0.1)
    assert counts.tolist() == [[0, 0, 0]]
    assert clipped.tolist() == [0]


def test_rows_are_the_devices_own_columns_by_name():
    episode = make()
    script = write(episode, still_s=0)
    np.testing.assert_array_equal(script.joint_position, episode["joint_position"][:, 2:])
    np.testing.assert_array_equal(script.joint_target, episode["action"][:, :12])
    np.testing.assert_array_equal(script.unwired_channels["joint_position"], episode["joint_position"][:, :2])
    np.testing.assert_array_equal(script.unwired_channels["action"], episode["action"][:, 12:])
    assert (script.unwired_joints, script.unwired_actuators) == (WRIST, WRIST)
    # Half a count, and the millionth of a count to which halves are decided.
    np.testing.assert_allclose(script.force_counts * 0.1, episode["fingertip_force"][:, ::-1], atol=0.0500002)


def test_the_frames_say_what_the_script_says():
    script = write(make())
    read, told = XHAND.decode_states(script.states), XHAND.decode_commands(script.commands)
    np.testing.assert_array_equal(read.joint_position, script.joint_position)
    np.testing.assert_array_equal(read.force_counts, script.force_counts)
    np.testing.assert_array_equal(read.taxel_counts, script.taxel_counts)
    np.testing.assert_array_equal(told.joint_target, script.joint_target)


def test_the_total_is_counted_for_itself():
    """A light touch over 120 taxels rounds to nothing on most of them; the total still reads it."""
    script = write(make(force=2.0), still_s=0)
    assert script.force_counts[..., 2].min() >= 10
    assert (script.taxel_counts[..., 2].sum(axis=2) != script.force_counts[..., 2]).any()
    firm = write(make(force=20.0), still_s=0)
    totals = firm.taxel_counts[..., 2].sum(axis=2)
    # 120 roundings of at most half a count.
    np.testing.assert_allclose(totals, firm.force_counts[..., 2], atol=60)


def test_it_begins_still_and_untouched():
    episode = make()
    script = write(episode, still_s=3.5, rate_hz=83)
    assert script.rest_rows == round(3.5 * 83)
    still = slice(0, script.rest_rows)
    assert len(script) == script.rest_rows + len(episode)
    assert not script.force_counts[still].any()
    assert not script.taxel_counts[still].any()
    assert (script.joint_position[still] == script.joint_position[script.rest_rows]).all()
    assert (script.joint_target[still] == script.joint_target[script.rest_rows]).all()
    assert (
        script.unwired_channels["object_pose"][still] == script.unwired_channels["object_pose"][script.rest_rows]
    ).all()
    assert script.row[script.rest_rows :].tolist() == list(range(len(episode)))


def test_another_scale_gives_other_counts():
    fine, coarse = write(make(), newton_per_count=0.05), write(make(), newton_per_count=0.1)
    assert fine.force_counts.max() > 1.8 * coarse.force_counts.max()


def test_pulls_are_clipped_and_counted():
    script = write(make(force=-5.0), still_s=0)
    assert not script.force_counts[..., 2].any()
    assert script.force_clipped.tolist() == [5] * 20
    assert script.taxels_clipped.min() > 0


def test_actions_that_lead_to_their_row_are_sent_a_row_before():
    episode = make(action="previous")
    script = write(episode, still_s=0)
    np.testing.assert_array_equal(script.joint_target[:-1], episode["action"][1:, :12])
    np.testing.assert_array_equal(script.joint_target[-1], episode["action"][-1, :12])


def test_request_and_reply_fill_the_wire_at_119_hz():
    assert ceiling_hz(XHAND.encoder, XHAND) == pytest.approx(119.3, abs=0.1)  # the published 8.38 ms


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"rate_hz": 120.0}, "the wire cannot carry this rate"),
        ({"rate_hz": 0.0}, "the wire cannot carry this rate"),
        ({"rate_hz": float("nan")}, "the wire cannot carry this rate"),
        ({"still_s": -1.0}, "the still stretch has a wrong length"),
        ({"still_s": float("inf")}, "the still stretch has a wrong length"),
        ({"newton_per_count": 0.0}, "the scale of the forces is wrong"),
        ({"newton_per_count": float("nan")}, "the scale of the forces is wrong"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(options, problem):
    with pytest.raises(UsageError, match=problem):
        write(make(), **options)


def test_an_episode_of_another_hand_is_refused():
    names = (*WRIST, *(f"other_{k}" for k in range(12)))
    with pytest.raises(UsageError, match="lacks joints of the device"):
        write(make(joint_names=names))


@pytest.mark.parametrize("channel", ["action", "fingertip_force"])
def test_an_episode_without_a_channel_is_refused(channel):
    with pytest.raises(DataError, match=f"no channel {channel}"):
        write(make(without=(channel,)))


def test_gaps_are_refused():
    flags = np.arange(20) != 7
    with pytest.raises(DataError, match="joint_position has gaps"):
        write(make(arrays={"joint_position_valid": flags}))


def test_a_device_that_writes_no_frames_is_refused():
    with pytest.raises(UsageError, match="xhand cannot be emulated"):
        write_script(make(), "xhand", replace(XHAND, encoder=None))


def test_a_device_without_taxels_is_emulated():
    def state_frames(position, force, taxels):
        return XHAND.encoder.state_frames(position, force, np.zeros((len(position), 5, 120, 3), int))

    bare = replace(XHAND, taxels=0, encoder=replace(XHAND.encoder, state_frames=state_frames))
    script = write_script(make(), "bare", bare)
    assert script.taxel_counts.shape == (len(script), 5, 0, 3)
    assert not script.taxels_clipped.any()
    np.testing.assert_array_equal(script.force_counts, write_script(make(), "xhand", XHAND).force_counts)


def test_episodes_are_joined_with_untouched_rests_in_their_first_rows():
    first, second = make(), make(rows=15, force=5.0, task="slide")
    whole = joined([first, second], 0.2)
    between = slice(20, 36)  # 0.2 s at 80 Hz
    assert len(whole) == 20 + 16 + 15 + 16
    assert whole.meta.task is None
    assert not whole["fingertip_force"][between].any()
    assert not whole["fingertip_force"][51:].any()
    for name in ("joint_position", "action", "object_pose"):
        assert (whole[name][between] == second[name][0]).all()
        assert (whole[name][51:] == first[name][0]).all()
    for name in ("joint_position", "action", "fingertip_force", "object_pose"):
        np.testing.assert_array_equal(whole[name][:20], first[name])
        np.testing.assert_array_equal(whole[name][36:51], second[name])


def test_episodes_of_another_rate_are_not_joined():
    with pytest.raises(UsageError, match="do not play one after the other"):
        joined([make(), make(rate_hz=40)], 1.0)
    with pytest.raises(UsageError, match="no time"):
        joined([make()], float("nan"))
