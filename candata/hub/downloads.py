"""Downloads of LeRobot sets from the Hub: tables alone, resumed where they stopped."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from candata.errors import DataError, UsageError, Where
from candata.hub.address import HubAddress
from candata.hub.failures import hub_api, hub_failures, hub_library

#: Files that an import reads; videos and images are left on the Hub.
WANTED = ("meta/*.json", "meta/*.jsonl", "meta/*.parquet", "data/*.parquet")
#: What every LeRobot set has.
INFO = "meta/info.json"
_COMMIT = re.compile(r"[0-9a-f]{40}")


@dataclass(frozen=True)
class HubSet:
    """A LeRobot set that was downloaded.

    Attributes
    ----------
    folder : Path
        Its folder, called as the set is.
    commit : str
        The commit that it is of.
    licence : str or None
        What its card states.
    """

    folder: Path
    commit: str
    licence: str | None


def download_set(address: HubAddress, cache: Path, say: Callable[[str], None]) -> HubSet:
    """Return a set of the Hub in a folder of the cache; what is there of the same commit is not fetched again.

    Parameters
    ----------
    address : HubAddress
        Where it is.
    cache : Path
        Where downloads are kept, by owner, commit and name.
    say : callable
        Takes a line about what is downloaded and what is left out.

    Raises
    ------
    MissingExtraError
        When huggingface_hub is not installed.
    UsageError
        When there is no such repository or revision, or it holds no LeRobot set.
    SetupError
        When there is no network, or the token is missing, wrong or not allowed to read it.
    DataError
        When the Hub names a commit or a file as none can be named.
    """
    with hub_failures(address):
        info = hub_api().dataset_info(address.repository, revision=address.revision, files_metadata=True)
    sizes = {file.rfilename: file.size or 0 for file in info.siblings or ()}
    _check(address, info.sha, sizes)
    wanted = {name: size for name, size in sizes.items() if any(fnmatch(name, pattern) for pattern in WANTED)}
    folder = cache / "hub" / address.owner / info.sha / address.name
    left_out = f"; {len(sizes) - len(wanted)} other files are left out" if len(sizes) > len(wanted) else ""
    say(f"{address} is commit {info.sha[:12]}: {len(wanted)} tables, {sum(wanted.values()) / 1e6:.1f} MB{left_out}")
    with hub_failures(address):
        hub_library().snapshot_download(
            address.repository,
            repo_type="dataset",
            revision=info.sha,
            local_dir=folder,
            cache_dir=cache / "hub",
            allow_patterns=list(WANTED),
            endpoint=os.environ.get("HF_ENDPOINT") or None,
        )
    return HubSet(folder, info.sha, _licence(info))


def _check(address: HubAddress, commit: str | None, sizes: dict[str, int]) -> None:
    """Raise unless the commit and the files have names that can be files, and the set is one of LeRobot."""
    location = Where(path=str(address))
    if commit is None or not _COMMIT.fullmatch(commit):
        raise DataError("the Hub names no commit", expected="40 hexadecimal digits", found=repr(commit), where=location)
    outside_names = [name for name in sizes if name.startswith("/") or ".." in Path(name).parts]
    if outside_names:
        raise DataError("a file of the set lies outside of it", found=repr(outside_names[0]), where=location)
    if INFO not in sizes:
        raise UsageError(
            f"{address.repository} is no LeRobot set",
            expected=INFO,
            found=", ".join(sorted({name.split("/")[0] for name in sizes})[:8]) or "no file",
            where=location,
            fix="give a revision that holds one, such as @v3.0, or another set",
        )


def _licence(info: object) -> str | None:
    """Return the licence on the card of a set; None where there is none."""
    licence = getattr(getattr(info, "card_data", None), "license", None)
    return ", ".join(map(str, licence)) if isinstance(licence, list) else licence
