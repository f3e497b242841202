"""What was simulated, in files: whole or not at all, and those used longest ago go when they are too many."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets.writing import replacing
from candata.errors import SetupError

#: Size of the cache from which the sets used longest ago are removed [bytes].
LIMIT_BYTES = 4_000_000_000
#: Seconds for which a set stays after a diagnosis began with it or wrote to it.
IN_USE_S = 6 * 3600.0
#: Size of a SHA-256 [bytes].
_DIGEST_BYTES = 32


def keep(file: Path | None, **arrays: NDArray) -> None:
    """Write arrays to a file, whole or not at all; a cache that cannot be written is no harm.

    The file is an npz archive with the SHA-256 of it behind: the sums in an archive do not cover its own fields.
    """
    if file is None:
        return
    archive = io.BytesIO()
    np.savez(archive, allow_pickle=False, **arrays)
    content = archive.getbuffer()
    with contextlib.suppress(SetupError), replacing(file, "cache") as draft, draft.open("wb") as out:
        out.write(content)
        out.write(hashlib.sha256(content).digest())


def read(file: Path | None) -> dict[str, NDArray] | None:
    """Return the arrays of a file; None where it is missing, damaged, or another's."""
    if file is None:
        return None
    try:
        content = memoryview(file.read_bytes())
    except OSError:
        return None
    archive, digest = content[:-_DIGEST_BYTES], content[-_DIGEST_BYTES:]
    if hashlib.sha256(archive).digest() != digest:
        return None
    with np.load(io.BytesIO(archive)) as kept:
        return {name: kept[name] for name in kept.files}


def mark_used(own: Path) -> None:
    """Mark a set as used now; before a new one is begun, those used longest ago go if the cache is too large."""
    try:
        os.utime(own)
    except FileNotFoundError:
        prune(own.parents[1])
    except OSError:
        pass  # somebody else's, which may be read


def prune(root: Path) -> None:
    """Remove the sets used longest ago until the cache is below its limit, but none that may be in use."""
    last: dict[Path, float] = {}
    size: dict[Path, int] = {}
    for folder in root.glob("*/*"):
        with contextlib.suppress(OSError):  # another process may remove or rename what is listed
            last[folder], size[folder] = folder.stat().st_mtime, 0
            for file in folder.iterdir():
                with contextlib.suppress(OSError):
                    size[folder] += file.stat().st_size
    total = sum(size.values())
    for folder in sorted(last, key=lambda folder: last[folder]):
        if total <= LIMIT_BYTES:
            break
        if abs(time.time() - last[folder]) < IN_USE_S:  # one of a later time is of a clock that was set back
            continue
        shutil.rmtree(folder, ignore_errors=True)
        total -= size[folder]
