"""Random streams by name and content: what is drawn depends on what is asked, not on what was asked before."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from candata.schema.effect import EffectSetting

#: What a stream may be drawn for: ids of episodes, labels, numbers, effects, and sequences of these.
Content: TypeAlias = "str | int | float | EffectSetting | Sequence[Content] | None"
#: Significant digits of a number in a stream's key. Chosen: no parameter is known so well, and results of two machines
#: differ in later digits.
DIGITS = 6


@dataclass(frozen=True)
class Streams:
    """The random streams of one seed.

    Attributes
    ----------
    seed : int
    """

    seed: int = 0

    def of(self, name: str, *content: Content) -> np.random.Generator:
        """Return the generator of a name and a content, at its beginning: one question gets one answer.

        Streams of other names, contents or seeds are independent: the generator is seeded with the SHA-256 of all
        three.

        Parameters
        ----------
        name : str
            What is drawn.
        content : str, int, float, None, EffectSetting, or sequences of these
            For what it is drawn. Numbers count to `DIGITS` significant digits; effects in a row are a world, in which
            their order does not count.
        """
        key = json.dumps([self.seed, name, [_plain(part) for part in content]])
        return np.random.default_rng(int.from_bytes(hashlib.sha256(key.encode()).digest(), "big"))


def _plain(content: Content) -> Any:
    """Return a content as lists of texts, equal for equal contents."""
    if isinstance(content, EffectSetting):
        return [content.name, content.element, sorted((n, _plain(v)) for n, v in content.parameters.items())]
    if content is None or isinstance(content, str):
        return content
    if isinstance(content, int | float | np.number):
        return f"{float(content) + 0.0:.{DIGITS}g}"
    parts = [_plain(part) for part in content]
    is_world = len(parts) > 1 and all(isinstance(part, EffectSetting) for part in content)
    return sorted(parts, key=json.dumps) if is_world else parts
