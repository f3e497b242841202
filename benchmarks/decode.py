"""Frames of the XHand through framer and decoder a CPU second, and against a loop that unpacks field by field.

    python benchmarks/decode.py

Requests and replies of random content, read in pieces of 4 kB as a serial port gives them, cut by the framer and
decoded a second's worth at a time. The loop reads the same frames, already cut, with one `struct.unpack_from` a joint
and a taxel. Both run one after the other in each round, so that a busy machine slows both. Time is the process's CPU
time.
"""

from __future__ import annotations

import argparse
import struct
import time
from collections.abc import Sequence

import numpy as np

from candata.record.devices import _xhand_frames as wire
from candata.record.devices import device

TARGET = 20_000
READ_BYTES = 4096
BATCH = 83


def stream(rows: int) -> list[bytes]:
    """Return `rows` requests and replies, by turns."""
    rng = np.random.default_rng(1)
    joints = rng.normal(size=(rows, 12))
    counts = rng.integers(wire.COUNT_LOW, wire.COUNT_HIGH, (rows, 5, 121, 3), endpoint=True)
    states = wire.state_frames(joints, counts[:, :, 0], counts[:, :, 1:])
    return [frame for pair in zip(wire.command_frames(joints), states, strict=True) for frame in pair]


def ours(data: bytes) -> tuple[float, int]:
    """Return the CPU time [s] of framer and decoder, and the number of frames."""
    model = device("xhand")
    begin = time.process_time()
    framer, count = model.framer(), 0
    held: dict[str, list[bytes]] = {"state": [], "command": [], "other": []}
    decode = {"state": model.decode_states, "command": model.decode_commands}
    for place in range(0, len(data), READ_BYTES):
        for frame in framer.feed(data[place : place + READ_BYTES], place):
            held[frame.kind].append(frame.data)
            count += 1
        for kind, decoder in decode.items():
            if len(held[kind]) >= BATCH:
                decoder(held[kind])
                held[kind] = []
    for kind, decoder in decode.items():
        decoder(held[kind])
    return time.process_time() - begin, count


def loop(frames: Sequence[bytes]) -> float:
    """Return the CPU time [s] of a loop over the fields."""
    begin = time.process_time()
    for frame in frames:
        if len(frame) == wire.COMMAND.itemsize:
            for k in range(12):
                struct.unpack_from("<HhhhfHH", frame, 7 + 24 * k)
            continue
        for k in range(12):
            struct.unpack_from("<BBfhHH", frame, 7 + 24 * k)
        for tip in range(5):
            for n in range(121):
                struct.unpack_from("<bbB", frame, 7 + 288 + 384 * tip + 3 * n)
    return time.process_time() - begin


def main() -> None:
    """Print each round and the median."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    frames = stream(args.rows)
    data = b"".join(frames)
    rates, ratios = [], []
    for k in range(args.rounds):
        seconds, count = ours(data)
        slow = loop(frames)
        rates.append(count / seconds)
        ratios.append(slow / seconds)
        print(f"round {k + 1}: {rates[-1]:,.0f} frames per CPU s, loop {count / slow:,.0f}: {ratios[-1]:.1f} times")
    print(f"framer and decoder: {np.median(rates):,.0f} frames per CPU s (target >= {TARGET:,})")
    print(f"against struct a field: {np.median(ratios):.1f} times as fast")


if __name__ == "__main__":
    main()
