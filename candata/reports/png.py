"""PNG files from arrays with zlib alone, so that the core needs no imaging package."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def encode(image: Image) -> bytes:
    """Return the bytes of a PNG file that holds `image`.

    Each row takes the filter with the smallest sum of absolute differences.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Red, green, blue.

    Notes
    -----
    Source: W3C, Portable Network Graphics (PNG) Specification, third edition, sections 5 and 9.
    """
    height, width, channels = image.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    rows = _filtered(image.reshape(height, width * channels), channels)
    body = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + body + _chunk(b"IEND", b"")


def data_uri(image: Image) -> str:
    """Return `image` as a `data:` address that a page can show without a file."""
    return "data:image/png;base64," + base64.b64encode(encode(image)).decode("ascii")


def _chunk(kind: bytes, body: bytes) -> bytes:
    """Return one length-prefixed, checksummed chunk."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _filtered(rows: Image, step: int) -> Image:
    """Return `(H, 1 + W * step) uint8`: the filter's number, then the filtered row."""
    x = rows.astype(np.int16)
    left = np.pad(x, ((0, 0), (step, 0)))[:, : x.shape[1]]
    up = np.pad(x, ((1, 0), (0, 0)))[:-1]
    corner = np.pad(up, ((0, 0), (step, 0)))[:, : x.shape[1]]
    tried = np.stack([x, x - left, x - up, x - _paeth(left, up, corner)]).astype(np.uint8)
    cost = np.abs(tried.view(np.int8).astype(np.int64)).sum(axis=2)
    best = cost.argmin(axis=0)
    number = np.array([0, 1, 2, 4], np.uint8)[best]
    return np.concatenate([number[:, None], tried[best, np.arange(len(x))]], axis=1)


def _paeth(left: NDArray[np.int16], up: NDArray[np.int16], corner: NDArray[np.int16]) -> NDArray[np.int16]:
    """Return the neighbour nearest to `left + up - corner`, left before up before corner."""
    guess = left + up - corner
    far_left, far_up, far_corner = abs(guess - left), abs(guess - up), abs(guess - corner)
    other = np.where(far_up <= far_corner, up, corner)
    return np.where((far_left <= far_up) & (far_left <= far_corner), left, other)
