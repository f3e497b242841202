"""`record-real` with streams beside the hand, as its user types it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from candata.record.devices import stream
from candata.record.logs import read_log
from tests.record.conftest import HandOnPty, frames_of
from tests.record.streams import free_port, udp_sender

POSE = stream("pose_lines")


def pose_line(number: int) -> bytes:
    pose = np.array([[0.001 * number, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]])
    return POSE.encode({"device_time": np.array([number * 10_000_000]), "object_pose": pose})[0]


@pytest.fixture
def candata(capsys):
    """Runs a command in this process: exit code, stdout, stderr."""
    from candata_cli import main as entry

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            entry.main([str(a) for a in arguments])
        return stop.value.code or 0, *capsys.readouterr()

    return run


@pytest.fixture
def hand(tmp_path):
    """Makes one resting hand on a pseudo-terminal."""
    made: list[HandOnPty] = []

    def make(silent: bool = False) -> HandOnPty:
        made.append(HandOnPty(str(tmp_path / "port"), frames_of(), False, silent))
        return made[-1]

    yield make
    for one in made:
        one.unplug()


BASE = ("--no-calibrate", "--reserve-mb", 0)


def test_a_pose_is_recorded_shown_and_reported(hand, tmp_path, candata):
    port, log = free_port(), tmp_path / "l.mcap"
    where = ("--port", hand().port, "--out", log, "--pose", f"udp://127.0.0.1:{port}?object=object")
    with udp_sender(port, 50.0, pose_line):
        code, out, err = candata("record-real", *where, *BASE, "--duration", 1.4, "--plain")
    assert code == 0, err
    assert "| pose: " in err
    rows = read_log(log).streams[0]
    assert f"pose       pose_lines: {len(rows.time_ns)} frames" in out
    assert rows.meta.settings == {"object": "object"}
    numbers = np.round(rows.values["object_pose"][:, 0] * 1000).astype(int)
    np.testing.assert_array_equal(numbers, np.arange(numbers[0], numbers[0] + len(numbers)))


def test_a_log_is_recorded_again_with_all_its_streams(hand, tmp_path, candata):
    port, first, second = free_port(), tmp_path / "a.mcap", tmp_path / "b.mcap"
    where = ("--port", hand().port, "--out", first, "--pose", f"udp://127.0.0.1:{port}")
    with udp_sender(port, 50.0, pose_line):
        candata("record-real", *where, *BASE, "--duration", 0.8)
    code, out, err = candata("record-real", "--device", "replay", "--port", first, "--out", second, *BASE, "--json")
    assert code == 0, err
    assert json.loads(out)["ended"] == "replayed"
    before, after = (read_log(path) for path in (first, second))
    np.testing.assert_array_equal(before.joint_position, after.joint_position)
    np.testing.assert_array_equal(before.streams[0].values["object_pose"], after.streams[0].values["object_pose"])
    np.testing.assert_array_equal(np.diff(before.streams[0].time_ns), np.diff(after.streams[0].time_ns))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--stream", "arm"), "NAME=DEVICE@ADDRESS"),
        (("--stream", "x=toaster@/dev/null"), "toaster"),
        (("--stream", "x=xhand@/dev/null"), "is a hand, not a stream"),
        (("--pose", "udp://a b:1"), "not an address of the network"),
        (("--pose", "udp://127.0.0.1:70000"), "PORT from 1 to 65535"),
        (("--pose", "file://x"), "is not heard so"),
        (("--wrench", "udp://127.0.0.1:4000"), "a serial port"),
        (("--wrench", "/dev/no-such-port"), "no such port"),
        (("--wrench", "/dev/null?baud=fast"), "a whole number above zero"),
        (("--wrench", "/dev/null?zero=1"), "has no settings"),
        (("--poll", "0,0,0"), "does not say every joint"),
        (("--calibrate-s", "inf"), "a finite number"),
        (("--poll", ",".join(["9"] * 12)), "leaves the limits of thumb_bend"),
    ],
)
def test_what_is_typed_wrongly_is_one_error_and_no_log(hand, tmp_path, candata, options, words):
    one = hand(silent=True)
    code, _, err = candata("record-real", "--port", one.port, "--out", tmp_path / "l.mcap", *BASE, *options)
    assert code != 0
    assert words in err
    assert "Traceback" not in err
    assert not (tmp_path / "l.mcap").exists()
    assert one.heard() == b""


def test_a_set_point_is_read_from_a_file(tmp_path):
    from candata.errors import UsageError
    from candata.record.devices import hand as hand_device
    from candata.record.poll import read_posture

    device, path = hand_device("xhand"), tmp_path / "posture.csv"
    names = list(device.joint_names)
    path.write_text(",".join(names[::-1]) + "\n" + ",".join(f"{0.01 * k}" for k in range(12)) + "\n")
    assert read_posture(str(path), device)[0] == pytest.approx(0.11)
    path.write_text(",".join(names[1:]) + "\n" + ",".join(["0"] * 11) + "\n")
    with pytest.raises(UsageError, match="lacks joints"):
        read_posture(str(path), device)
    for damaged in (",".join(names) + "\n0,0,0\n", b"\xff\xfe\x00"):
        path.write_bytes(damaged if isinstance(damaged, bytes) else damaged.encode())
        with pytest.raises(UsageError):
            read_posture(str(path), device)
    digits = ",".join(["0.1234567890123456789012"] * 12)
    assert read_posture(digits, device) == pytest.approx((0.1234567890123456789012,) * 12)
