"""Registry: short names for datasets and remotes, in one file of the user's."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

from candata.datasets import durable
from candata.datasets.names import is_name, require_name
from candata.datasets.versions import DATASET, read_dataset_file
from candata.datasets.writing import refused, replacing
from candata.errors import CandataError, DataError, UnknownNameError, UsageError, Where
from candata.schema.json_text import MOST_BYTES, parse_json
from candata.schema.registry import REGISTRY_VERSION, RegistryFile, RemoteEntry
from candata.schema.text_bounds import TextError, read_bounded

#: What to do where the registry cannot be written.
_FIX = "make its folder writable, or name another file in CANDATA_REGISTRY"


def registry_path() -> Path:
    """Return the registry's file: `CANDATA_REGISTRY`, else in the user's data folder.

    Source: XDG base directory specification.
    """
    override = os.environ.get("CANDATA_REGISTRY")
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return Path(override) if override else data / "candata" / "registry.json"


def read_registry(path: Path | None = None) -> RegistryFile:
    """Return the registry; an empty one where there is no file yet.

    Raises
    ------
    DataError
        When the file is damaged or of a newer candata; it is left as it is.
    """
    file = path or registry_path()
    try:
        data = read_bounded(file, MOST_BYTES)
    except FileNotFoundError:
        return RegistryFile()
    except (OSError, TextError) as error:
        raise _unreadable(file, durable.reason(error)) from None
    try:
        value = parse_json(data)
        version = value.get("registry_version") if isinstance(value, dict) else None
        if isinstance(version, int) and version > REGISTRY_VERSION:
            raise _unreadable(file, f"registry version {version}, newer than {REGISTRY_VERSION}")
        return RegistryFile.parse(value, file)
    except TextError as error:
        raise _unreadable(file, f"no valid JSON: {error}") from None
    except UsageError as error:
        raise _unreadable(file, error.problem) from None


def _unreadable(file: Path, found: str) -> DataError:
    """Return the error for a registry that cannot be read."""
    return DataError(
        "the registry cannot be read; it was left as it is",
        expected="the file as candata wrote it",
        found=found,
        where=Where(path=str(file)),
        fix="correct it, or move it away and add the datasets again: candata registry add NAME PATH",
    )


def change_registry(change: Callable[[RegistryFile], RegistryFile], path: Path | None = None) -> RegistryFile:
    """Return the registry after a change; several processes may do so at once and lose nothing.

    Parameters
    ----------
    change : callable
        Takes the registry as it stands and returns the new one; called under a lock.
    path : Path, optional
        File; by default the user's.

    Raises
    ------
    DataError
        When the file is damaged: it is not overwritten.
    SetupError
        When its folder cannot be written.
    """
    file = path or registry_path()
    with refused(file, "registry", _FIX):
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.with_name(file.name + ".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # released by the system, even when the process is killed
            registry = change(read_registry(file))
            with replacing(file, "registry", _FIX) as draft:
                draft.write_bytes(durable.encode_record(registry))
            return registry


def add_dataset(name: str, folder: str | Path) -> RegistryFile:
    """Return the registry in which `name` stands for the dataset in `folder`; the same may be added twice.

    Raises
    ------
    UsageError
        When the name cannot be one, stands for another folder, or there is no dataset.
    """
    root = Path(folder).resolve()
    require_name("dataset", name)
    read_dataset_file(root)

    def change(registry: RegistryFile) -> RegistryFile:
        if registry.datasets.get(name, str(root)) != str(root):
            raise UsageError(
                f"the name {name} is taken",
                expected=str(root),
                found=registry.datasets[name],
                fix=f"choose another name, or first: candata registry remove {name}",
            )
        return registry.model_copy(update={"datasets": dict(sorted({**registry.datasets, name: str(root)}.items()))})

    return change_registry(change)


def remove_dataset(name: str) -> RegistryFile:
    """Return the registry without a name; the dataset itself stays.

    Raises
    ------
    UnknownNameError
        When there is no such name.
    """

    def change(registry: RegistryFile) -> RegistryFile:
        if name not in registry.datasets:
            raise UnknownNameError("dataset", name, registry.datasets)
        return registry.model_copy(update={"datasets": {n: p for n, p in registry.datasets.items() if n != name}})

    return change_registry(change)


def add_remote(name: str, entry: RemoteEntry) -> RegistryFile:
    """Return the registry in which `name` stands for a remote; the same may be added twice.

    Raises
    ------
    UsageError
        When the name cannot be one, or stands for another remote.
    """
    require_name("remote", name)

    def change(registry: RegistryFile) -> RegistryFile:
        if registry.remotes.get(name, entry) != entry:
            raise UsageError(
                f"the remote {name} stands already",
                expected=entry.url,
                found=registry.remotes[name].url,
                fix=f"choose another name, or first: candata registry remotes remove {name}",
            )
        return registry.model_copy(update={"remotes": dict(sorted({**registry.remotes, name: entry}.items()))})

    return change_registry(change)


def remove_remote(name: str) -> RegistryFile:
    """Return the registry without a remote; what it holds stays.

    Raises
    ------
    UnknownNameError
        When there is no such remote.
    """

    def change(registry: RegistryFile) -> RegistryFile:
        if name not in registry.remotes:
            raise UnknownNameError("remote", name, registry.remotes)
        return registry.model_copy(update={"remotes": {n: r for n, r in registry.remotes.items() if n != name}})

    return change_registry(change)


def find_remote(name: str) -> RemoteEntry:
    """Return a remote by its name.

    Raises
    ------
    UnknownNameError
        When there is no such remote; lists those there are.
    """
    remotes = read_registry().remotes
    if name not in remotes:
        raise UnknownNameError("remote", name, remotes)
    return remotes[name]


def resolve(text: str) -> tuple[Path, int | str | None]:
    """Return the folder and the version that `text` means: a path or a name, `@` and a tag, number or digest after it.

    A folder with a dataset comes before a registered name. The version is what `open_dataset` takes.

    Parameters
    ----------
    text : str
        `runs/day1`, `day1`, `day1@clean`, `runs/day1@3`, `day1@9f31c2`.

    Raises
    ------
    UnknownNameError
        When it is neither; lists the registered names and the nearest.
    DataError
        When the registry is damaged and `text` is no path.
    """
    folder = _folder(text)
    if folder is not None:
        return folder, None
    head, at, tail = text.rpartition("@")
    if at and head and tail and (folder := _folder(head)) is not None:
        return folder, int(tail) if tail.isdigit() and len(tail) < 6 else tail
    name = head if at and head else text
    known_names = () if Path(name).exists() or os.sep in name or not is_name(name) else read_registry().datasets
    if not known_names:
        return Path(name), None  # opening it says what is wrong with it
    raise UnknownNameError(
        "dataset (no such folder, no such name)", name, known_names, Where(path=str(registry_path()))
    )


def _folder(text: str) -> Path | None:
    """Return the folder of a dataset, given as a path or a registered name; None where it is neither."""
    if (Path(text) / DATASET).is_file():
        return Path(text)
    if not is_name(text):
        return None
    try:
        registered_path = read_registry().datasets.get(text)
    except CandataError:
        if Path(text).exists():
            return None
        raise
    return Path(registered_path) if registered_path is not None else None
