"""Mutated bytes of every stream device: no crash, frames that decode, none wrong beyond the odds of its check."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.record.devices import stream
from tests.mutated.mutations import mutated

#: A damaged frame passes one time in 2 to that power; 0: the socket has a check. A Paxini's eight bits are a plain sum,
#: to which one bit that is set and the same bit cleared elsewhere cancel: of mixed damage it lets pass twice as much.
CHECK_BITS = {"cobs": 32, "ft300": 16, "paxini": 7, "pose_lines": 0, "xarm": 0}
#: Sound frames in an input, before it is mutated.
FRAMES = 3


@dataclass
class StreamTally:
    """What came of the inputs of a device: inputs, sound frames, wrong frames, frames that failed their check."""

    inputs: int = 0
    sound: int = 0
    wrong: int = 0
    refused: int = 0

    def most_wrong(self, bits: int) -> float:
        """Return how many wrong frames the odds of a check of so many bits explain, with room for chance."""
        expected = (self.refused + self.wrong) / 2**bits
        return 3 + expected + 5 * expected**0.5


def sound_frames(name: str, seed: int = 1) -> list[bytes]:
    """Twelve frames of a device, random values."""
    rng = np.random.default_rng(seed)
    rows = 12
    values = {
        "cobs": {"joint_position": rng.normal(size=(rows, 6))},
        "ft300": {"wrench": rng.normal(size=(rows, 6))},
        "paxini": {"taxels": rng.integers(0, 100, (rows, 1, 120, 3))},
        "pose_lines": {
            "object_pose": np.hstack([rng.uniform(-1, 1, (rows, 3)), np.tile([0.96, 0, 0, 0.28], (rows, 1))])
        },
        "xarm": {
            "device_time": 10**9 + 5_000_000 * np.arange(rows),
            "joint_position": rng.uniform(-1, 1, (rows, 7)),
            "joint_target": rng.uniform(-1, 1, (rows, 7)),
        },
    }
    encode = stream(name).encode
    assert encode is not None
    return encode(values[name])


def require_plausible(values: dict[str, NDArray]) -> None:
    """Claim that joints lie within a turn and a bit, and poses within reach, with unit quaternions."""
    assert all(np.size(block) for block in values.values())
    for name in {"joint_position", "joint_target"} & set(values):
        assert np.abs(values[name]).max() < 7
    if "object_pose" in values:
        pose = values["object_pose"]
        assert np.linalg.norm(pose[:, :3]) <= 3
        assert abs(np.linalg.norm(pose[:, 3:]) - 1) < 1e-9


def fuzz(name: str, inputs: int, seed: int) -> StreamTally:
    """Feed `inputs` mutated streams to fresh framers of a device and decode what comes out."""
    device, rng, tally = stream(name), random.Random(seed), StreamTally(inputs)
    frames = sound_frames(name)
    whole = b"".join(frames)
    sound = {frame.data for frame in device.framer().feed(whole, 0) if frame.kind == "state"}
    for _ in range(inputs):
        begin = rng.randrange(len(frames) - FRAMES)
        # Without its hello nothing of a self-describing stream is a state.
        head = frames[0] if device.signals_of else b""
        data = mutated(head + b"".join(frames[begin : begin + FRAMES]), [whole], rng)
        framer, place = device.framer(), rng.randrange(len(data) + 1)
        found = framer.feed(data[:place], 1) + framer.feed(data[place:], 2) + framer.finish()
        states = [frame.data for frame in found if frame.kind == "state"]
        for frame in states:
            require_plausible(device.values([frame]))
        wrong = sum(frame not in sound for frame in states)
        tally.wrong += wrong
        tally.sound += len(states) - wrong
        counts = framer.counts
        tally.refused += counts["crc_failures"]
        assert counts["bytes"] == len(data)
        device.findings(framer)
    return tally
