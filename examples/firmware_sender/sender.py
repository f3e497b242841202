"""A board that sends two joints and a force in candata's framed format: standard library, CPython or MicroPython.

python sender.py /dev/ttyACM0 writes to a port, or to any file. On a board, give `run` a UART, and let `read` return
what your sensors say.
"""

import binascii
import json
import struct
import sys
import time

RATE_HZ = 100
SIGNALS = [
    {"name": "joint_position", "unit": "rad", "shape": [2], "names": ["bend", "spread"]},
    {"name": "tip_force", "unit": "N", "shape": []},
]
HELLO = json.dumps({"rate_hz": RATE_HZ, "signals": SIGNALS}).encode()
#: A clock in nanoseconds that never steps, as far as the board has one.
clock_ns = getattr(time, "monotonic_ns", None) or time.time_ns


def read(number):
    """Return the values of all signals in the order of the hello: here made up."""
    return 0.001 * (number % 1000), -0.5, 1.25


def frame(body):
    """Return a body with its CRC-32, stuffed by COBS, and a zero byte."""
    out, piece = bytearray(), bytearray()
    for byte in body + struct.pack("<I", binascii.crc32(body)):
        if byte:
            piece.append(byte)
        if not byte or len(piece) == 254:
            out.append(len(piece) + 1)
            out += piece
            piece = bytearray()
    return bytes(out) + bytes([len(piece) + 1]) + bytes(piece) + b"\0"


def data_frame(number, values):
    """Return frame `number` with the values at this moment."""
    head = struct.pack("<BBIIQ", 1, 1, binascii.crc32(HELLO), number & 0xFFFFFFFF, clock_ns() // 1000)
    return frame(head + struct.pack(f"<{len(values)}f", *values))


def run(port, frames=None):
    """Write frames to `port`, a hello first and once a second: a recorder that comes later understands them too."""
    number = 0
    while frames is None or number < frames:
        if number % RATE_HZ == 0:
            port.write(frame(b"\x01\x00" + HELLO))
        port.write(data_frame(number, read(number)))
        number += 1
        time.sleep(1 / RATE_HZ)


if __name__ == "__main__":
    with open(sys.argv[1], "wb", buffering=0) as device:
        run(device)
