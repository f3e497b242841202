"""Rule: a fingertip that touches reads a force, and one that never reads any is told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import flags, forces
from candata.checks._signal import SEGMENTS
from candata.checks._view import View, rounded

#: Fewest rows of contact by flag that a constant reading must contradict.
FEWEST = 5
#: Share of the other fingertips that must show noise out of contact before a constant one is dead.
NOISY = 0.5
#: Share of readings that noise has of the rarer sign, at least. Chosen: of 20 readings one in 50 stretches has fewer.
BOTH = 0.25
#: Fewest episodes in which others touch before a fingertip that never does is told.
EPISODES = 5
REMEDY = "check the sensor and its cable; mark its rows invalid or leave the fingertip out"


@dataclass(frozen=True)
class _Tips:
    """What an episode tells of its fingertips.

    Attributes
    ----------
    id : str
    rows : int
    names : tuple of str
    still : (F,) bool
        Constant to the bit over all rows.
    flagged : (F,) int
        Rows flagged as contact.
    touching : (F,) bool
        Reads above the threshold.
    noisy : (F,) bool
        Shows noise about zero in some stretch.
    """

    id: str
    rows: int
    names: tuple[str, ...]
    still: np.ndarray
    flagged: np.ndarray
    touching: np.ndarray
    noisy: np.ndarray


def _gather(view: View) -> _Tips | None:
    """Return what an episode tells of its fingertips; None where it is too short."""
    force = forces(view)
    if force is None or len(force.xyz) < 2 * FEWEST:
        return None
    flag = flags(view, force.total.shape[1])
    low, high = np.nanmin(force.xyz, axis=0), np.nanmax(force.xyz, axis=0)
    return _Tips(
        view.id,
        len(force.xyz),
        force.names,
        np.atleast_1d((low == high).all(axis=1)),
        np.zeros(len(force.names), int) if flag is None else (np.nan_to_num(flag) > 0).sum(axis=0),
        np.atleast_1d((force.touch & force.seen).any(axis=0)),
        np.array([_noisy(force.xyz[:, tip]) for tip in range(len(force.names))]),
    )


def _noisy(xyz: np.ndarray) -> bool:
    """Tell whether a fingertip `(T, 3)` shows noise about zero in some stretch: there it touches nothing.

    Noise has both signs, along each axis alike; what is pressed has one, along one axis at least.
    """
    for part in np.array_split(xyz, SEGMENTS):
        up, down = (part > 0).sum(axis=0), (part < 0).sum(axis=0)
        both = (up + down >= FEWEST) & (np.minimum(up, down) >= BOTH * (up + down))
        if both.any() and (both | (up + down < FEWEST)).all():
            return True
    return False


def _judge(seen: Sequence[_Tips]) -> Iterator[Finding]:
    """Yield dead fingertips, episode by episode, and ones that never read a force in the whole set."""
    told: set[str] = set()
    for one in seen:
        for tip, name in enumerate(one.names):
            if not one.still[tip]:
                continue
            others = np.arange(len(one.names)) != tip
            told.add(name)
            if FEWEST < one.flagged[tip] < one.rows and not one.touching[tip]:
                yield _dead(one, name, f"flagged in {one.flagged[tip]} rows", "error")
            elif others.any() and one.noisy[others].mean() > NOISY:
                yield _dead(one, name, "the other fingertips show noise", "warning")
            else:
                told.discard(name)
    yield from _never(seen, told)


def _dead(one: _Tips, name: str, why: str, level: str) -> Finding:
    """Return that a fingertip's reading never changes."""
    return Finding(
        "error" if level == "error" else "warning", "dead_finger",
        f"a fingertip's reading never changes: {name}, {why}", one.id, "fingertip_force", None,
        f"a fingertip's reading never changes: {name}", (), {"fingertip": name, "why": why}, REMEDY,
    )  # fmt: skip


def _never(seen: Sequence[_Tips], told: set[str]) -> Iterator[Finding]:
    """Yield fingertips that never read a force though others do: dead, or not used."""
    for name in sorted({name for one in seen for name in one.names} - told):
        have = [one for one in seen if name in one.names]
        others = sum(bool(one.touching.any()) for one in have)
        if others >= EPISODES and all(one.still[one.names.index(name)] for one in have):
            problem = f"a fingertip never reads a force: {name}"
            yield Finding(
                "info", "dead_finger", f"{problem}, in {others} episodes in which others do", None, "fingertip_force",
                None, problem, (), rounded({"fingertip": name, "episodes": others}), "dead, or not used: look at it",
            )  # fmt: skip


RULE = Rule(meaning="fingertips that touch read forces", gather=_gather, judge=_judge, needs=("fingertip_force",))
