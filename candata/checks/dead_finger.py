"""Rule: a fingertip that touches reads a force; one that never reads any is reported."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._forces import flags, forces
from candata.checks._signal import SEGMENTS
from candata.checks._view import EpisodeView, round_evidence

#: Fewest rows of contact by flag that a constant reading must contradict.
FEWEST = 5
#: Share of the other fingertips that must show noise out of contact before a constant one is dead.
NOISY = 0.5
#: Share of readings that noise has of the rarer sign, at least. Chosen: of 20 readings one in 50 stretches has fewer.
RARER_SIGN_SHARE = 0.25
#: Fewest episodes in which others touch before a fingertip that never does is reported.
EPISODES = 5
REMEDY = "check the sensor and its cable; mark its rows invalid or leave the fingertip out"


@dataclass(frozen=True)
class _Tips:
    """Fingertips of an episode: what they read and what they are flagged for.

    Attributes
    ----------
    id : str
    rows : int
    names : tuple of str
    is_constant : (F,) bool
        Constant to the bit over all rows.
    flagged_rows : (F,) int
        Rows flagged as contact.
    is_touching : (F,) bool
        Reads above the threshold.
    is_noisy : (F,) bool
        Shows noise about zero in some stretch.
    """

    id: str
    rows: int
    names: tuple[str, ...]
    is_constant: np.ndarray
    flagged_rows: np.ndarray
    is_touching: np.ndarray
    is_noisy: np.ndarray


def _gather(view: EpisodeView) -> _Tips | None:
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
        np.atleast_1d((force.touch & force.has_value).any(axis=0)),
        np.array([_noisy(force.xyz[:, tip]) for tip in range(len(force.names))]),
    )


def _noisy(xyz: np.ndarray) -> bool:
    """Tell whether a fingertip `(T, 3)` shows noise about zero in some stretch: there it touches nothing.

    Noise has both signs, along each axis alike; what is pressed has one, along one axis at least.
    """
    for part in np.array_split(xyz, SEGMENTS):
        positive_rows, negative_rows = (part > 0).sum(axis=0), (part < 0).sum(axis=0)
        has_both_signs = (positive_rows + negative_rows >= FEWEST) & (
            np.minimum(positive_rows, negative_rows) >= RARER_SIGN_SHARE * (positive_rows + negative_rows)
        )
        if has_both_signs.any() and (has_both_signs | (positive_rows + negative_rows < FEWEST)).all():
            return True
    return False


def _judge(episodes: Sequence[_Tips]) -> Iterator[Finding]:
    """Yield dead fingertips, episode by episode, and ones that never read a force in the whole set."""
    reported_names: set[str] = set()
    for episode in episodes:
        for tip, name in enumerate(episode.names):
            if not episode.is_constant[tip]:
                continue
            is_other = np.arange(len(episode.names)) != tip
            reported_names.add(name)
            if FEWEST < episode.flagged_rows[tip] < episode.rows and not episode.is_touching[tip]:
                yield _dead_finding(episode, name, f"flagged in {episode.flagged_rows[tip]} rows", "error")
            elif is_other.any() and episode.is_noisy[is_other].mean() > NOISY:
                yield _dead_finding(episode, name, "the other fingertips show noise", "warning")
            else:
                reported_names.discard(name)
    yield from _silent_findings(episodes, reported_names)


def _dead_finding(episode: _Tips, name: str, reason: str, level: str) -> Finding:
    """Return that a fingertip's reading never changes."""
    return Finding(
        "error" if level == "error" else "warning",
        "dead_finger",
        f"a fingertip's reading never changes: {name}, {reason}",
        episode=episode.id,
        channel="fingertip_force",
        problem=f"a fingertip's reading never changes: {name}",
        evidence={"fingertip": name, "why": reason},
        remedy=REMEDY,
    )


def _silent_findings(episodes: Sequence[_Tips], reported_names: set[str]) -> Iterator[Finding]:
    """Yield fingertips that never read a force though others do: dead, or not used."""
    for name in sorted({name for episode in episodes for name in episode.names} - reported_names):
        tip_episodes = [episode for episode in episodes if name in episode.names]
        touching_episodes = sum(bool(episode.is_touching.any()) for episode in tip_episodes)
        if touching_episodes >= EPISODES and all(
            episode.is_constant[episode.names.index(name)] for episode in tip_episodes
        ):
            problem = f"a fingertip never reads a force: {name}"
            yield Finding(
                "info",
                "dead_finger",
                f"{problem}, in {touching_episodes} episodes in which others do",
                channel="fingertip_force",
                problem=problem,
                evidence=round_evidence({"fingertip": name, "episodes": touching_episodes}),
                remedy="dead, or not used: look at it",
            )


RULE = Rule(meaning="fingertips that touch read forces", gather=_gather, judge=_judge, needs=("fingertip_force",))
