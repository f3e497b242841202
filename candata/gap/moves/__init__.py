"""Moves: how a search comes from one set of effects to others. A file each; `MOVES` holds them all.

A move is a function `propose(view)` that yields sets with the values to begin at. It simulates nothing on all
episodes, compares nothing and knows no other move: which sets are worth a closer look is the agenda's business.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from candata.gap.moves import add, drop, exchange, pair, place, split
from candata.gap.moves.view import View
from candata.gap.search import Members

Move = Callable[[View], Iterator[Members]]
MOVES: dict[str, Move] = {
    "add": add.propose,
    "pair": pair.propose,
    "split": split.propose,
    "exchange": exchange.propose,
    "drop": drop.propose,
    "place": place.propose,
}
