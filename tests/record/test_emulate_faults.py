"""Faults of an emulated wire: how they are asked for, and what they do to a frame."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UsageError
from candata.record.devices import _xhand_frames as wire
from candata.record.devices import device
from candata.record.emulate_faults import NO_FAULTS, Faults, parse_faults, with_fault

COMMAND = wire.command_frames(np.full((1, 12), 0.5))[0]
STATE = wire.state_frames(np.full((1, 12), 0.5), np.full((1, 5, 3), 9), np.full((1, 5, 120, 3), 1))[0]


def damage(frame: bytes, faults: Faults, seed: int = 0) -> tuple[bytes, str | None]:
    return with_fault(frame, faults, wire.with_heads, np.random.default_rng(seed))


def test_faults_are_read():
    asked = parse_faults("bitflip:0.01, truncate:.5,head:0.25,stall:2@5,stall:1@0.5,unplug@9")
    assert asked == Faults(bitflip=0.01, truncate=0.5, head=0.25, stalls=((0.5, 1.0), (5.0, 2.0)), unplug=(9.0, None))
    assert parse_faults("unplug:1.5@3").unplug == (3.0, 1.5)
    assert parse_faults("burst:0.016") == Faults(burst_s=0.016)
    assert parse_faults("") == NO_FAULTS


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("bitflop:0.1", "unknown fault 'bitflop'\n.*\n.*\n  do: did you mean 'bitflip'"),
        ("bitflip", "'bitflip' is not well formed"),
        ("bitflip:x", "'bitflip:x' is not well formed\n  expected: bitflip:P"),
        ("bitflip:-1", "is not well formed"),
        ("bitflip:nan", "is not well formed"),
        ("bitflip:0.1,bitflip:0.1", "once"),
        ("stall:2", "'stall:2' is not well formed\n  expected: stall:S@T"),
        ("stall@2", "is not well formed"),
        ("unplug", "is not well formed"),
        ("unplug@1,unplug@2", "once"),
        ("bitflip:0.6,garbage:0.6", "sum to more than 1"),
        ("burst", "'burst' is not well formed\n  expected: burst:S"),
        ("burst:0.016,burst:0.004", "once"),
        ("burst:0", "a burst of this period is none\n  expected: 0.001 to 0.255 s, as latency timers have"),
        ("burst:16", "found: 16 s"),
    ],
)
def test_faults_that_mean_nothing_are_refused(text, problem):
    with pytest.raises(UsageError, match=problem):
        parse_faults(text)


def test_no_faults_change_nothing():
    assert damage(STATE, NO_FAULTS) == (STATE, None)


def test_a_flipped_bit_is_one_bit():
    data, name = damage(STATE, Faults(bitflip=1.0))
    odd = np.bitwise_xor(np.frombuffer(data, np.uint8), np.frombuffer(STATE, np.uint8))
    assert (name, int(np.unpackbits(odd).sum())) == ("bitflip", 1)


def test_a_truncated_frame_is_a_beginning():
    data, name = damage(STATE, Faults(truncate=1.0))
    assert name == "truncate"
    assert 0 < len(data) < len(STATE)
    assert STATE.startswith(data)


def test_garbage_is_no_frame_of_the_same_length():
    data, name = damage(STATE, Faults(garbage=1.0))
    assert (name, len(data)) == ("garbage", len(STATE))
    made = device("xhand").framer()
    assert made.feed(data, 0) + made.finish() == []


@pytest.mark.parametrize("frame", [COMMAND, STATE], ids=["command", "state"])
def test_heads_inside_change_nothing_that_is_said(frame):
    data, name = damage(frame, Faults(head=1.0))
    assert name == "head"
    assert data.count(wire.HEAD) > 1
    made = device("xhand").framer()
    (found,) = made.feed(data, 0)
    assert found.data == data
    model = device("xhand")
    if found.kind == "command":
        assert (model.decode_commands([data, frame]).joint_target == 0.5).all()
    else:
        read = model.decode_states([data, frame])
        for name in ("joint_position", "motor_temperature", "force_counts", "taxel_counts"):
            values = getattr(read, name)
            np.testing.assert_array_equal(values[0], values[1])


def test_only_frames_of_the_hand_hide_heads():
    with pytest.raises(UsageError, match="only a command or a state"):
        wire.with_heads(wire.version_request())


def test_shares_are_shares_and_seeds_repeat():
    faults = Faults(bitflip=0.1, truncate=0.2, garbage=0.3)
    rng = np.random.default_rng(4)
    first = [with_fault(COMMAND, faults, wire.with_heads, rng) for _ in range(2000)]
    rng = np.random.default_rng(4)
    assert [with_fault(COMMAND, faults, wire.with_heads, rng) for _ in range(2000)] == first
    names = [name for _, name in first]
    for name, share in (("bitflip", 0.1), ("truncate", 0.2), ("garbage", 0.3), (None, 0.4), ("head", 0.0)):
        # Four standard deviations of a share among 2000.
        assert names.count(name) / 2000 == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 2000))
