"""Moves: how a search comes from one set of effects to others. One file each; the folder is the registry.

A move is a function `propose(view)` that yields sets with the values to begin at. It simulates a few episodes at most,
compares nothing and knows no other move: which sets are worth a closer look is the agenda's business.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from candata.gap.fit.fits import Members
from candata.gap.moves._view import View
from candata.plugins import load, names

Move = Callable[[View], Iterator[Members]]
#: The `propose` of each file, by the file's name.
MOVES: dict[str, Move] = {name: load(__name__, "propose", name) for name in names(__name__)}
