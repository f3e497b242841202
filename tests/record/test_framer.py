"""Cutting bytes into frames: whatever the bytes, however they are read."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candata.record.devices import Frame, device
from candata.record.devices import _xhand_frames as wire
from candata.record.devices._wire import HeadFramer, wire_time_ns

BYTE_NS = 10e9 / 3e6
HEAD_IN_PAYLOAD = b"\x55\xaa\xfe\x80\x02\x20\x01"


def framer() -> HeadFramer:
    return device("xhand").framer()


def cut(stream: bytes, *sizes: int) -> list[Frame]:
    """Frames of a stream that is read in pieces of these sizes, the last size again and again, then ends."""
    made, frames, at = framer(), [], 0
    pieces = list(sizes)
    while at < len(stream):
        size = pieces.pop(0) if len(pieces) > 1 else pieces[0]
        frames += made.feed(stream[at : at + size], at)
        at += size
    return frames + made.finish()


def data(frames: list[Frame]) -> list[bytes]:
    return [frame.data for frame in frames]


@pytest.fixture(scope="module")
def sent() -> list[bytes]:
    """Twelve frames: four requests, four replies, four of another kind with heads in their payload."""
    rng = np.random.default_rng(5)
    commands = wire.command_frames(rng.normal(size=(4, 12)))
    counts = rng.integers(wire.COUNT_LOW, wire.COUNT_HIGH, (4, 605, 3), endpoint=True)
    states = wire.state_frames(rng.normal(size=(4, 12)), counts[:, :5], counts[:, 5:].reshape(4, 5, 120, 3))
    payload = HEAD_IN_PAYLOAD * 3
    prefix = wire.HEAD + bytes((0x80, 0xFE, 0x77)) + len(payload).to_bytes(2, "little")
    others = [wire.seal(prefix + bytes([k]) + payload[1:]) for k in range(4)]
    return [frame for group in zip(commands, states, others, strict=True) for frame in group]


def test_kinds_are_told_by_length_alone(sent):
    assert [frame.kind for frame in cut(b"".join(sent), 4096)] == ["command", "state", "other"] * 4
    odd_ids = wire.seal(wire.HEAD + b"\x01\x02\x99" + sent[1][5:-2])
    assert [frame.kind for frame in cut(odd_ids, 100)] == ["state"]


@pytest.mark.parametrize("size", [1, 2, 6, 7, 8, 296, 297, 298, 1000, 4096, 10**6])
def test_how_it_is_read_changes_nothing(sent, size):
    assert data(cut(b"".join(sent), size)) == sent


def test_a_cut_at_any_place_changes_nothing(sent):
    stream = b"".join(sent[:3])
    assert all(data(cut(stream, place, 10**6)) == sent[:3] for place in range(1, len(stream)))


def test_heads_in_a_payload_break_nothing(sent):
    state = bytearray(sent[1])
    for place in range(400, 2000, 97):
        state[place : place + 7] = HEAD_IN_PAYLOAD
    whole = wire.seal(bytes(state[:-2]))
    made = framer()
    assert data(made.feed(whole + sent[0], 0)) == [whole, sent[0]]
    assert made.counts["crc_failures"] == 0


def test_a_whole_frame_in_a_payload_is_payload(sent):
    outer = wire.seal(wire.HEAD + b"\x80\xfe\x02" + len(sent[0]).to_bytes(2, "little") + sent[0])
    assert data(cut(outer, 10)) == [outer]


@pytest.mark.parametrize("length", [1, 2, 3, 6, 7, 8, 100, 1500, 2216])
def test_behind_a_truncated_frame_every_frame_is_found(sent, length):
    made = framer()
    found = made.feed(sent[1][:length] + b"".join(sent[2:]), 0)
    assert data(found + made.finish()) == sent[2:]


def test_a_wrong_length_delays_by_no_more_than_the_longest_frame(sent):
    """The longest length that is believed holds what follows back until 8201 bytes have come, and loses none."""
    bad = wire.HEAD + b"\x80\xfe\x02" + (wire.PAYLOAD_MAX).to_bytes(2, "little")
    made = framer()
    behind = b"".join(sent * 2)[: wire.PAYLOAD_MAX + 2]
    assert made.feed(bad + behind[:-1], 0) == []
    assert len(made.feed(behind[-1:], 0)) > 0
    assert made.counts["crc_failures"] == 1


def test_a_length_beyond_the_longest_delays_nothing(sent):
    bad = wire.HEAD + b"\x80\xfe\x02" + (wire.PAYLOAD_MAX + 1).to_bytes(2, "little")
    made = framer()
    assert data(made.feed(bad + sent[0], 0)) == [sent[0]]
    assert made.counts["oversize"] == 1


def test_the_longest_payload_is_a_frame():
    prefix = wire.HEAD + b"\x80\xfe\x02" + (wire.PAYLOAD_MAX).to_bytes(2, "little")
    longest = wire.seal(prefix + bytes(wire.PAYLOAD_MAX))
    assert data(cut(longest, 4096)) == [longest]


def test_the_end_of_a_stream_gives_up_the_wait(sent):
    bad = wire.HEAD + b"\x80\xfe\x02" + (wire.PAYLOAD_MAX).to_bytes(2, "little")
    made = framer()
    assert made.feed(bad + sent[0] + sent[2] + sent[1][:50], 0) == []
    assert data(made.finish()) == [sent[0], sent[2]]
    assert made.held_bytes == 0
    assert data(made.feed(sent[1], 1)) == [sent[1]]


def test_a_frame_is_stamped_at_its_first_byte(sent):
    """Read at t with 300 bytes behind it: the first byte was on the wire (size + 300) x 10 bits before t."""
    made = framer()
    made.feed(sent[0][:100], 1_000_000_000)
    (frame,) = made.feed(sent[0][100:] + sent[1][:300], 2_000_000_000)
    # Whole nanoseconds: 1 ns for the rounding down.
    assert frame.stamp_ns == pytest.approx(2e9 - (297 + 300) * BYTE_NS, abs=1)
    (frame,) = made.feed(sent[1][300:], 3_000_000_000)
    assert frame.stamp_ns == pytest.approx(3e9 - 2217 * BYTE_NS, abs=1)


def test_wire_time():
    assert wire_time_ns(2217 + 297, 3_000_000) == pytest.approx(8.38e6, rel=1e-3)  # the published 8.38 ms


def test_stamps_increase_even_where_reads_do_not(sent):
    made = framer()
    stamps = [frame.stamp_ns for piece in sent for frame in made.feed(piece, 7)]
    assert (np.diff(stamps) > 0).all()


def test_nothing_fed_is_nothing_met():
    made = framer()
    assert made.feed(b"", 5) == [] == made.finish()
    assert set(made.counts.values()) == {0}


def mutate(rng: np.random.Generator, sent: list[bytes]) -> tuple[bytes, list[bytes]]:
    """A stream of a few frames with one to three damages, and the frames that no damage touched."""
    frames = [sent[int(k)] for k in rng.integers(0, len(sent), 3)]
    parts: list[bytes] = []
    whole: list[bytes] = []
    damaged = set(rng.integers(0, 3, rng.integers(1, 4)).tolist())
    for k, frame in enumerate(frames):
        if k not in damaged:
            parts.append(frame)
            whole.append(frame)
            continue
        place = int(rng.integers(0, len(frame)))
        match rng.integers(0, 5):
            case 0:
                parts.append(frame[:place] + bytes([frame[place] ^ (1 << int(rng.integers(8)))]) + frame[place + 1 :])
            case 1:
                parts.append(frame[:place])
            case 2:
                parts.append(frame[:place] + frame[place + 1 :])
            case 3:
                parts.append(frame[:place] + HEAD_IN_PAYLOAD[: int(rng.integers(1, 8))] + frame[place:])
            case _:
                parts.append(rng.bytes(place))
    return b"".join(parts), whole


def test_ten_thousand_mutated_streams(sent):
    """None raises, none holds more than one frame, and each frame that no damage touched comes out, in order."""
    rng = np.random.default_rng(11)
    for _ in range(10_000):
        stream, whole = mutate(rng, sent)
        made = framer()
        place = int(rng.integers(0, len(stream) + 1))
        found = made.feed(stream[:place], 0) + made.feed(stream[place:], 1)
        assert made.held_bytes < wire.LAYOUT.longest_bytes
        found += made.finish()
        counts = made.counts
        assert counts["bytes"] == len(stream) == sum(len(f.data) for f in found) + counts["garbage_bytes"]
        rest = iter(data(found))
        assert all(frame in rest for frame in whole)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(st.one_of(st.binary(max_size=300), st.just(wire.HEAD), st.just(HEAD_IN_PAYLOAD)), max_size=40))
def test_any_bytes_are_survived_and_counted(pieces):
    made = framer()
    found = [frame for k, piece in enumerate(pieces) for frame in made.feed(piece, k)]
    assert made.held_bytes < wire.LAYOUT.longest_bytes
    found += made.finish()
    counts = made.counts
    assert counts["bytes"] == sum(map(len, pieces)) == sum(len(f.data) for f in found) + counts["garbage_bytes"]
    assert counts["frames"] == len(found)


def test_a_long_noise_is_not_kept():
    made = framer()
    for k in range(50):
        made.feed(np.random.default_rng(k).bytes(20_000), k)
        assert made.held_bytes < wire.LAYOUT.longest_bytes
    made.finish()
    assert made.counts["garbage_bytes"] == made.counts["bytes"] == 10**6


def test_small_reads_are_not_remembered(sent):
    """300 kB in pieces of ten bytes: what is kept for each read would be 2 MB."""
    made, stream = framer(), b"".join(sent) * 30
    tracemalloc.start()
    for place in range(0, len(stream), 10):
        made.feed(stream[place : place + 10], place)
    kept, _peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(stream) > 300_000
    # One unfinished frame of 2217 bytes, the reads that brought it, and the lists' room to grow.
    assert kept < 100_000
