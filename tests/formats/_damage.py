"""Damage to real files for the fuzz tests of importers: truncations, bit flips, blanks, missing files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hypothesis import strategies as st

from candata.errors import CandataError
from candata.schema.episode import Episode


@dataclass(frozen=True)
class Damage:
    """One defect: `file` and `place` are fractions of the number of files and of a file's bytes."""

    kind: Literal["cut", "flip", "blank", "remove", "empty"]
    file: float
    place: float
    bit: int = 0
    count: int = 1


def damages() -> st.SearchStrategy[Damage]:
    """Return a strategy of defects, half of them single bit flips."""
    part = st.floats(0, 1, exclude_max=True)
    kinds = st.sampled_from(["flip", "flip", "flip", "flip", "cut", "cut", "blank", "remove", "empty"])
    return st.builds(Damage, kinds, part, part, st.integers(0, 7), st.integers(1, 64))


def damaged_copy(source: Path, target: Path, damage: Damage) -> Path:
    """Return the file that was damaged in a copy of `source` (a file or folder) at `target`, made anew.

    Whole files are hard links to the source's, for speed: nothing may write into them.
    """
    if target.is_dir():
        shutil.rmtree(target)
    target.unlink(missing_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, copy_function=os.link)
    else:
        os.link(source, target)
    files = sorted(p for p in target.rglob("*") if p.is_file()) if target.is_dir() else [target]
    path = files[int(damage.file * len(files))]
    data = _damaged(path.read_bytes(), damage)
    path.unlink()
    if damage.kind != "remove":
        path.write_bytes(data)
    return path


def _damaged(data: bytes, damage: Damage) -> bytes:
    """Return the bytes with the defect."""
    place = int(damage.place * len(data))
    if damage.kind == "cut":
        return data[:place]
    if damage.kind == "empty":
        return b""
    changed = bytearray(data)
    if damage.kind == "flip" and changed:
        changed[place] ^= 1 << damage.bit
    if damage.kind == "blank":
        changed[place : place + damage.count] = bytes(len(changed[place : place + damage.count]))
    return bytes(changed)


def only_own_errors(read: Callable[[], Iterable[Episode]]) -> list[Episode] | CandataError:
    """Return what `read` yields or the project's own error; any other exception passes, and fails the test."""
    try:
        return list(read())
    except CandataError as error:
        return error
