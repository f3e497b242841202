"""The line of an emulated hand: the link that leads to its port, and when its reader has taken everything."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

import pytest

from candata.errors import SetupError, UsageError
from candata.record import emulate_line
from candata.record.emulate_line import Line
from candata.record.emulate_streams import SerialOutlet


def test_a_port_that_is_empty_for_a_moment_is_not_read_out(monkeypatch):
    """The system hands on in pieces what was written: it looks empty between them."""
    looks = [100, 0, 0, 100, *[0] * 50]
    monkeypatch.setattr(emulate_line.fcntl, "ioctl", lambda *_: looks.pop(0).to_bytes(4, sys.byteorder))
    with Line() as line:
        reader = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
        line.drain(30.0)
        os.close(reader)
    assert len(looks) == 50 - emulate_line.EMPTY_POLLS


def test_frames_that_wait_for_a_late_reader_come_whole_and_in_order_or_not_at_all(tmp_path):
    frames = [bytes([number]) * 999 + b"\n" for number in range(100, 250)]
    outlet = SerialOutlet(tmp_path / "port")
    assert outlet.write(frames[0]) == 0  # nobody listens
    port = os.open(outlet.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    taken = [frame for frame in frames if outlet.write(frame) == len(frame)]
    assert 65 <= len(taken) < len(frames)
    heard = bytearray()
    for _ in range(100_000):
        if len(heard) == 1000 * len(taken):
            break
        outlet.write(b"")
        with suppress(BlockingIOError):
            heard += os.read(port, 4096)
    assert heard == b"".join(taken)
    os.close(port)
    outlet.close()


def test_a_link_replaces_a_link_and_nothing_else(tmp_path):
    link, file = tmp_path / "hand", tmp_path / "file"
    link.symlink_to("nowhere")
    file.write_text("kept")
    with Line(link) as line:
        assert os.readlink(link) == line.port
    assert not os.path.lexists(link)
    with pytest.raises(UsageError, match="the link's place is taken"):
        Line(file)
    assert file.read_text() == "kept"
    with pytest.raises(SetupError, match="the link cannot be made"):
        Line(tmp_path / "no" / "hand")
