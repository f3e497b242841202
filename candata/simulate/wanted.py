"""Outcomes that a set is meant to have: their shares, and which of its episodes wants which."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from candata.errors import UnknownNameError, UsageError
from candata.schema.outcome import WANTED

#: Turns after which the outcomes begin anew: shares count to a thousandth.
TURNS = 1000
#: Largest distance of the sum of all shares from 1: rounding of decimals.
SUM_TOLERANCE = 1e-6


def parsed_outcomes(text: str) -> dict[str, float]:
    """Return the share of each wanted outcome, from `success:0.5,fail:0.5`; words without shares share alike.

    Raises
    ------
    UnknownNameError
        When there is no such outcome.
    UsageError
        When an outcome comes twice, a share is no number above 0, or the shares do not sum to 1.
    """
    pairs = [word.partition(":")[::2] for word in text.split(",") if word.strip()]
    names = [name.strip() for name, _ in pairs]
    for name in names:
        if name not in WANTED:
            raise UnknownNameError("outcome", name, WANTED)
    if not pairs or len(set(names)) < len(names):
        raise UsageError("--outcomes cannot be read", expected="outcomes of different names", found=repr(text))
    if not any(share for _, share in pairs):
        return dict.fromkeys(names, 1 / len(names))
    try:
        shares = {name: float(share) for name, (_, share) in zip(names, pairs, strict=True)}
    except ValueError:
        shares = {}
    if not shares or not all(0 < share <= 1 for share in shares.values()):
        raise UsageError(
            "--outcomes cannot be read",
            expected="a share above 0 for each outcome, such as success:0.5,fail:0.5",
            found=repr(text),
        )
    if abs(sum(shares.values()) - 1) > SUM_TOLERANCE:
        raise UsageError(
            "the shares of --outcomes do not sum to 1", expected="1", found=f"{sum(shares.values()):g} in {text}"
        )
    return shares


def wanted_outcome(shares: Mapping[str, float], turn: int) -> str:
    """Return the outcome that is wanted at a turn; after any number of turns the shares are met to within one."""
    order = tuple((name, shares[name]) for name in WANTED if name in shares)
    return _turns(order)[turn % TURNS]


@lru_cache(maxsize=8)
def _turns(shares: tuple[tuple[str, float], ...]) -> tuple[str, ...]:
    """Return the outcomes of all turns: at each the one that is furthest behind its share."""
    counts = dict.fromkeys((name for name, _ in shares), 0)
    turns = []
    for turn in range(1, TURNS + 1):
        name = max(shares, key=lambda pair: pair[1] * turn - counts[pair[0]])[0]
        counts[name] += 1
        turns.append(name)
    return tuple(turns)
