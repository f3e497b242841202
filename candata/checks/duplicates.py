"""Rule: no recording stands twice, under two names or cut differently."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import View, rounded
from candata.schema.channels import CHANNELS

#: Hashes of rows kept of an episode, the smallest: those that two cuts of one recording share (Broder 1997).
KEPT = 16
#: Share of them that two episodes must share.
SHARED = 0.5
REMEDY = "keep one of them: a recording in two splits spoils the test"


@dataclass(frozen=True)
class _Print:
    """Who an episode is: the hash of its rows without names and absolute time, and the smallest of its rows' own."""

    id: str
    whole: bytes
    rows: tuple[int, ...]


def _gather(view: View) -> _Print | None:
    """Return the finger-print of an episode; None where its columns have other lengths."""
    total = len(view.raw.arrays.get("time_ns", ()))
    names = [n for n in CHANNELS if n in view.raw.arrays and n != "time_ns"]
    columns = [np.ascontiguousarray(view.raw.arrays[n]).reshape(total, -1) for n in names
               if total and len(view.raw.arrays[n]) == total and view.raw.arrays[n].size]  # fmt: skip
    if not columns:
        return None
    table = np.concatenate([c.view(np.uint8).reshape(total, -1) for c in columns], axis=1)
    moving = np.r_[True, (table[1:] != table[:-1]).any(axis=1)]
    digests = (hashlib.blake2b(row.tobytes(), digest_size=8).digest() for row in table[moving])
    rows = sorted({int.from_bytes(d, "little") for d in digests})[:KEPT]
    return _Print(view.id, hashlib.blake2b(table.tobytes(), digest_size=16).digest(), tuple(rows))


def _judge(seen: Sequence[_Print]) -> Iterator[Finding]:
    """Yield episodes whose rows are all, or to a large part, those of one before."""
    first: dict[bytes, str] = {}
    owners: dict[int, list[int]] = defaultdict(list)
    for index, one in enumerate(seen):
        if one.whole in first:
            problem = "an episode stands twice"
            yield Finding(
                "warning", "duplicates", f"{problem}: the same rows as {first[one.whole]}", one.id, None, None, problem,
                (), {"same_as": first[one.whole]}, REMEDY,
            )  # fmt: skip
            continue
        first[one.whole] = one.id
        yield from _overlaps(one, seen, owners)
        for row in one.rows:
            owners[row].append(index)


def _overlaps(one: _Print, seen: Sequence[_Print], owners: dict[int, list[int]]) -> Iterator[Finding]:
    """Yield that an episode shares many rows with an earlier one."""
    counts: dict[int, int] = defaultdict(int)
    for row in one.rows:
        for index in owners.get(row, ())[:50]:
            counts[index] += 1
    other = max(counts, key=lambda k: counts[k], default=None)
    if other is None or len(one.rows) < KEPT or len(seen[other].rows) < KEPT:
        return
    # Of the smallest hashes of both together, the share that is in both estimates the share of rows in both.
    both = sorted({*one.rows, *seen[other].rows})[:KEPT]
    share = len({*both} & {*one.rows} & {*seen[other].rows}) / KEPT
    if share >= SHARED:
        problem = "two episodes share their rows"
        yield Finding(
            "warning", "duplicates", f"{problem}: about {share:.0%} of all rows are also in {seen[other].id}", one.id,
            None, None, problem, (), rounded({"same_as": seen[other].id, "share": share}), REMEDY,
        )  # fmt: skip


RULE = Rule(meaning="no recording stands twice", gather=_gather, judge=_judge)
