"""Checkpoints: one safetensors file each, whole or absent, whose header names the run as JSON. Never a pickle."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from candata.errors import DataError, UsageError, Where
from candata.schema.json_text import parse_json
from candata.training.runs import run_file
from candata.training.settings import Progress, Run

SUFFIX = ".safetensors"
LAST_FILE, BEST_FILE = f"last{SUFFIX}", f"best{SUFFIX}"
#: Groups of tensors, as the first part of their names.
WEIGHTS, AVERAGE, OPTIMISER = "weights", "ema", "optimiser"
#: First bytes of what `torch.save` and `pickle` write: a zip archive, or a pickle of protocol 2 to 5.
_PICKLES = (b"PK\x03\x04", *(bytes([0x80, protocol]) for protocol in range(2, 6)))


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint as read.

    Attributes
    ----------
    path : Path
        File.
    run : Run
        What its weights mean.
    progress : Progress
        How far the run had come.
    """

    path: Path
    run: Run
    progress: Progress

    def tensors(self, group: str, device: str = "cpu") -> dict[str, torch.Tensor]:
        """Return the tensors of a group (`weights`, `ema` or `optimiser`) by name.

        Raises
        ------
        DataError
            When the file is damaged; names it.
        """
        try:
            with safe_open(self.path, "pt", device=device) as file:
                names = [name for name in file.keys() if name.startswith(f"{group}/")]  # noqa: SIM118
                return {name.removeprefix(f"{group}/"): file.get_tensor(name) for name in names}
        except (SafetensorError, OSError) as error:
            raise _unreadable(self.path, str(error)) from None


def save(path: Path, run: Run, progress: Progress, groups: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
    """Write a checkpoint whole or not at all.

    Raises
    ------
    SetupError
        When the disk is full or cannot be written; what stood at `path` is unharmed.
    """
    tensors: dict[str, torch.Tensor] = {}
    for group, group_tensors in groups.items():
        tensors |= {f"{group}/{name}": value for name, value in _separate_copies(group_tensors).items()}
    header = {"run": run.model_dump_json(), "progress": progress.model_dump_json()}
    with run_file(path) as draft:
        try:
            save_file(tensors, draft, header)
        except SafetensorError as error:  # what it makes of a full disk
            raise OSError(str(error)) from None


def _separate_copies(tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return the tensors on the CPU, none sharing memory with another: a module may stand in two places."""
    copies: dict[str, torch.Tensor] = {}
    storage_pointers: set[int] = set()
    for name, value in tensors.items():
        tensor = value.detach().contiguous().cpu()
        pointer = tensor.untyped_storage().data_ptr()
        copies[name] = tensor.clone() if pointer in storage_pointers else tensor
        storage_pointers.add(pointer)
    return copies


def copy(source: Path, target: Path) -> None:
    """Give the checkpoint `source` a second name; checkpoints are replaced, never changed."""
    with run_file(target) as draft:
        try:
            draft.hardlink_to(source)
        except OSError:  # a file system without hard links
            shutil.copyfile(source, draft)


def read(path: Path) -> Checkpoint:
    """Return the checkpoint in the file `path`, or in the run folder `path`: the best one, else the last.

    Raises
    ------
    UsageError
        When there is none, it is a pickle (never opened), or no checkpoint of candata.
    DataError
        When the file is damaged.
    """
    path = _file(path)
    with path.open("rb") as file:
        head = file.read(9)
    if head.startswith(_PICKLES):
        raise UsageError(
            "the checkpoint is a pickle, which can run any code when opened: refused",
            expected=f"a {SUFFIX} file that candata train wrote",
            found="a file of torch.save or pickle",
            where=Where(path=str(path)),
            fix="train with candata train, or name its run folder",
        )
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _unreadable(path, str(error)) from None
    if not {"run", "progress"} <= set(header):
        raise UsageError(
            "not a checkpoint of candata",
            expected="a safetensors file whose header holds `run` and `progress`",
            found=f"a header with {', '.join(sorted(header)) or 'nothing'}",
            where=Where(path=str(path)),
        )
    try:
        fields = parse_json(header["run"]), parse_json(header["progress"])
    except ValueError as error:
        raise _unreadable(path, str(error)) from None
    return Checkpoint(path, Run.parse(fields[0], path), Progress.parse(fields[1], path))


def check_fits(run: Run, facts: Mapping[str, object], path: Path) -> None:
    """Refuse data, or another run, whose joints or sizes are not those the weights were made for.

    Parameters
    ----------
    run : Run
        Of the checkpoint.
    facts : mapping
        Fields of `Run` to compare: `sizes`, `joint_names`, ...
    path : Path
        The checkpoint.

    Raises
    ------
    UsageError
        Names both.
    """
    for name, value in facts.items():
        expected = getattr(run, name)
        if value != expected:
            raise UsageError(
                f"the checkpoint was made for other {name.replace('_', ' ')}",
                expected=_text(expected),
                found=_text(value),
                where=Where(path=str(path)),
                fix="use data of the same hand and windows, or train a new model",
            )


def _text(value: object) -> str:
    """Return names or sizes on one line."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {size}" for name, size in value.items())
    if isinstance(value, tuple):
        return f"{len(value)}: {', '.join(value)}"
    return str(value)


def _file(path: Path) -> Path:
    """Return the file of a checkpoint, or of the best one of a run folder."""
    if path.is_dir():
        for name in (BEST_FILE, LAST_FILE):
            if (path / name).is_file():
                return path / name
        raise UsageError(
            "the folder holds no checkpoint",
            expected=f"{BEST_FILE} or {LAST_FILE}",
            found=", ".join(sorted(p.name for p in path.iterdir())[:8]) or "nothing",
            where=Where(path=str(path)),
            fix="name a folder that candata train wrote",
        )
    if not path.is_file():
        raise UsageError("no such checkpoint", where=Where(path=str(path)), fix="name a run folder or its file")
    return path


def _unreadable(path: Path, reason: str) -> DataError:
    """Return the error for a file that is no whole safetensors file."""
    return DataError(
        "damaged checkpoint",
        expected="a whole safetensors file",
        found=reason.splitlines()[0],
        where=Where(path=str(path)),
        fix="use the other checkpoint of the run, or train again",
    )
