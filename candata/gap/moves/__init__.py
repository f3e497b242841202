"""Moves: how a search comes from one set of effects to others. A file each; `MOVES` holds them all.

A move is a function `propose(view)` that yields sets with the values to begin at. It simulates nothing on all
episodes, compares nothing and knows no other move: which sets are worth a closer look is the agenda's business.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from candata.gap.moves.add import propose as propose_add
from candata.gap.moves.drop import propose as propose_drop
from candata.gap.moves.exchange import propose as propose_exchange
from candata.gap.moves.pair import propose as propose_pair
from candata.gap.moves.place import propose as propose_place
from candata.gap.moves.split import propose as propose_split
from candata.gap.moves.view import View
from candata.gap.search import Members

Move = Callable[[View], Iterator[Members]]
MOVES: dict[str, Move] = {
    "add": propose_add,
    "pair": propose_pair,
    "split": propose_split,
    "exchange": propose_exchange,
    "drop": propose_drop,
    "place": propose_place,
}
