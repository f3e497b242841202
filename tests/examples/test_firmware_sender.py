"""The reference sender of the framed format: candata understands it, whatever it sends."""

from __future__ import annotations

import io

import numpy as np
import pytest

from candata.record.devices import _cobs_frames as cobs
from candata.record.devices import stream


@pytest.fixture(scope="module")
def sender(loaded):
    return loaded("firmware_sender/sender.py")


def test_what_it_sends_is_decoded(sender, monkeypatch):
    monkeypatch.setattr(sender.time, "sleep", lambda _seconds: None)
    port, device = io.BytesIO(), stream("cobs")
    sender.run(port, frames=sender.RATE_HZ + 5)
    framer = device.framer()
    states = [f.data for f in framer.feed(port.getvalue(), 1) if f.kind == "state"]
    values = device.values(states)
    assert len(states) == sender.RATE_HZ + 5
    assert framer.counts["frames"] == len(states) + 2
    assert {name: count for name, count in framer.counts.items() if count and name not in ("frames", "bytes")} == {}
    np.testing.assert_allclose(values["joint_position"][3], sender.read(3)[:2], rtol=1e-6)
    np.testing.assert_allclose(values["tip_force"], 1.25)
    assert (np.diff(values["device_time"]) >= 0).all()


@pytest.mark.parametrize("size", [0, 1, 249, 250, 251, 254, 255, 508, 600])
def test_its_stuffing_is_that_of_the_recorder(sender, size):
    for body in (b"\x01" * size, bytes(size), np.random.default_rng(size).bytes(size)):
        body = b"\x01\x01" + body
        assert cobs.body_of(sender.frame(body)[:-1]) == body
        assert b"\0" not in sender.frame(body)[:-1]
