"""How one row of a dataset lies in the cache: all channels of a row side by side, so that a row is one copy."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from candata.datasets import Dataset, durable
from candata.datasets.encode import LAYOUT_KEY
from candata.datasets.parts import STEPS, UNREADABLE, RawPart
from candata.errors import DataError, UnknownNameError, Where
from candata.schema.channels import CHANNELS, VALID_SUFFIX, canonical_order
from candata.schema.json_text import parse_json

#: The pseudo-channel that asks for a point cloud of every episode's object.
POINT_CLOUD = "point_cloud"

#: Channels that windows hold only when asked for: the clock, and taxels, of which a row is a hundred times the rest.
NOT_BY_DEFAULT = {"time_ns", "taxels"}

#: Labels by which episodes are told apart in a message, and how many of them or of ids it names.
_LABELS, _NAMED = ("source", "scene", "object", "task"), 5

#: Longest expression that a message proposes [characters].
_LONGEST = 1000

#: Channel to its shape without the time axis.
Shapes = dict[str, tuple[int, ...]]


def row_dtype(shapes: Shapes) -> np.dtype:
    """Return the structured dtype of a row: a field a channel, C alignment, whole 8-byte words."""
    packed = np.dtype([(name, CHANNELS[name].dtype, shape) for name, shape in shapes.items()], align=True)
    fields: Any = packed.fields
    return np.dtype(
        {
            "names": list(shapes),
            "formats": [fields[name][0] for name in shapes],
            "offsets": [fields[name][1] for name in shapes],
            "itemsize": -(-packed.itemsize // 8) * 8,
        }
    )


def known_channels(channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels in canonical order, each once; `point_cloud` comes last.

    Raises
    ------
    UnknownNameError
        When one is not in the schema.
    """
    for name in channels:
        if name not in CHANNELS and name != POINT_CLOUD:
            raise UnknownNameError("channel", name, [*CHANNELS, POINT_CLOUD])
    ordered = canonical_order([name for name in set(channels) if name != POINT_CLOUD])
    return (*ordered, *([POINT_CLOUD] if POINT_CLOUD in channels else []))


def row_shapes(dataset: Dataset, channels: Sequence[str] | None) -> Shapes:
    """Return each channel's shape without the time axis, the same in every episode.

    Parameters
    ----------
    dataset : Dataset
        Version to read.
    channels : sequence of str, optional
        Channels that every episode must hold; by default those that all hold, without time and
        taxels.

    Raises
    ------
    DataError
        When an episode lacks a channel or has it in another shape, or nothing is common to all.
    """
    layouts = _layouts(dataset)
    if channels is None:
        common = set.intersection(*(set(layout) for _, layout in layouts)) & (set(CHANNELS) - NOT_BY_DEFAULT)
        if not common:
            raise DataError("no channel is common to all episodes", where=Where(path=str(dataset.path)))
        channels = canonical_order(list(common))
    return {name: _common_shape(dataset, layouts, name) for name in channels}


def _common_shape(dataset: Dataset, layouts: list[tuple[list[str], Shapes]], name: str) -> tuple[int, ...]:
    """Return the shape of a channel, which every episode must hold alike."""
    lacking = [episode for ids, layout in layouts if name not in layout for episode in ids]
    if lacking:
        held = sorted(set.intersection(*(set(layout) for _, layout in layouts)))
        some = f"{', '.join(sorted(lacking)[:_NAMED])}{', ...' * (len(lacking) > _NAMED)}"
        common = ", ".join(n for n in held if not n.endswith(VALID_SUFFIX))
        raise DataError(
            f"the dataset lacks the channel {name}",
            expected=f"{name} in all {len(dataset)} episodes",
            found=f"{len(lacking)} without it ({some}); all have {common}",
            where=Where(path=str(dataset.path), episode=lacking[0], channel=name),
            fix=_leave_out(dataset, frozenset(lacking)) + _remedy(name),
        )
    shapes = Counter({layout[name]: len(ids) for ids, layout in layouts})
    if len(shapes) > 1:
        usual = shapes.most_common(1)[0][0]
        other = next(episode for ids, layout in layouts if layout[name] != usual for episode in ids)
        raise DataError(
            f"episodes differ in the shape of {name}",
            expected=f"{('T', *usual)} in all episodes",
            found=" and ".join(str(("T", *shape)) for shape in sorted(shapes)),
            where=Where(path=str(dataset.path), episode=other, channel=name),
            fix="keep one hand a dataset",
        )
    return next(iter(shapes))


def _leave_out(dataset: Dataset, ids: frozenset[str]) -> str:
    """Return the command that makes a dataset without some episodes, for a message; nothing where none is left."""
    if len(ids) == len(dataset):
        return ""
    where = _without(dataset, ids)
    if len(where) > _LONGEST:
        return "leave them out by candata registry filter; or "
    quoted = shlex.quote(where) if set(where) & set('"$`!\\') else f'"{where}"'
    return f"leave them out: candata registry filter {shlex.quote(str(dataset.path))} {quoted} --out NEW; or "


def _without(dataset: Dataset, ids: frozenset[str]) -> str:
    """Return what `registry filter` takes to leave some episodes out: by a label that tells, or else by id."""
    table = dataset.catalog(["id", *_LABELS])
    gone = [name in ids for name in table["id"].to_pylist()]
    for label in _LABELS:
        values = list(zip(table[label].to_pylist(), gone, strict=True))
        kept = {value for value, out in values if not out}
        if None not in kept and not kept & {value for value, out in values if out} and len(kept) <= _NAMED:
            return f"{label} in ({_quoted(kept)})"
    return f"id not in ({_quoted(ids)})"


def _quoted(values: Iterable[str]) -> str:
    """Return texts as SQL writes them."""
    return ", ".join("'" + value.replace("'", "''") + "'" for value in sorted(values))


def _remedy(name: str) -> str:
    """Return what to do when a channel is missing."""
    if name in ("contact", "fingertip_contact"):
        return "import with fingertip_force, from which contact is derived, or take a model without contact"
    return f"import or generate {name}, or ask for channels that the dataset holds"


def _layouts(dataset: Dataset) -> list[tuple[list[str], Shapes]]:
    """Return (episode ids, channel shapes) of each part that holds episodes of the version."""
    ids: dict[str, list[str]] = {}
    parts: dict[str, RawPart] = {}
    for name, place in dataset.places.items():
        ids.setdefault(place.part.entry.id, []).append(name)
        parts[place.part.entry.id] = place.part
    return [(names, _part_layout(parts[key])) for key, names in ids.items()]


def _part_layout(part: RawPart) -> Shapes:
    """Return the shapes that a part's episodes share."""
    path = part.folder / STEPS
    try:
        stored = parse_json((pq.read_schema(path).metadata or {})[LAYOUT_KEY])
    except UNREADABLE as error:
        raise durable.damaged(path, durable.reason(error)) from None
    return {name: tuple(shape) for name, shape in stored.items()}
