"""Diffusion Policy buffers as episodes: exactly where candata wrote them, else by a map."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from candata.errors import CandataError, DataError, UsageError, Where
from candata.formats import Reading
from candata.formats._by_map import digest_of, even_time_ns, mapped_episode
from candata.formats._features import Feature, picks, wanted
from candata.formats._map_file import read_map_file
from candata.formats._sidecar import give_clouds, parse_export, restored
from candata.schema.episode import Episode
from candata.schema.exchange import ExportFile, FeatureMap

#: Attribute of the root group that holds the sidecar as JSON text.
SIDECAR = "candata"
#: What compression can gain at most; an array that claims more is damaged. Source: deflate, at most 1032 to 1.
_LARGEST_GAIN = 1100
_SLACK_BYTES = 1 << 20


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a buffer in their order.

    Raises
    ------
    UsageError
        When candata did not write it and there is no map, or the map is wrong.
    DataError
        When the buffer is missing or damaged.
    """
    path = find_buffer(source)
    try:
        root = zarr.open_group(store=str(path), mode="r", zarr_format=2)
        arrays = _arrays(root, path)
        ends = _ends(root, arrays, path)
        side = root.attrs.get(SIDECAR)
    except CandataError:
        raise
    except Exception as error:  # zarr and its codecs raise nearly everything, by where the damage lies
        raise _unreadable(path, error) from None
    if reading.mapping is None and isinstance(side, str):
        export = parse_export(side, path)
        give_clouds(export, reading, path)
        yield from _restored(export, arrays, ends, path)
        return
    yield from _by_map(arrays, ends, path, reading)


def digest(source: Path, reading: Reading) -> str:
    """Return the sha256 over the files, the map and what the import was told.

    Raises
    ------
    DataError
        When the buffer is missing.
    """
    path = find_buffer(source)
    return digest_of(path, sorted(p for p in path.rglob("*") if p.is_file()), reading)


def find_buffer(source: Path) -> Path:
    """Return the folder of the zarr group, which may be given by the folder around it.

    Raises
    ------
    DataError
        When there is none, or more than one.
    """
    source = Path(source)
    found = [source] if (source / ".zgroup").is_file() else sorted(p.parent for p in source.glob("*/.zgroup"))
    if len(found) != 1:
        raise DataError(
            "there is no Diffusion Policy buffer",
            expected="a zarr folder (format 2) with data/ and meta/, or a folder that holds one",
            found=", ".join(p.name for p in found) or "no .zgroup",
            where=Where(path=str(source)),
            fix="unpack a .zarr.zip first",
        )
    return found[0]


def _arrays(root: Any, path: Path) -> dict[str, NDArray]:
    """Return every array of numbers in `data`, as `(N, n)`."""
    odd = next((p for p in path.rglob("*") if not (p.is_dir() or p.is_file())), None)
    if odd is not None:
        raise DataError("the buffer holds what is no file", found=odd.name, where=Where(path=str(odd)))
    limit = _LARGEST_GAIN * sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) + _SLACK_BYTES
    made = {}
    for name, array in sorted(root["data"].arrays()):
        if array.ndim and np.dtype(array.dtype).kind in "fiub":
            if array.nbytes > limit:
                raise DataError(
                    "an array claims more than the buffer can hold", found=name, where=Where(path=str(path))
                )
            values = np.asarray(array[:])
            made[name] = values.reshape(len(values), -1)
    return made


def _ends(root: Any, arrays: dict[str, NDArray], path: Path) -> list[int]:
    """Return where the episodes end; every array is as long as the last end."""
    found = root["meta"]["episode_ends"]
    rows = max(map(len, arrays.values()), default=0)
    if found.size > rows:
        raise DataError(
            "episode_ends lists more episodes than there are rows",
            expected=f"at most {rows}",
            found=str(found.size),
            where=Where(path=str(path)),
        )
    ends = [int(n) for n in np.asarray(found[:]).reshape(-1)]
    if not ends or ends[0] <= 0 or any(b <= a for a, b in itertools.pairwise(ends)):
        raise DataError("episode_ends does not rise", found=str(ends[:5]), where=Where(path=str(path)))
    odd = [f"{name}: {len(values)}" for name, values in arrays.items() if len(values) != ends[-1]]
    if odd:
        raise DataError(
            "the arrays differ in length from the episodes",
            expected=f"{ends[-1]} rows, the last of episode_ends",
            found=", ".join(odd),
            where=Where(path=str(path)),
        )
    return ends


def _restored(export: ExportFile, arrays: dict[str, NDArray], ends: Sequence[int], path: Path) -> Iterator[Episode]:
    """Yield the episodes that candata exported."""
    if len(export.episodes) != len(ends):
        raise DataError(
            "the sidecar lists other episodes than the buffer",
            expected=str(len(export.episodes)),
            found=str(len(ends)),
            where=Where(path=str(path)),
        )
    columns = {one.column: arrays[one.key] for one in export.columns if one.key in arrays}
    for entry, start, end in zip(export.episodes, [0, *ends], ends, strict=False):
        yield restored(entry, {name: values[start:end] for name, values in columns.items()}, path)


def _by_map(arrays: dict[str, NDArray], ends: Sequence[int], path: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes as the map says."""
    if reading.mapping is None:
        raise UsageError(
            "the buffer does not say what its arrays are, nor its rate",
            found=", ".join(arrays),
            where=Where(path=str(path)),
            fix="say it with --map FILE, such as `rate_hz: 10` and `channels: {joint_position: 'state[0:7]'}`",
        )
    mapping = read_map_file(FeatureMap, reading.mapping)
    features = [Feature(name, values.shape[1]) for name, values in arrays.items()]
    made = picks(mapping, features, reading.mapping)
    if mapping.rate_hz is None:
        raise UsageError("the map lacks rate_hz", where=Where(path=str(reading.mapping)), fix="add `rate_hz: 10`")
    left = sorted(set(arrays) - set(wanted(made)))
    if left:
        reading.note(f"left out: {', '.join(left)}")
    for index, (start, end) in enumerate(zip([0, *ends], ends, strict=False)):
        time_ns = even_time_ns(end - start, mapping.rate_hz)
        part = {name: arrays[name][start:end] for name in wanted(made)}
        own = {"rate_hz": mapping.rate_hz}
        yield mapped_episode(f"{path.stem}-{index}", time_ns, part, made, mapping, reading, path, **own)


def _unreadable(path: Path, error: Exception) -> DataError:
    """Return the error of a buffer that cannot be read."""
    return DataError(
        "the buffer cannot be read",
        expected="a zarr group (format 2) with data/ and meta/episode_ends",
        found=(str(error).splitlines() or [""])[0][:200] or type(error).__name__,
        where=Where(path=str(path)),
        fix="the folder is damaged or incomplete; get it again from its source",
    )
