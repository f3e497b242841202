"""Remotes: where datasets are pushed to and pulled from. A folder or S3 behind one small set of verbs.

NAME/dataset.json           as in the dataset
NAME/objects/<sha256>       every file, named by its bytes: nothing is ever replaced by something else
NAME/versions/000001.json   created once, after all that it needs: what is half pushed cannot be seen
NAME/splits/<name>.json     created once: size and hash of the split, which is an object
NAME/tags/<name>.json       as in the dataset
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from threading import Event
from typing import TypeVar
from urllib.parse import unquote, urlsplit

from candata.datasets import durable
from candata.datasets.store import Store
from candata.errors import DataError, UsageError, Where
from candata.schema.record import Record
from candata.schema.registry import RemoteEntry, RemoteVersion

#: Most bytes of one JSON file that are read. Source: measured, the worst of them take 54 times as much once parsed, and
#: a version that names 85,000 parts is smaller.
LIMIT_BYTES = 16 * 2**20
#: Files that are moved at the same time: small ones wait for the network most of the time.
MOVERS = 4

#: Gives `advance(bytes)` while a number of bytes is moved.
Bar = Callable[[int], AbstractContextManager[Callable[[int], None]]]

SomeRecord = TypeVar("SomeRecord", bound=Record)


def no_bar(_total: int) -> AbstractContextManager[Callable[[int], None]]:
    """Return a bar that shows nothing."""
    return nullcontext(lambda _bytes: None)


def move(tasks: Callable[[Callable[[int], None]], Iterable[Callable[[], object]]], total: int, bar: Bar) -> None:
    """Run tasks under a bar of `total` bytes, a few at a time.

    The first error, or Ctrl-C, ends it: what has not begun is dropped, and what runs ends with its next piece.

    Parameters
    ----------
    tasks : callable
        Given `advance(bytes)`, which each task calls for each piece that it moves.
    total : int
        Bytes in all.
    bar : callable
        Shows the progress in bytes.
    """
    has_ended = Event()
    with bar(total) as advance, ThreadPoolExecutor(MOVERS) as pool:

        def report(count: int) -> None:
            if has_ended.is_set():
                raise _TransferEnded
            advance(count)

        jobs = [pool.submit(task) for task in tasks(report)]
        try:
            for job in jobs:
                job.result()
        except BaseException:
            has_ended.set()
            raise
        finally:
            for job in jobs:
                job.cancel()


class _TransferEnded(Exception):
    """Ends a task beside one that failed; nobody hears it."""


def open_remote(entry: RemoteEntry) -> Store:
    """Return the store behind a remote of the registry.

    Raises
    ------
    UsageError
        When the address is of no kind that is known, or holds a credential.
    SetupError
        When a folder is not there, or there are no credentials for S3 in the environment.
    MissingExtraError
        When it is on S3 and obstore is not installed.
    """
    check_remote(entry)
    parts = urlsplit(entry.url)
    if parts.scheme == "s3":
        from candata.datasets.remote_s3 import S3Store

        return S3Store(entry)
    from candata.datasets.remote_folder import FolderStore

    return FolderStore(Path(unquote(parts.path)) if parts.scheme == "file" else Path(entry.url))


def check_remote(entry: RemoteEntry) -> RemoteEntry:
    """Return the entry, whose address is of a known kind and without a credential.

    Raises
    ------
    UsageError
        When it is not.
    """
    for address in filter(None, (entry.url, entry.endpoint)):
        if "://" in address and (urlsplit(address).username or urlsplit(address).query):
            raise UsageError(
                "the address of a remote holds a credential, which candata does not keep",
                expected="s3://bucket/prefix",
                fix="set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY in the environment",
            )
    parts = urlsplit(entry.url) if "://" in entry.url else None
    is_wrong = parts and (parts.scheme not in ("s3", "file") or (parts.scheme == "s3" and not parts.netloc))
    if is_wrong or not entry.url or (parts and parts.scheme == "file" and parts.netloc not in ("", "localhost")):
        raise UsageError(
            "not the address of a remote", expected="a folder, file:///folder, or s3://bucket/prefix", found=entry.url
        )
    if entry.endpoint and urlsplit(entry.endpoint).scheme not in ("http", "https"):
        raise UsageError("not an endpoint", expected="http:// or https:// and a host", found=entry.endpoint)
    if entry.endpoint and urlsplit(entry.endpoint).scheme == "http" and not entry.allow_http:
        raise UsageError(
            "the endpoint speaks plain http", found=entry.endpoint, fix="--allow-http, in a network that you trust"
        )
    return entry


def read_key(store: Store, key: str, limit: int = LIMIT_BYTES) -> bytes | None:
    """Return the bytes of a small file of a remote, None where there is none.

    Raises
    ------
    DataError
        When it is larger than `limit`.
    """
    data = bytearray()
    try:
        for chunk in store.read(key):
            data += chunk
            if len(data) > limit:
                raise DataError(
                    "a file of the remote is too large",
                    expected=f"{limit} bytes at most",
                    where=_at(store, key),
                    fix="if it is yours: run candata compact on the dataset and push it under another name",
                )
    except FileNotFoundError:
        return None
    return bytes(data)


def read_object(store: Store, name: str, sha256: str, limit: int = LIMIT_BYTES) -> bytes:
    """Return the bytes of a small object, which have its hash.

    Raises
    ------
    DataError
        When it is missing, too large, or other bytes.
    """
    key = object_key(name, sha256)
    data = read_key(store, key, limit)
    digest = None if data is None else hashlib.sha256(data).hexdigest()
    if data is None or digest != sha256:
        raise corrupted_error(store, key, "no such object" if digest is None else f"sha256 {digest[:12]}")
    return data


def parse(kind: type[SomeRecord], store: Store, key: str, data: bytes) -> SomeRecord:
    """Return the record in a file of a remote.

    Raises
    ------
    DataError
        When it holds no such record.
    """
    try:
        return durable.decode_record(kind, data, key)
    except ValueError as error:
        raise corrupted_error(store, key, f"no valid JSON: {error}") from None
    except UsageError as error:
        raise corrupted_error(store, key, error.problem) from None


def corrupted_error(store: Store, key: str, found: str) -> DataError:
    """Return the error for a file of a remote that is not what was pushed."""
    return DataError(
        "the remote is damaged: nothing of this file was kept",
        expected="the file as it was pushed",
        found=found,
        where=_at(store, key),
        fix="delete this file on the remote and push again from an intact copy",
    )


def _at(store: Store, key: str) -> Where:
    """Return the place of a file of a remote."""
    return Where(path=f"{store.url}/{key}")


def object_key(name: str, sha256: str) -> str:
    """Return where an object of a dataset lies on a remote."""
    return f"{name}/objects/{sha256}"


def version_key(name: str, number: int) -> str:
    """Return where a version lies on a remote."""
    return f"{name}/versions/{number:06d}.json"


def remote_numbers(store: Store, name: str) -> list[int]:
    """Return the numbers of the versions on a remote, ascending."""
    return sorted(int(file[:-5]) for file in store.sizes(f"{name}/versions") if re.fullmatch(r"\d{6,9}\.json", file))


def read_remote_version(store: Store, name: str, number: int) -> RemoteVersion:
    """Return a version on a remote.

    Raises
    ------
    DataError
        When the file is missing, damaged, or of another version.
    """
    key = version_key(name, number)
    data = read_key(store, key)
    if data is None:
        raise corrupted_error(store, key, "no such file")
    record = parse(RemoteVersion, store, key, data)
    if record.version.number != number:
        raise corrupted_error(store, key, f"version {record.version.number}")
    return record
