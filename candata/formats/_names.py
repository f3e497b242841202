"""Names in maps and files: entries such as `state[0:7]`; joints, actuators and fingertips by their columns."""

from __future__ import annotations

import itertools
import re
from collections.abc import Container, Sequence

#: First tokens that say what a column holds and not which element it belongs to.
_KIND = {
    "joint_position": {"q", "qpos", "pos", "position", "joint", "joint_position"},
    "joint_velocity": {"dq", "qd", "qvel", "v", "vel", "velocity", "joint_velocity"},
    "joint_effort": {"tau", "eff", "effort", "torque", "joint_effort"},
    "action": {"a", "u", "act", "action", "cmd", "command", "ctrl", "target"},
    "fingertip_force": {"f", "ft", "force", "fingertip_force"},
    "fingertip_contact": {"c", "contact", "fingertip_contact"},
}
_SEPARATORS = "_./:- "


def split_entry(text: str, known_names: Container[str]) -> tuple[str, str | None]:
    """Return what a map's entry names and the columns of it between brackets; None if it names all of them.

    A name in `known_names` that itself ends in brackets is taken as it is.
    """
    match = None if text in known_names else re.fullmatch(r"(.+?)\s*\[([^\[\]]*)\]", text)
    return (text, None) if match is None else (match.group(1), match.group(2))


def element_names(channel: str, columns: Sequence[str]) -> tuple[str, ...]:
    """Return the elements' names: the columns without a shared first word such as `q_` or `a_`.

    Where that leaves an empty or repeated name, the columns keep theirs.
    """
    words = sorted(_KIND.get(channel, ()), key=len, reverse=True)
    for word in words:
        short_names = tuple(_name_after(column, word) for column in columns)
        if all(short_names) and len(set(short_names)) == len(short_names):
            return short_names
    return tuple(columns)


def fingertip_names(triples: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the fingertips' names: what the three columns of each share, `f0_x f0_y f0_z` -> `f0`."""
    tip_names = tuple(_without_force(_common_text(triple)) for triple in triples)
    if not all(tip_names) or len(set(tip_names)) < len(tip_names):
        return tuple(f"f{i}" for i in range(len(triples)))
    return element_names("fingertip_force", tip_names)


def _without_force(name: str) -> str:
    """Return a name without a last word `f`: `thumb.fx thumb.fy thumb.fz` share `thumb.f`, but the tip is `thumb`."""
    return re.sub(rf"(?<=.)[{re.escape(_SEPARATORS)}]+f$", "", name, flags=re.IGNORECASE)


def _name_after(column: str, word: str) -> str:
    """Return what follows `word` and a separator, or nothing."""
    match = re.match(rf"{re.escape(word)}[{re.escape(_SEPARATORS)}]+(.+)", column, re.IGNORECASE)
    return match.group(1) if match else ""


def _common_text(columns: Sequence[str]) -> str:
    """Return the longer of the columns' common start and common end, without separators."""
    start = _common_start(columns)
    end = _common_start([column[::-1] for column in columns])[::-1]
    return max(start, end, key=len).strip(_SEPARATORS)


def _common_start(texts: Sequence[str]) -> str:
    """Return the longest start that all texts share."""
    equal_letters = itertools.takewhile(lambda letters: len(set(letters)) == 1, zip(*texts, strict=False))
    return "".join(letters[0] for letters in equal_letters)
