"""Datasets of an HDF5 file by name, opened one by one: of numbers, in the file itself, not larger than it can hold."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats._memory import require_memory

#: What compression can gain at most; a dataset that claims more is damaged. Source: deflate, at most 1032 to 1.
_LARGEST_GAIN = 1100
_SLACK_BYTES = 1 << 20


def names_in(group: Any) -> list[str]:
    """Return the paths of what lies in a group, two levels deep; no dataset is opened."""
    import h5py

    names = []
    for key in group:
        is_hard_link = group.id.links.get_info(key.encode()).type == h5py.h5l.TYPE_HARD
        folder = group.get(key) if is_hard_link and group.get(key, getclass=True) is h5py.Group else None
        names += [key] if folder is None else [f"{key}/{name}" for name in folder]
    return names


def open_group(group: Any, name: str, path: Path) -> Any:
    """Return a group in a group.

    Raises
    ------
    KeyError
        When there is none.
    DataError
        When it is a link to another file, which may be anyone's.
    """
    _is_there(group, name, path)
    return group[name]


def open_dataset(group: Any, key: str, path: Path) -> Any:
    """Return a dataset of rows of numbers by its path in a group, None where there is none; no value is read.

    Raises
    ------
    DataError
        When its values lie in other files, or are packed by a filter that is not installed.
    """
    import h5py

    steps = key.split("/")
    if not all(_is_there(group, "/".join(steps[: k + 1]), path) for k in range(len(steps))):
        return None
    dataset = group[key]
    if not isinstance(dataset, h5py.Dataset) or not dataset.shape or dataset.dtype.kind not in "fiub":
        return None
    plan = dataset.id.get_create_plist()
    if plan.get_external_count() or plan.get_layout() == h5py.h5d.VIRTUAL:
        raise _outside_error(group, key, path)
    filters = [plan.get_filter(k) for k in range(plan.get_nfilters())]
    missing_filters = [(code, name) for code, _, _, name in filters if not h5py.h5z.filter_avail(code)]
    if missing_filters:
        raise DataError(
            f"{dataset.name} is packed by a filter that is not installed",
            expected="filters that HDF5 brings",
            found=", ".join(f"filter {code} ({name.decode(errors='replace')})" for code, name in missing_filters),
            where=Where(path=str(path)),
            fix="leave the dataset out of the map, or unpack it where the filter is installed: h5repack -f NONE",
        )
    return dataset


def load(dataset: Any, path: Path) -> NDArray:
    """Return the values of a dataset.

    Raises
    ------
    DataError
        When it claims more than can lie in a file of that size, or than fits into memory.
    """
    as_floats = math.prod(dataset.shape) * 8
    if as_floats > _SLACK_BYTES and dataset.nbytes > _LARGEST_GAIN * path.stat().st_size:
        raise DataError(
            "a dataset claims more than the file can hold",
            expected=f"a file of {path.stat().st_size} bytes",
            found=f"{dataset.nbytes} bytes in {dataset.name}",
            where=Where(path=str(path)),
        )
    require_memory(as_floats, f"a dataset of {path.name}", Where(path=str(path)))
    values: NDArray = dataset[()]
    return values


def _is_there(group: Any, name: str, path: Path) -> bool:
    """Tell whether a group has a link of that name; one to another file is refused and not followed."""
    import h5py

    try:
        kind = group.id.links.get_info(name.encode()).type
    except (KeyError, RuntimeError):  # h5py raises either, for a name that is not there and for damage
        if group.id.links.exists(name.encode()):
            raise
        return False
    if kind == h5py.h5l.TYPE_EXTERNAL:
        raise _outside_error(group, name, path)
    return True


def _outside_error(group: Any, name: str, path: Path) -> DataError:
    """Return the error of values that lie in other files, which may be anyone's."""
    return DataError(
        "the file takes values from other files",
        expected="datasets that lie in the file itself",
        found=f"{group.name.rstrip('/')}/{name}",
        where=Where(path=str(path)),
        fix="copy the datasets into one file first, with h5repack or h5py",
    )
