"""Cells: pieces of an experiment, each kept in a folder named by the digest of all that it comes from."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import mujoco

from candata import __version__
from candata.datasets.durable import encode_record, file_sha256
from candata.datasets.writing import replacing
from candata.schema.json_text import parse_json
from candata.schema.record import ResultRecord

Kind = Literal["data", "part", "diagnosis", "train", "evaluation"]
#: The record of a cell, written last: with it the cell stands.
FILE = "cell.json"
#: What cells hold beside it: a set, a run, an evaluation, the effects of a repair.
SETS, RUN, EVALUATION, EFFECTS = "set", "run", "evaluation.json", "effects.yaml"
_HELD: Mapping[Kind, str] = {"part": SETS, "diagnosis": EFFECTS, "train": RUN, "evaluation": EVALUATION}
#: Packages whose versions, beside MuJoCo's, decide what a cell of each kind holds.
_PACKAGES: Mapping[Kind, tuple[str, ...]] = {
    "data": ("numpy",),
    "part": ("numpy",),
    "diagnosis": ("numpy", "scipy"),
    "train": ("torch", "numpy"),
    "evaluation": ("torch", "numpy"),
}


@dataclass(frozen=True)
class Cell:
    """A piece of work.

    Attributes
    ----------
    kind : str
        What is done.
    name : str
        Unique name, its parts with `/` between them.
    settings : mapping
        Plain values that decide what comes of it.
    inputs : mapping of str to str
        Role to the name of the cell that fills it.
    places : mapping of str to str
        Plain values that decide where things lie, and nothing of what comes of it.
    """

    kind: Kind
    name: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict)


class CellRecord(ResultRecord):
    """`cell.json`: what a cell was made from, what came of it, and how long it took.

    Attributes
    ----------
    name, kind, digest : str
        Of the cell.
    settings, inputs : dict
        Its settings, and names of its input cells by role.
    made_from : dict of str to str
        `content_of` each input when the cell was made, by role: a digest of settings does not tell one draw of a sealed
        world from another.
    versions : dict of str to str
        Of candata and the packages that decide.
    result : dict
        Facts for the cells behind it.
    seconds : float
        Time of the run that ended it [s].
    """

    format: str = "candata-cell-1"
    name: str
    kind: Kind
    digest: str
    settings: dict[str, Any]
    inputs: dict[str, str]
    made_from: dict[str, str]
    versions: dict[str, str]
    result: dict[str, Any]
    seconds: float


def digests(cells: Mapping[str, Cell]) -> dict[str, str]:
    """Return the digest of each cell: sha256 over kind, settings, versions and the digests of its inputs.

    Parameters
    ----------
    cells : mapping of str to Cell
        By name, inputs before what they feed.
    """
    known: dict[str, str] = {}
    for name, cell in cells.items():
        inputs = {role: known[source] for role, source in cell.inputs.items()}
        text = json.dumps([cell.kind, cell.settings, inputs, versions(cell.kind)], sort_keys=True)
        known[name] = hashlib.sha256(text.encode()).hexdigest()
    return known


@cache
def versions(kind: Kind) -> dict[str, str]:
    """Return the versions that decide what a cell of a kind holds; MuJoCo's own, as several packages bring it."""
    packages = {name: metadata.version(name) for name in _PACKAGES[kind]}
    return {"candata": __version__, "mujoco": mujoco.__version__, **packages}


def cell_folder(out: Path, cell: Cell, digest: str) -> Path:
    """Return where a cell is kept: `cells/KIND-DIGEST`."""
    return out / "cells" / f"{cell.kind}-{digest[:16]}"


def read_cell(folder: Path, digest: str, inputs: Mapping[str, Path] | None = None) -> CellRecord | None:
    """Return the record of a cell that stands; None for one that is missing, damaged, emptied or of another digest.

    With `inputs`, the folders of its input cells by role, it must also have been made from what stands there now.
    """
    record = _read(folder)
    if record is None or record.digest != digest:
        return None
    is_whole = record.kind not in _HELD or (folder / _HELD[record.kind]).exists()
    is_current = inputs is None or record.made_from == made_from(inputs)
    return record if is_whole and is_current else None


def made_from(inputs: Mapping[str, Path]) -> dict[str, str]:
    """Return the content of input cells, given by their folders, by role."""
    return {role: content_of(folder) for role, folder in inputs.items()}


def content_of(folder: Path) -> str:
    """Return the sha256 of what came of a finished cell, and of what it was made from, wherever it lies."""
    record = _read(folder)
    result = {} if record is None else {name: value for name, value in record.result.items() if name != "path"}
    text = json.dumps([result, {} if record is None else record.made_from], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def drop_outdated(folder: Path, inputs: Mapping[str, Path]) -> None:
    """Delete a cell that was made from other content than its inputs hold now."""
    record = _read(folder)
    if record is not None and record.made_from != made_from(inputs):
        shutil.rmtree(folder)


def _read(folder: Path) -> CellRecord | None:
    """Return the record in a folder; None where there is none, or a damaged one."""
    try:
        return CellRecord.model_validate(parse_json((folder / FILE).read_bytes()))
    except (OSError, ValueError):
        return None


def write_cell(folder: Path, record: CellRecord) -> None:
    """Write the record of a finished cell, whole or not at all.

    Raises
    ------
    SetupError
        When it cannot be written.
    """
    with replacing(folder / FILE, "cell") as draft:
        draft.write_bytes(encode_record(record))


def content_digest(path: str) -> str:
    """Return the sha256 of a file, or over names and contents of all files of a folder; the text itself of neither."""
    place = Path(path)
    if place.is_file():
        return file_sha256(place)
    if not place.is_dir():
        return path
    names = sorted(str(file.relative_to(place)) for file in place.rglob("*") if file.is_file())
    return hashlib.sha256(json.dumps([(name, file_sha256(place / name)) for name in names]).encode()).hexdigest()
