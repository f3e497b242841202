"""A name that leaves much open gives way where a described force closes clearly more by itself."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import diagnosis
from candata.schema.report import Gap


@dataclass(frozen=True)
class Posed:
    score: str


@pytest.fixture
def found(monkeypatch):
    """The function that asks whether a force that closes a share unseats what closes another."""

    def ask(word: str, closed: float, closable: float | None):
        seen = []

        def described(problem, world, where, nearest, rng):
            seen.append((problem.score, world, nearest))
            return None if closable is None else SimpleNamespace(unknown=SimpleNamespace(closable=closable))

        monkeypatch.setattr(diagnosis, "describe", described)
        first = SimpleNamespace(fits=(SimpleNamespace(labels=("joint_offset ring1",)),))
        f = SimpleNamespace(problem=Posed("nominal"), found=SimpleNamespace(score="repaired", first=first))
        size = Gap(before=3.0, after=3.0 - 2 * closed, closed=closed)
        return diagnosis._better(f, word, size, (), np.random.default_rng(0)), seen

    return ask


@pytest.mark.parametrize(
    ("word", "closed", "closable", "unseated"),
    [
        ("partly_explained", 0.37, 0.98, True),
        ("partly_explained", 0.37, 0.46, False),  # hardly more, with more freedom
        ("partly_explained", 0.37, None, False),  # no force stands out
        ("explained", 0.55, 0.9, True),  # explained only because little is left
        ("unknown_effect", 0.1, 0.9, False),  # nothing is named
    ],
)
def test_what_closes_clearly_more_unseats(found, word, closed, closable, unseated):
    assert (found(word, closed, closable)[0] is not None) is unseated


def test_it_is_judged_by_itself_in_the_same_units(found):
    _, seen = found("partly_explained", 0.37, 0.98)
    assert seen == [("repaired", (), "joint_offset ring1")]


def test_what_explains_is_not_questioned(found):
    assert found("explained", 0.9, 1.0) == (None, [])
