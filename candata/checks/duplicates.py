"""Rule: no recording stands twice, under two names or cut differently."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView, round_evidence
from candata.schema.channels import CHANNELS

#: Hashes kept of an episode, the smallest: those that two cuts of one recording share (Broder 1997).
HASHES_KEPT = 16
#: Rows in a row that are hashed together, all different from one another. Readings of few digits have the same row in
#: many recordings, at rest above all; so many in the same order only copies have. Chosen.
SHINGLE_ROWS = 8
#: Share of them that two episodes must share.
LEAST_SHARE = 0.5
REMEDY = "keep one of them: a recording in two splits spoils the test"


@dataclass(frozen=True)
class _FingerPrint:
    """Finger-print of an episode: the hash of all rows without names and absolute time, and the smallest of hashes.

    Those are of `SHINGLE_ROWS` rows each; there are none where nothing moves for so long.
    """

    id: str
    rows_hash: bytes
    shingle_hashes: tuple[int, ...]


def _gather(view: EpisodeView) -> _FingerPrint | None:
    """Return the finger-print of an episode; None where its columns have other lengths."""
    total = len(view.raw.arrays.get("time_ns", ()))
    names = [n for n in CHANNELS if n in view.raw.arrays and n != "time_ns"]
    columns = [
        np.ascontiguousarray(view.raw.arrays[n]).reshape(total, -1)
        for n in names
        if total and len(view.raw.arrays[n]) == total and view.raw.arrays[n].size
    ]
    if not columns:
        return None
    table = np.concatenate([c.view(np.uint8).reshape(total, -1) for c in columns], axis=1)
    differs = np.r_[True, (table[1:] != table[:-1]).any(axis=1)]
    rows = [row.tobytes() for row in table[differs]]
    shingles = (rows[k : k + SHINGLE_ROWS] for k in range(len(rows) - SHINGLE_ROWS + 1))
    digests = (hashlib.blake2b(b"".join(s), digest_size=8).digest() for s in shingles if len({*s}) == SHINGLE_ROWS)
    hashes = sorted({int.from_bytes(d, "little") for d in digests})[:HASHES_KEPT]
    return _FingerPrint(view.id, hashlib.blake2b(table.tobytes(), digest_size=16).digest(), tuple(hashes))


def _judge(episodes: Sequence[_FingerPrint]) -> Iterator[Finding]:
    """Yield episodes whose rows are all, or to a large part, those of one before."""
    first_ids: dict[bytes, str] = {}
    owners: dict[int, list[int]] = defaultdict(list)
    for index, episode in enumerate(episodes):
        if episode.shingle_hashes and episode.rows_hash in first_ids:
            problem = "an episode stands twice"
            yield Finding(
                "warning",
                "duplicates",
                f"{problem}: the same rows as {first_ids[episode.rows_hash]}",
                episode=episode.id,
                problem=problem,
                evidence={"same_as": first_ids[episode.rows_hash]},
                remedy=REMEDY,
            )
            continue
        first_ids[episode.rows_hash] = episode.id
        yield from _overlaps(episode, episodes, owners)
        for shingle in episode.shingle_hashes:
            owners[shingle].append(index)


def _overlaps(
    episode: _FingerPrint, episodes: Sequence[_FingerPrint], owners: dict[int, list[int]]
) -> Iterator[Finding]:
    """Yield that an episode shares many rows with an earlier one."""
    counts: dict[int, int] = defaultdict(int)
    for shingle in episode.shingle_hashes:
        for index in owners.get(shingle, ())[:50]:
            counts[index] += 1
    nearest_index = max(counts, key=lambda k: counts[k], default=None)
    if (
        nearest_index is None
        or len(episode.shingle_hashes) < HASHES_KEPT
        or len(episodes[nearest_index].shingle_hashes) < HASHES_KEPT
    ):
        return
    # The share of the smallest hashes that both episodes have estimates the share of rows that both have.
    smallest_hashes = sorted({*episode.shingle_hashes, *episodes[nearest_index].shingle_hashes})[:HASHES_KEPT]
    share = (
        len({*smallest_hashes} & {*episode.shingle_hashes} & {*episodes[nearest_index].shingle_hashes}) / HASHES_KEPT
    )
    if share >= LEAST_SHARE:
        problem = "two episodes share their rows"
        yield Finding(
            "warning",
            "duplicates",
            f"{problem}: about {share:.0%} of all rows are also in {episodes[nearest_index].id}",
            episode=episode.id,
            problem=problem,
            evidence=round_evidence({"same_as": episodes[nearest_index].id, "share": share}),
            remedy=REMEDY,
        )


RULE = Rule(meaning="no recording stands twice", gather=_gather, judge=_judge)
