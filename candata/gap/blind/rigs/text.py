"""Text of MJCF, and draws of plain numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def tag(element: str, inner: str = "", /, **attributes: object) -> str:
    """Return an XML element; numbers are written with six digits, sequences with blanks, None is left out."""
    words = [f'{key}="{_text(value)}"' for key, value in attributes.items() if value is not None]
    head = " ".join([element, *words])
    return f"<{head}>{inner}</{element}>" if inner else f"<{head}/>"


def _text(value: object) -> str:
    """Return an attribute's text."""
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return " ".join(_text(v) for v in value)
    return str(value)


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a plain float drawn evenly."""
    return float(rng.uniform(low, high))


def chance(rng: np.random.Generator, share: float) -> bool:
    """Return True with a probability."""
    return bool(rng.random() < share)
