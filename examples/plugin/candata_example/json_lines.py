"""One JSON line an episode, with a digest of the rest of the line: what is damaged is refused."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from candata.errors import DataError, Where
from candata.formats import Format, Reading, Writing
from candata.schema.episode import Episode, EpisodeMeta

FILE = "episodes.jsonl"


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a folder that `write` filled.

    Raises
    ------
    DataError
        When there is no file, or a line is not what was written.
    """
    path = Path(source) / FILE
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise DataError("no file to read", expected=FILE, found=error.strerror, where=Where(path=str(path))) from None
    if not lines:
        raise DataError("the file holds no episodes", where=Where(path=str(path)))
    for number, line in enumerate(lines):
        digest, _, text = line.partition(b" ")
        if digest != hashlib.sha256(text).hexdigest().encode():
            where = Where(path=str(path), index=number)
            raise DataError("a line is damaged", expected="the digest of its text", found="another", where=where)
        record = json.loads(text)
        arrays = {name: np.array(values, dtype) for name, (dtype, values) in record["arrays"].items()}
        yield Episode(EpisodeMeta.parse(record["meta"], path), arrays)


def write(episodes: Iterable[Episode], folder: Path, writing: Writing) -> None:
    """Write the episodes into `folder`; numbers are written so that they come back bit for bit."""
    with (folder / FILE).open("wb") as file:
        for episode in episodes:
            arrays = {name: (str(a.dtype), a.tolist()) for name, a in episode.arrays.items()}
            text = json.dumps({"meta": episode.meta.model_dump(mode="json"), "arrays": arrays}).encode()
            file.write(hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n")


FORMAT = Format(name="json_lines", summary="one JSON line an episode, with its digest", read=read, write=write)
