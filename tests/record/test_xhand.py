"""Frames of the XHand: published bytes, and what goes in comes out."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from candata.errors import DataError, UsageError
from candata.plugins import load
from candata.record.devices import _xhand_frames as wire
from candata.record.devices import device, device_names

XHAND = device("xhand")


def state(position=None, force=None, taxels=None) -> bytes:
    """One state frame, zero but for what is given."""
    zeros = np.zeros(12), np.zeros((5, 3), int), np.zeros((5, 120, 3), int)
    given = [z if g is None else g for g, z in zip((position, force, taxels), zeros, strict=True)]
    return wire.state_frames(*(np.asarray(g)[None] for g in given))[0]


def test_it_is_registered():
    assert "xhand" in device_names()


def test_the_names_are_those_of_the_scene():
    hand = load("candata.scenes.hands", "HAND", "xhand")
    assert (XHAND.joint_names, XHAND.fingertip_names) == (hand.joints, hand.fingertips)


def test_the_published_check_value():
    assert wire.check_sum(b"123456789") == 0x31C3


def test_the_published_version_request():
    assert wire.version_request().hex(" ") == "55 aa fe 80 13 00 00 ef c3"


def test_the_published_command():
    (frame,) = wire.command_frames(np.zeros((1, 12)))
    assert len(frame) == 297
    assert frame[:11].hex(" ") == "55 aa fe 80 02 20 01 00 00 64 00"
    assert frame[-2:].hex(" ") == "3f 64"


def test_the_hand_id_is_in_the_target():
    assert wire.command_frames(np.zeros((1, 12)), hand=5)[0][3] == 0x85
    assert wire.version_request(5)[3] == 0x85


def test_every_byte_of_a_joint_command_is_where_it_belongs():
    (frame,) = wire.command_frames(np.arange(12.0)[None])
    for k in range(12):
        record = struct.unpack_from("<HhhhfHHHHHH", frame, 7 + 24 * k)
        assert record == (k, 100, 0, 10, float(k), 300, 3, 0, 0, 0, 0)


def test_every_byte_of_a_state_is_where_it_belongs():
    rng = np.random.default_rng(3)
    force = rng.integers(wire.COUNT_LOW, wire.COUNT_HIGH, (5, 3), endpoint=True)
    taxels = rng.integers(wire.COUNT_LOW, wire.COUNT_HIGH, (5, 120, 3), endpoint=True)
    frame = state(np.arange(12.0), force, taxels)
    assert len(frame) == 7 + 2208 + 2
    for k in range(12):
        record = struct.unpack_from("<BBfhHHHHHHHH", frame, 7 + 24 * k)
        assert record == (k, k, float(k), 0, 0, 25, 0, 0, 0, 0, 0, 0)
    for tip in range(5):
        start = 7 + 288 + 384 * tip
        assert struct.unpack_from("<bbB", frame, start) == tuple(force[tip])
        for n in range(120):
            assert struct.unpack_from("<bbB", frame, start + 3 + 3 * n) == tuple(taxels[tip, n])
        assert frame[start + 363 : start + 384] == bytes([25] * 21)


def test_a_hand_written_state_is_read():
    """Built field by field with struct, not with our writer."""
    joints = b"".join(
        struct.pack("<BBfhHHHHHHHH", k, k, 0.25 * k, -10 * k, 7, 30 + k, 0, 0, 0, 0, 0, 0) for k in range(12)
    )
    tips = b"".join(
        struct.pack("<bbB", -128, 127, 255)
        + b"".join(struct.pack("<bbB", n - 60, 60 - n, 200) for n in range(120))
        + bytes(21)
        for _ in range(5)
    )
    frame = wire.seal(b"\x55\xaa\x80\xfe\x02" + struct.pack("<H", 2208) + joints + tips)
    read = XHAND.decode_states([frame, frame])
    assert read.joint_position[1].tolist() == [0.25 * k for k in range(12)]
    # mA to A is one rounding of a float64.
    np.testing.assert_allclose(read.motor_current[0], [-0.01 * k for k in range(12)], rtol=1e-15)
    assert read.motor_temperature[0].tolist() == [30 + k for k in range(12)]
    assert read.force_counts[0].tolist() == [[-128, 127, 255]] * 5
    assert read.taxel_counts[1, 4, 119].tolist() == [59, -59, 200]


def test_the_normal_force_has_no_sign():
    read = XHAND.decode_states([state(force=[[0, 0, 200]] * 5)])
    assert (read.force_counts[0, :, 2] == 200).all()


def counts(shape):
    return hnp.arrays(np.int16, (*shape, 3), elements=st.integers(0, 255)).map(lambda c: c - [128, 128, 0])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    hnp.arrays(np.float32, 12, elements=st.floats(width=32)),
    counts((5,)).filter(lambda c: (c[..., :2] <= 127).all()),
    st.integers(0, 2**32 - 1),
)
def test_states_round_trip(position, force, seed):
    taxels = np.random.default_rng(seed).integers(wire.COUNT_LOW, wire.COUNT_HIGH, (5, 120, 3), endpoint=True)
    read = XHAND.decode_states([state(position, force, taxels)])
    np.testing.assert_array_equal(read.joint_position[0], position.astype(np.float64))
    np.testing.assert_array_equal(read.force_counts[0], force)
    np.testing.assert_array_equal(read.taxel_counts[0], taxels)
    assert (read.force_counts.dtype, read.taxel_counts.dtype) == (np.int16, np.int16)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(hnp.arrays(np.float32, (3, 12), elements=st.floats(width=32)))
def test_commands_round_trip(target):
    read = XHAND.decode_commands(wire.command_frames(target))
    np.testing.assert_array_equal(read.joint_target, target.astype(np.float64))


def test_any_bits_of_a_position_are_read_without_a_warning():
    """0x7F800001 is a signalling NaN: a damaged hand may send it, and no reader should fall over it."""
    body = bytearray(state()[:-2])
    body[9:13] = struct.pack("<I", 0x7F800001)
    assert np.isnan(XHAND.decode_states([wire.seal(bytes(body))]).joint_position[0, 0])


def test_no_frames_are_no_rows():
    assert XHAND.decode_states([]).taxel_counts.shape == (0, 5, 120, 3)
    assert XHAND.decode_commands([]).joint_target.shape == (0, 12)


def test_another_kind_of_frame_is_refused():
    with pytest.raises(DataError, match="no state frame"):
        XHAND.decode_states([state(), wire.version_request()])
    with pytest.raises(DataError, match="no command frame"):
        XHAND.decode_commands([state()])


@pytest.mark.parametrize(("value", "axis"), [(128, 0), (-129, 1), (-1, 2), (256, 2)])
def test_a_count_out_of_range_is_not_wrapped(value, axis):
    force = np.zeros((5, 3), int)
    force[2, axis] = value
    with pytest.raises(UsageError, match="force_counts is out of range"):
        state(force=force)


def test_wrong_shapes_are_refused():
    with pytest.raises(UsageError, match="joint_target has the wrong shape"):
        wire.command_frames(np.zeros((1, 11)))
    with pytest.raises(UsageError, match="as many rows"):
        wire.state_frames(np.zeros((2, 12)), np.zeros((1, 5, 3)), np.zeros((1, 5, 120, 3)))
