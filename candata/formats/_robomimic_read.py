"""robomimic files as episodes: exactly where candata wrote them, else by a map or by the datasets' names."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

from candata.errors import CandataError, DataError, MissingExtraError, UsageError, Where
from candata.formats import Reading
from candata.formats._by_map import even_time_ns, mapped_episode
from candata.formats._features import Feature, Pick, mapped_features, picked_features, picks
from candata.formats._hdf5_datasets import load, names_in, open_dataset, open_group
from candata.formats._map_file import read_map_file
from candata.formats._sidecar import give_clouds, parse_episode, parse_export, restore_episode
from candata.lfs import refuse_pointer
from candata.schema.channels import CHANNELS, DENSE_CHANNELS
from candata.schema.episode import Episode
from candata.schema.exchange import ExportedEpisode, ExportFile, FeatureMap
from candata.schema.json_text import parse_json

T = TypeVar("T")

#: Attribute that holds the sidecar: of `data` the columns, of a demo its episode.
SIDECAR = "candata"
#: What robosuite calls the joints of its first robot.
_ROBOSUITE = {"joint_position": "obs/robot0_joint_pos", "joint_velocity": "obs/robot0_joint_vel"}


@dataclass(frozen=True)
class _Demo:
    """A demonstration at hand: its name, its rows, each dataset as `(T, n)`, its sidecar."""

    name: str
    rows: int
    arrays: Mapping[str, NDArray]
    sidecar: ExportedEpisode | None


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a robomimic file in the order of their numbers.

    Raises
    ------
    UsageError
        When the map is wrong, or the names do not tell what a dataset is.
    DataError
        When the file is missing or damaged, or a demonstration is ragged.
    MissingExtraError
        When h5py is not installed.
    """
    path = find_file(source)
    with _open_file(path) as file:
        data = _guard(path, open_group, file, "data", path)
        names = _guard(path, lambda: sorted(data, key=_number))
        if not names:
            raise DataError("the file holds no demonstration", where=Where(path=str(path)))
        export = _guard(path, _export, data, path) if reading.mapping is None else None
        if export is not None:
            give_clouds(export, reading, path)
            keys = {column.column: column.key for column in export.columns}
            for name in names:
                demo = _guard(path, _demo, data, name, path, tuple(keys.values()))
                yield _restore_episode(demo, keys, path)
            return
        yield from _by_map(data, names, path, reading)


def find_file(source: Path) -> Path:
    """Return the HDF5 file, which may be given by its folder.

    Raises
    ------
    DataError
        When there is none, or more than one.
    """
    source = Path(source)
    files = sorted(p for end in ("*.hdf5", "*.h5") for p in source.glob(end)) if source.is_dir() else [source]
    if len(files) != 1 or not files[0].is_file():
        raise DataError(
            "there is no robomimic file",
            expected="an HDF5 file, or a folder that holds one",
            found=", ".join(p.name for p in files) if source.is_dir() and files else "no such file",
            where=Where(path=str(source)),
        )
    refuse_pointer(files[0])
    return files[0]


@contextmanager
def _open_file(path: Path) -> Iterator[Any]:
    """Yield the open file."""
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "formats") from None
    if not h5py.is_hdf5(path):
        with path.open("rb") as start:
            head = start.read(8)
        raise DataError(
            "the HDF5 file cannot be read",
            expected="an HDF5 file with a group `data` of demonstrations",
            found=f"a file of another kind, which begins {head!r}" if head else "no bytes",
            where=Where(path=str(path)),
            fix="give the HDF5 file, or name the format that this one is",
        )
    file = _guard(path, lambda: h5py.File(path, "r", locking=False))
    try:
        yield file
    finally:
        file.close()


def _guard(path: Path, action: Callable[..., T], *arguments: Any) -> T:
    """Return what `action` returns; whatever HDF5 raises over a damaged file becomes one error."""
    try:
        return action(*arguments)
    except CandataError:
        raise
    except Exception as error:  # h5py raises nearly everything, by where the damage lies
        raise DataError(
            "the HDF5 file cannot be read",
            expected="a whole file with a group `data` of demonstrations",
            found=(str(error).splitlines() or [""])[0][:200] or type(error).__name__,
            where=Where(path=str(path)),
            fix="the file is damaged or incomplete; get it again from its source",
        ) from None


def _number(name: str) -> tuple[int, str]:
    """Return the order of a demonstration: `demo_10` comes after `demo_2`."""
    match = re.fullmatch(r"demo_(\d{1,9})", name)
    return (int(match.group(1)) if match else -1, name)


def _export(data: Any, path: Path) -> ExportFile | None:
    """Return the sidecar of an exported file, or None where candata did not write it."""
    value = data.attrs.get(SIDECAR)
    return None if value is None else parse_export(value, path)


def _demo(data: Any, name: str, path: Path, keys: tuple[str, ...]) -> _Demo:
    """Return a demonstration with the datasets of the keys; its others are not opened."""
    group = open_group(data, name, path)
    datasets = {key: dataset for key in keys if (dataset := open_dataset(group, key, path)) is not None}
    missing_keys = [key for key in keys if key not in datasets]
    if missing_keys:
        raise DataError(
            f"the demonstration lacks {', '.join(missing_keys)}",
            expected=", ".join(keys),
            found=", ".join(names_in(group)),
            where=Where(path=str(path), episode=name),
        )
    rows = _rows(group, datasets, name, path)
    value = group.attrs.get(SIDECAR) if SIDECAR in data.attrs else None
    arrays = {key: load(dataset, path).reshape(rows, -1) for key, dataset in datasets.items()}
    return _Demo(name, rows, arrays, None if value is None else parse_episode(value, path))


def _rows(group: Any, datasets: Mapping[str, Any], name: str, path: Path) -> int:
    """Return the number of rows of a demonstration, which all datasets that are taken have."""
    counts = {key: dataset.shape[0] for key, dataset in datasets.items()}
    claimed_rows = group.attrs.get("num_samples")
    if claimed_rows is not None:
        counts = {"num_samples": int(claimed_rows)} | counts
    location = Where(path=str(path), episode=name)
    if not counts or not all(counts.values()):
        raise DataError("the demonstration is empty", expected="at least 1 row", where=location)
    row_count = counts.get("num_samples") or Counter(counts.values()).most_common(1)[0][0]
    mismatches = [f"{key}: {count}" for key, count in counts.items() if count != row_count]
    if mismatches:
        raise DataError(
            "the datasets of a demonstration differ in length",
            expected=f"{row_count} rows, as {next(k for k, c in counts.items() if c == row_count)} has",
            found=", ".join(mismatches),
            where=location,
            fix="the recording was cut short or is damaged; remove the demonstration, or get the file again",
        )
    return row_count


def _restore_episode(demo: _Demo, keys: Mapping[str, str], path: Path) -> Episode:
    """Return an episode that candata exported."""
    if demo.sidecar is None:
        raise DataError(
            "the demonstration has no sidecar",
            expected=f"an attribute {SIDECAR}, as the others have",
            where=Where(path=str(path), episode=demo.name),
            fix=f"remove the attribute {SIDECAR} of `data` to import all by their names",
        )
    return restore_episode(demo.sidecar, {column: demo.arrays[key] for column, key in keys.items()}, path)


def _by_map(data: Any, names: list[str], path: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes as the map says, or the names."""
    first_demo = _guard(path, open_group, data, names[0], path)
    known_names = _guard(path, names_in, first_demo)
    mapping = read_map_file(FeatureMap, reading.mapping) if reading.mapping else _guess(known_names, path)
    features = _guard(path, _features, first_demo, known_names, mapped_features(mapping, known_names), path)
    channel_picks = picks(mapping, features, reading.mapping or path)
    rate_hz = mapping.rate_hz or _guard(path, _rate_hz, data)
    if rate_hz is None:
        raise UsageError(
            "the file does not say its rate",
            expected="control_freq in env_args",
            where=Where(path=str(path)),
            fix="say it with --map FILE: `rate_hz: 20` beside `channels`",
        )
    used = picked_features(channel_picks)
    left_out = [name for name in known_names if name not in used]
    if left_out:
        reading.note(f"left out: {', '.join(left_out)}")
    if reading.mapping is None:
        kinds = ", ".join(f"{pick.channel} from {picked_features([pick])[0]}" for pick in channel_picks)
        reading.note(f"by their names: {kinds}; units are taken for SI (rad, m, N), as robomimic names none")
    for name in names:
        demo = _guard(path, _demo, data, name, path, used)
        identity = f"{path.stem}-{name}"
        _check_widths(demo, channel_picks, Where(path=str(path), episode=identity))
        time_ns = even_time_ns(demo.rows, rate_hz)
        yield mapped_episode(identity, time_ns, demo.arrays, channel_picks, mapping, reading, path, rate_hz=rate_hz)


def _features(group: Any, known_names: Sequence[str], read_names: Sequence[str], path: Path) -> list[Feature]:
    """Return the features of a demonstration; those that are taken with their columns."""
    widths = {}
    for name in read_names:
        dataset = open_dataset(group, name, path)
        if dataset is None:
            raise DataError(
                f"{name} does not hold rows of numbers", expected="a dataset of numbers", where=Where(path=str(path))
            )
        widths[name] = math.prod(dataset.shape[1:])
    return [Feature(name, widths.get(name, 0)) for name in known_names]


def _check_widths(demo: _Demo, channel_picks: tuple[Pick, ...], location: Where) -> None:
    """Raise where a demonstration has fewer columns than the first."""
    for pick in channel_picks:
        for name, columns in pick.parts:
            if max(columns) >= demo.arrays[name].shape[1]:
                raise DataError(
                    f"{name} has other columns than in the first demonstration",
                    expected=f"at least {max(columns) + 1}",
                    found=str(demo.arrays[name].shape[1]),
                    where=location,
                )


def _guess(known_names: Sequence[str], path: Path) -> FeatureMap:
    """Return the map that the datasets' names imply."""
    channels = {c: f"obs/{c}" for c in CHANNELS if f"obs/{c}" in known_names and c not in DENSE_CHANNELS}
    for channel, name in _ROBOSUITE.items():
        if name in known_names:
            channels.setdefault(channel, name)
    if "actions" in known_names:
        channels["action"] = "actions"
    if not {"object_pose", "joint_position"} & set(channels):
        raise UsageError(
            "no dataset is known as the joints' position or the object's pose",
            expected="obs/<channel> or obs/robot0_joint_pos",
            found=", ".join(known_names),
            where=Where(path=str(path)),
            fix="say what is what with --map FILE, such as "
            "`channels: {joint_position: 'obs/my_joints[0:7]', action: actions}`",
        )
    return FeatureMap(channels=dict(channels))


def _rate_hz(data: Any) -> float | None:
    """Return the control rate of the environment, where the file says it."""
    try:
        arguments = parse_json(data.attrs["env_args"], finite=False)
        rate_hz = float(arguments["env_kwargs"]["control_freq"])
    except (KeyError, TypeError, ValueError, RecursionError):
        return None
    return rate_hz if 1e-6 < rate_hz < 1e9 else None
