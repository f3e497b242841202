"""What is drawn over a finished picture: discs and digits, with numpy alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.reports.png import Image

Colour = tuple[int, int, int]
#: Rows of the glyphs, five pixels high and three wide, one digit in octal a row (4: left, 2: middle, 1: right).
_GLYPHS = {
    "0": "75557",
    "1": "26227",
    "2": "71747",
    "3": "71717",
    "4": "55711",
    "5": "74717",
    "6": "74757",
    "7": "71222",
    "8": "75757",
    "9": "75717",
    ".": "00002",
    "s": "03616",
    " ": "00000",
}
#: Height of a glyph and distance from one to the next, in its own pixels.
_GLYPH_ROWS, _GLYPH_STEP = 5, 4
#: Text's height over the picture's, and the light that a text's background keeps (of 1). Chosen.
TEXT_SHARE, TEXT_SHADE = 0.045, 0.35
WHITE = (255, 255, 255)


def draw_disc(image: Image, x: float, y: float, radius: float, colour: Colour) -> None:
    """Draw a disc with a white rim into `image` (H, W, 3); what lies outside of the picture is left out.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Changed in place.
    x, y, radius : float
        Centre, from the upper left corner, and radius [pixels].
    colour : tuple of int
        Red, green, blue.
    """
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    distance = np.hypot(columns + 0.5 - x, rows + 0.5 - y)
    image[distance <= radius + 1] = WHITE
    image[distance <= radius] = colour


def draw_text(image: Image, text: str) -> None:
    """Write digits, points, blanks and `s` into the upper left corner of `image` (H, W, 3), white on a darker ground.

    Raises
    ------
    KeyError
        When there is no glyph for a character.
    """
    scale = max(1, round(image.shape[0] * TEXT_SHARE / _GLYPH_ROWS))
    glyphs = np.kron(_text_pixels(text), np.ones((scale, scale), bool))
    rows, columns = (min(side, length) for side, length in zip(glyphs.shape, image.shape, strict=False))
    corner = image[:rows, :columns]
    corner[:] = (corner * TEXT_SHADE).astype(np.uint8)
    corner[glyphs[:rows, :columns]] = WHITE


def _text_pixels(text: str) -> NDArray[np.bool_]:
    """Return which pixels of a text are set, `(7, 4 * len(text) + 1)`, a free pixel on each side."""
    pixels = np.zeros((_GLYPH_ROWS + 2, _GLYPH_STEP * len(text) + 1), bool)
    for place, character in enumerate(text):
        bits = [[int(digit) >> shift & 1 for shift in (2, 1, 0)] for digit in _GLYPHS[character]]
        pixels[1:-1, _GLYPH_STEP * place + 1 : _GLYPH_STEP * (place + 1)] = bits
    return pixels
