"""Devices beside the hand: known bytes, values back within the wire's resolution, and what is told of wrong streams."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from candata.errors import DataError, UnknownNameError, UsageError
from candata.record.devices import Framer, Signal, StreamDevice, stream
from candata.record.devices import _cobs_frames as cobs
from candata.record.devices.ft300 import modbus_crc

ROWS = 20
RNG = np.random.default_rng(3)
YAW = np.linspace(0, 0.8, ROWS)
POSES = np.zeros((ROWS, 7))
POSES[:, 0], POSES[:, 1], POSES[:, 2] = 0.4, np.linspace(-0.1, 0.1, ROWS), 0.03
POSES[:, 3], POSES[:, 6] = np.cos(YAW / 2), np.sin(YAW / 2)


def under(name: str, **settings: str) -> StreamDevice:
    """The device under settings."""
    device = stream(name)
    assert device.configured is not None
    return device.configured(settings)


def heard(device: StreamDevice, data: bytes) -> tuple[dict[str, np.ndarray], Framer, tuple[str, ...]]:
    """Values, framer and findings after a stream."""
    framer = device.framer()
    states = [f.data for f in [*framer.feed(data, 10**9), *framer.finish()] if f.kind == "state"]
    return (device.values(states) if states else {}), framer, device.findings(framer)


def encoded(name: str, **values: np.ndarray) -> bytes:
    encode = stream(name).encode
    assert encode is not None
    return b"".join(encode(values))


# --- xarm


def report(size: int = 804, time: int = 77, angle: float = 0.5) -> bytes:
    """A report written by its documented layout, without the device's file."""
    head = struct.pack(">IQBH", size, time, 0x21, 3) + bytes(17)
    blocks = [[0.1] * 7, [0.2] * 7, [0.0] * 7, [angle] * 7, [0.3] * 7, [0.0] * 7, [1.5] * 7, [2.0] * 7]
    body = head + b"".join(struct.pack("<7f", *block) for block in blocks)
    return body + bytes(size - len(body))


def test_a_report_of_the_documented_layout_is_read():
    values, _framer, findings = heard(stream("xarm"), report())
    assert values["device_time"].tolist() == [77_000]
    assert values["joint_target"] == pytest.approx(np.full((1, 7), 0.1))
    assert values["joint_position"] == pytest.approx(np.full((1, 7), 0.5))
    assert values["joint_velocity"] == pytest.approx(np.full((1, 7), 0.3))
    assert values["joint_effort"] == pytest.approx(np.full((1, 7), 2.0))
    assert findings == ()


def test_a_connection_in_the_middle_of_a_report_costs_that_report_only():
    data = b"".join(report(time=k) for k in range(5))
    values, framer, _findings = heard(stream("xarm"), data[301:])
    assert values["device_time"].tolist() == [1000, 2000, 3000, 4000]
    assert framer.counts["garbage_bytes"] == 804 - 301


def test_settings_of_the_arm():
    values, _framer, _findings = heard(under("xarm", joints="6", clock="ns", bytes="900"), report(900))
    assert values["joint_position"].shape == (1, 6)
    assert values["device_time"].tolist() == [77]
    assert heard(under("xarm", bytes="804"), report(900) * 3)[0] == {}
    for settings in ({"joints": "9"}, {"clock": "s"}, {"bytes": "20"}, {"bytes": "many"}):
        with pytest.raises(UsageError):
            under("xarm", **settings)
    with pytest.raises(UnknownNameError, match="joints"):
        under("xarm", joint="6")


@pytest.mark.parametrize(("size", "port"), [(87, 30003), (135, 30003)])
def test_the_report_of_another_port_is_told(size, port):
    other = struct.pack(">I", size) + b"\x21" * (size - 4)
    values, _framer, findings = heard(stream("xarm"), other * 10)
    assert values == {}
    assert f"port {port}" in findings[0]


def test_joints_that_no_arm_has_are_no_report():
    assert heard(stream("xarm"), report(angle=57.3) + report(angle=float("nan")))[0] == {}


# --- pose lines


def test_a_line_as_documented_is_read():
    line = b"candata-pose 1 1700000000.123456789 mug 0.4 -0.1 0.03 0.6 0 0 0.8 0.97\n"
    values, _framer, _findings = heard(stream("pose_lines"), line)
    assert values["device_time"].tolist() == [1_700_000_000_123_456_789]
    assert values["object_pose"] == pytest.approx(np.array([[0.4, -0.1, 0.03, 0.6, 0, 0, 0.8]]))
    assert values["score"] == pytest.approx([0.97])


MALFORMED = {
    "word": b"pose 1 0 mug 0 0 0 1 0 0 0\n",
    "short": b"candata-pose 1 0 mug 0 0 0 1 0 0\n",
    "long": b"candata-pose 1 0 mug 0 0 0 1 0 0 0 1 1\n",
    "text": b"candata-pose 1 0 mug 0 0 zero 1 0 0 0\n",
    "nan": b"candata-pose 1 0 mug 0 0 nan 1 0 0 0\n",
    "huge": b"candata-pose 1 0 mug 0 0 0 1e308 1e308 0 0\n",
    "time": b"candata-pose 1 1e400 mug 0 0 0 1 0 0 0\n",
    "no_unit": b"candata-pose 1 0 mug 0 0 0 1 1 0 0\n",
    "underscore": b"candata-pose 1 0 mug 0 0 1_0 1 0 0 0\n",
    "bytes": b"candata-pose 1 0 \xff\xfe 0 0 0 1 0 0 0\n",
}


@pytest.mark.parametrize("kind", sorted(MALFORMED))
def test_malformed_lines_are_counted_and_told(kind):
    good = encoded("pose_lines", object_pose=POSES)
    values, framer, findings = heard(stream("pose_lines"), good + MALFORMED[kind] + good)
    assert framer.counts["malformed"] == 1
    assert len(values["object_pose"]) == 2 * ROWS
    assert "left out" in findings[0]


def test_another_version_and_lines_without_an_end_are_told():
    _values, framer, findings = heard(stream("pose_lines"), b"candata-pose 2 0 mug 0 0 0 1 0 0 0\n")
    assert framer.counts["other_version"] == 1
    assert "version" in findings[0]
    values, framer, findings = heard(stream("pose_lines"), b"candata-pose 1 0 mug 0 0 0 1 0 0 0" * 200)
    assert values == {}
    assert "line feed" in findings[0]


def lines_of(name: str, poses: np.ndarray) -> bytes:
    return encoded("pose_lines", object_pose=poses).replace(b" object ", b" %s " % name.encode())


def test_only_the_object_that_is_meant_is_taken():
    both = lines_of("cube", POSES[:1]) + lines_of("mug", POSES) + lines_of("cube", POSES)
    values, framer, findings = heard(stream("pose_lines"), both)
    assert len(values["object_pose"]) == ROWS + 1
    assert framer.counts["other_object"] == ROWS
    assert "cube, mug" in findings[0]
    assert "object=NAME" in findings[0]
    assert len(heard(under("pose_lines", object="mug"), both)[0]["object_pose"]) == ROWS


def test_millimetres_are_found_and_read_when_told():
    millimetres = POSES * ([1000] * 3 + [1] * 4)
    values, framer, findings = heard(stream("pose_lines"), encoded("pose_lines", object_pose=millimetres))
    assert values == {}
    assert framer.counts["beyond_reach"] == ROWS
    assert "unit=mm" in findings[0]
    told, _framer, findings = heard(under("pose_lines", unit="mm"), encoded("pose_lines", object_pose=millimetres))
    assert told["object_pose"] == pytest.approx(POSES, abs=1e-9)
    assert findings == ()


def test_quaternions_x_y_z_w_are_found_and_read_when_told():
    swapped = encoded("pose_lines", object_pose=POSES[:, [0, 1, 2, 4, 5, 6, 3]])
    values, framer, findings = heard(stream("pose_lines"), swapped)
    assert values == {}
    assert framer.counts["order_doubtful"] == ROWS
    assert "order=xyzw" in findings[0]
    assert heard(under("pose_lines", order="xyzw"), swapped)[0]["object_pose"] == pytest.approx(POSES, abs=1e-8)
    # An object that does begin half a turn away is read as documented once its user says so.
    as_sent, _framer, findings = heard(under("pose_lines", order="wxyz"), swapped)
    assert as_sent["object_pose"][:, 6] == pytest.approx(POSES[:, 3], abs=1e-8)
    assert findings == ()


def test_an_order_that_nothing_tells_is_said_to_be_unknown():
    tilted = np.tile([0.4, 0, 0.1, 0.5, 0.5, 0.5, 0.5], (ROWS, 1))
    values, _framer, findings = heard(stream("pose_lines"), encoded("pose_lines", object_pose=tilted))
    assert len(values["object_pose"]) == ROWS
    assert "cannot be told" in findings[0]


# --- ft300


def test_the_published_check_sum():
    assert modbus_crc(b"123456789") == 0x4B37


def test_a_message_of_the_manual_is_read():
    body = b"\x20\x4e" + struct.pack("<6h", 1234, -250, 0, 1500, -1, 32767)
    values, _framer, findings = heard(stream("ft300"), body + struct.pack("<H", modbus_crc(body)))
    assert values["wrench"] == pytest.approx(np.array([[12.34, -2.5, 0, 1.5, -0.001, 32.767]]))
    assert findings == ()


def test_another_baud_rate_is_told():
    values, framer, findings = heard(stream("ft300"), RNG.bytes(5000))
    assert values == {}
    assert framer.counts["garbage_bytes"] == 5000
    assert "19200" in findings[0]


def test_frames_are_stamped_at_their_first_byte():
    framer = stream("ft300").framer()
    (frame,) = framer.feed(encoded("ft300", wrench=np.zeros((1, 6))), 10**9)
    assert frame.stamp_ns == pytest.approx(10**9 - 16 * 10 / 19200 * 1e9, abs=1)


# --- paxini


def test_taxels_come_back_and_requests_are_no_states():
    counts = np.dstack([RNG.integers(-128, 128, (4, 120, 2)), RNG.integers(0, 256, (4, 120, 1))])[:, None]
    request = bytes.fromhex("55aa7b7b 0e0070c0060500 7b 0e046801 90 55aa7d7d")
    device = under("paxini", tip="thumb")
    replies = encoded("paxini", taxels=counts)
    size = len(replies) // 4
    values, framer, _findings = heard(device, b"".join(request + replies[k * size :][:size] for k in range(4)))
    np.testing.assert_array_equal(values["taxels"], counts)
    assert framer.counts["frames"] == 4
    assert device.signals[0].names == ("thumb",)


def test_a_check_byte_of_another_rule_is_told_and_can_be_left_out():
    reply = bytearray(encoded("paxini", taxels=np.zeros((1, 1, 120, 3))))
    reply[-5] ^= 0x5A
    values, _framer, findings = heard(stream("paxini"), bytes(reply) * 12)
    assert values == {}
    assert "check=none" in findings[0]
    assert len(heard(under("paxini", check="none"), bytes(reply) * 12)[0]["taxels"]) == 12


# --- cobs


HELLO = cobs.hello_of(
    [Signal("joint_position", (2,), "deg", ("a", "b")), Signal("object_pose", (7,), "mm"), Signal("battery", (), "V")],
    50.0,
)
VALUES = np.array([90.0, -180.0, 400, 0, 30, 1, 0, 0, 0, 3.7])


@pytest.mark.parametrize("data", [b"", b"\0", b"a", b"\0\0a\0", b"x" * 253, b"x" * 254, b"x" * 255, b"x" * 600 + b"\0"])
def test_stuffing_leaves_no_zero_and_comes_back(data):
    assert b"\0" not in cobs.stuff(data)
    assert cobs.unstuff(cobs.stuff(data)) == data


def test_the_published_examples_of_stuffing():
    assert cobs.stuff(bytes.fromhex("11220033")) == bytes.fromhex("0311220233")
    assert cobs.stuff(bytes.fromhex("1100000000")[:4]) == bytes.fromhex("0211010101")


def test_the_hello_names_signals_units_and_joints():
    data = HELLO.frame() + b"".join(HELLO.data_frame(k, 1_000 * k, VALUES) for k in range(3))
    device = stream("cobs")
    values, framer, findings = heard(device, data)
    assert values["device_time"].tolist() == [0, 1_000_000, 2_000_000]
    assert values["joint_position"][0] == pytest.approx([np.pi / 2, -np.pi], abs=1e-6)
    assert values["object_pose"][0] == pytest.approx([0.4, 0, 0.03, 1, 0, 0, 0], abs=1e-6)
    assert values["battery"] == pytest.approx([3.7] * 3)
    states = [f.data for f in device.framer().feed(data, 5) if f.kind == "state"]
    assert [(s.name, s.unit) for s in device.held_signals(states[0])] == [
        ("device_time", "ns"),
        ("joint_position", "rad"),
        ("object_pose", "m"),
        ("battery", "V"),
    ]
    assert device.held_signals(states[0])[1].names == ("a", "b")
    assert framer.counts["lost"] == 0
    assert findings == ()


def test_lost_frames_are_counted_and_a_restart_is_none():
    numbers = [0, 1, 5, 6, 0, 1]
    data = HELLO.frame() + b"".join(HELLO.data_frame(k, 0, VALUES) for k in numbers)
    assert heard(stream("cobs"), data)[1].counts["lost"] == 3


def test_data_without_its_hello_is_told():
    values, framer, findings = heard(stream("cobs"), HELLO.data_frame(0, 0, VALUES) * 3)
    assert values == {}
    assert framer.counts["before_hello"] == 3
    assert "hello" in findings[0]


def test_a_hello_that_changes_is_told_and_its_data_are_left_out():
    other = cobs.hello_of([Signal("battery", (), "V")], 50.0)
    data = HELLO.frame() + HELLO.data_frame(0, 0, VALUES)
    values, framer, findings = heard(stream("cobs"), data + other.frame() + other.data_frame(1, 0, VALUES[:1]) + data)
    assert len(values["battery"]) == 2
    assert framer.counts["other_hello"] == 2
    assert "changed its hello" in findings[0]


def test_another_version_is_told():
    body = b"\x02\x00{}"
    _values, _framer, findings = heard(stream("cobs"), cobs.seal(body))
    assert "version 2" in findings[0]


def test_data_of_another_length_are_told():
    short = HELLO.data_frame(0, 0, VALUES[:-1])
    values, framer, findings = heard(stream("cobs"), HELLO.frame() + short)
    assert values == {}
    assert framer.counts["malformed"] == 1
    assert "left out" in findings[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"[]", "documented"),
        (b"\xff", "documented"),
        (b'{"rate_hz": 1, "signals": []}', "no signals"),
        (b'{"rate_hz": 0, "signals": [{"name": "a", "unit": "m"}]}', "range"),
        (b'{"rate_hz": 1, "signals": [{"name": "a", "unit": "furlong"}]}', "unit"),
        (b'{"rate_hz": 1, "signals": [{"name": "a", "unit": "m", "shape": [-1]}]}', "shape"),
        (b'{"rate_hz": 1, "signals": [{"name": "a", "unit": "m", "shape": [9999]}]}', "shape"),
        (b'{"rate_hz": 1, "signals": [{"name": "a", "unit": "m", "shape": [2], "names": ["b"]}]}', "names"),
    ],
)
def test_a_wrong_hello_is_told(text, said):
    _values, framer, findings = heard(stream("cobs"), cobs.seal(b"\x01\x00" + text))
    assert framer.counts["malformed"] == 1
    assert said in findings[0]


def test_frames_that_are_none_are_refused_by_decoders():
    for name in ("xarm", "pose_lines", "ft300", "paxini", "cobs"):
        with pytest.raises(DataError):
            stream(name).decode([b"no frame"])
