"""A run's folder: `run.json`, its checkpoints and log; the same run goes on, another is refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from candata.datasets.drafts import is_draft
from candata.datasets.durable import encode_record, ensure_folder, exclusive_lock
from candata.datasets.writing import refused, replacing
from candata.errors import UsageError, Where
from candata.loaders import Split, split_digest
from candata.schema.json_text import MOST_BYTES, parse_json
from candata.schema.record import Record
from candata.schema.text_bounds import read_bounded
from candata.training.settings import Run

FILE = "run.json"
#: Who trains, validates and tests, beside it.
SPLIT = "split.json"
_FIX = "free space or choose another --out; the same command goes on from the last checkpoint"


class Splits(Record):
    """`split.json` of a run on a mixture: the split of each source."""

    splits: dict[str, Split]


def begin(folder: Path, run: Run, split: Record | None = None) -> None:
    """Begin a run in its folder, or see that the folder holds this very run.

    Parameters
    ----------
    folder : Path
        Where; it stands.
    run : Run
        The run.
    split : Record, optional
        Who trains, kept beside it.

    Raises
    ------
    UsageError
        When the folder holds something else, or a run with other settings; names what differs.
    """
    refuse_foreign(folder)
    path = folder / FILE
    if path.is_file():
        _refuse_other(read_run(folder), run, path)
        return
    if split is not None:
        _write(folder / SPLIT, split)
    _write(path, run)  # last: with it the run stands


def refuse_foreign(folder: Path) -> None:
    """Refuse a place for a run in which something else stands.

    Raises
    ------
    UsageError
        When it is a file, or a folder that holds something that is no run.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file", expected="a folder", found="a file", fix="name another folder")
    if not folder.is_dir() or (folder / FILE).is_file():
        return
    file_names = sorted(p.name for p in folder.iterdir())
    if any(name != SPLIT and not is_draft(name) for name in file_names):
        raise UsageError(
            "the output folder holds something that is no run",
            expected=f"a new folder, or one with {FILE}",
            found=", ".join(file_names[:8]),
            where=Where(path=str(folder)),
            fix="choose another --out",
        )


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Do what writes to the run's folder, which is made when missing; one process does so at a time.

    Raises
    ------
    UsageError
        When it is a file, or another process trains into it.
    SetupError
        When the disk is full or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file", expected="a folder", found="a file", fix="name another folder")
    with refused(folder, "run", _FIX), exclusive_lock(ensure_folder(folder), "another process trains into this folder"):
        yield


def run_file(path: Path) -> AbstractContextManager[Path]:
    """Return the draft of a file of the run, which takes its place; a folder that was moved away is not made anew."""
    return replacing(path, "run", _FIX, parents=False)


def _write(path: Path, record: Record) -> None:
    """Write a record whole or not at all."""
    with run_file(path) as draft:
        draft.write_bytes(encode_record(record))


def read_run(folder: Path) -> Run:
    """Return the run that a folder holds.

    Raises
    ------
    UsageError
        When it holds none, or the file is not valid; names it.
    """
    path = folder / FILE
    try:
        value = parse_json(read_bounded(path, MOST_BYTES))
    except (OSError, ValueError) as error:
        raise UsageError(
            "no run",
            expected=f"a folder with {FILE}",
            found=str(getattr(error, "strerror", None) or error),
            where=Where(path=str(path)),
            fix="name a folder that candata train wrote",
        ) from None
    return Run.parse(value, path)


def read_splits(folder: Path, run: Run) -> tuple[Split, ...] | None:
    """Return who trained, validated and tested in a run, a split for each of `run.trained_on`.

    None where it is not kept in the folder.

    Raises
    ------
    UsageError
        When the file is not valid, or of another run.
    """
    path = folder / SPLIT
    if not path.is_file():
        return None
    try:
        value = parse_json(read_bounded(path, MOST_BYTES))
    except ValueError as error:
        raise UsageError(
            "the split of the run is damaged",
            found=str(error).splitlines()[0],
            where=Where(path=str(path)),
            fix="remove it to evaluate by the split of the dataset",
        ) from None
    splits = tuple(Splits.parse(value, path).splits.values()) if run.sources else (Split.parse(value, path),)
    if [split_digest(split) for split in splits] != [source.split_digest for source in run.trained_on]:
        raise UsageError("the split beside the checkpoint is of another run", where=Where(path=str(path)))
    return splits


def _refuse_other(stored_run: Run, requested_run: Run, path: Path) -> None:
    """Refuse to go on with a run that differs; names every field that does."""
    stored_fields, requested_fields = (
        _dotted_fields(stored_run.model_dump(mode="json")),
        _dotted_fields(requested_run.model_dump(mode="json")),
    )
    names = [
        name
        for name in sorted(stored_fields.keys() | requested_fields.keys())
        if stored_fields.get(name) != requested_fields.get(name)
    ]
    if not names:
        return
    if (
        stored_run.dataset == requested_run.dataset
        and stored_run.digest != requested_run.digest
        and not requested_run.sources
    ):
        raise UsageError(
            "the dataset is another version than the run was begun on",
            expected=_version(stored_run),
            found=_version(requested_run),
            where=Where(path=str(path)),
            fix=f"add --version {stored_run.digest[:12]} to go on, or begin another run: "
            f"--init {path.parent} --out NEW",
        )
    raise UsageError(
        "the folder holds a run with other settings",
        expected=_field_text(stored_fields, names),
        found=_field_text(requested_fields, names),
        where=Where(path=str(path)),
        fix="give the settings of that run to go on with it, or choose another --out",
    )


def _version(run: Run) -> str:
    """Return `sim, version 2, digest 0c10b7811a72`."""
    return f"{run.dataset}, version {run.version}, digest {run.digest[:12]}"


def _dotted_fields(value: dict[str, Any], head: str = "") -> dict[str, Any]:
    """Return nested values under dotted names."""
    fields: dict[str, Any] = {}
    for key, inner in value.items():
        fields |= _dotted_fields(inner, f"{head}{key}.") if isinstance(inner, dict) else {f"{head}{key}": inner}
    return fields


def _field_text(values: dict[str, Any], names: list[str], limit: int = 6) -> str:
    """Return `name value, name value`."""
    texts = [f"{name} {str(values.get(name, 'not given'))[:40]}" for name in names[:limit]]
    return ", ".join(texts) + (f" and {len(names) - limit} more" if len(names) > limit else "")
