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
_LABELS, _NAME_LIMIT = ("source", "scene", "object", "task"), 5

#: Longest expression that a message proposes [characters].
_EXPRESSION_LIMIT = 1000

#: Channel to its shape without the time axis.
Shapes = dict[str, tuple[int, ...]]


def row_dtype(shapes: Shapes) -> np.dtype:
    """Return the structured dtype of a row: a field a channel, C alignment, whole 8-byte words."""
    aligned_dtype = np.dtype([(name, CHANNELS[name].dtype, shape) for name, shape in shapes.items()], align=True)
    fields: Any = aligned_dtype.fields
    return np.dtype(
        {
            "names": list(shapes),
            "formats": [fields[name][0] for name in shapes],
            "offsets": [fields[name][1] for name in shapes],
            "itemsize": -(-aligned_dtype.itemsize // 8) * 8,
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
    names = canonical_order([name for name in set(channels) if name != POINT_CLOUD])
    return (*names, *([POINT_CLOUD] if POINT_CLOUD in channels else []))


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
        shared_channels = set.intersection(*(set(layout) for _, layout in layouts)) & (set(CHANNELS) - NOT_BY_DEFAULT)
        if not shared_channels:
            raise DataError("no channel is common to all episodes", where=Where(path=str(dataset.path)))
        channels = canonical_order(list(shared_channels))
    return {name: _common_shape(dataset, layouts, name) for name in channels}


def absent_channels(names: Sequence[str], datasets: Iterable[Dataset]) -> tuple[str, ...]:
    """Return those of some channels that no episode of the datasets holds."""
    held = {name for dataset in datasets for _, layout in _layouts(dataset) for name in layout}
    return tuple(name for name in names if name not in held)


def _common_shape(dataset: Dataset, layouts: list[tuple[list[str], Shapes]], name: str) -> tuple[int, ...]:
    """Return the shape of a channel, which every episode must hold alike."""
    ids_without_channel = [episode for ids, layout in layouts if name not in layout for episode in ids]
    if ids_without_channel:
        shared_channels = sorted(set.intersection(*(set(layout) for _, layout in layouts)))
        ending = ", ..." * (len(ids_without_channel) > _NAME_LIMIT)
        examples = ", ".join(sorted(ids_without_channel)[:_NAME_LIMIT]) + ending
        channel_list = ", ".join(n for n in shared_channels if not n.endswith(VALID_SUFFIX))
        raise DataError(
            f"the dataset lacks the channel {name}",
            expected=f"{name} in all {len(dataset)} episodes",
            found=f"{len(ids_without_channel)} without it ({examples}); all have {channel_list}",
            where=Where(path=str(dataset.path), episode=ids_without_channel[0], channel=name),
            fix=_leave_out(dataset, frozenset(ids_without_channel)) + _remedy(name),
        )
    shapes = Counter({layout[name]: len(ids) for ids, layout in layouts})
    if len(shapes) > 1:
        usual_shape = shapes.most_common(1)[0][0]
        mismatch = next(episode for ids, layout in layouts if layout[name] != usual_shape for episode in ids)
        raise DataError(
            f"episodes differ in the shape of {name}",
            expected=f"{('T', *usual_shape)} in all episodes",
            found=" and ".join(str(("T", *shape)) for shape in sorted(shapes)),
            where=Where(path=str(dataset.path), episode=mismatch, channel=name),
            fix="keep one hand a dataset",
        )
    return next(iter(shapes))


def _leave_out(dataset: Dataset, ids: frozenset[str]) -> str:
    """Return the command that makes a dataset without some episodes, for a message; nothing where none is left."""
    if len(ids) == len(dataset):
        return ""
    expression = _filter_expression(dataset, ids)
    if len(expression) > _EXPRESSION_LIMIT:
        return "leave them out by candata registry filter; or "
    argument = shlex.quote(expression) if set(expression) & set('"$`!\\') else f'"{expression}"'
    return f"leave them out: candata registry filter {shlex.quote(str(dataset.path))} {argument} --out NEW; or "


def _filter_expression(dataset: Dataset, ids: frozenset[str]) -> str:
    """Return what `registry filter` takes to leave some episodes out: by a label that tells, or else by id."""
    table = dataset.catalog(["id", *_LABELS])
    is_left_out = [name in ids for name in table["id"].to_pylist()]
    for label in _LABELS:
        values = list(zip(table[label].to_pylist(), is_left_out, strict=True))
        values_to_keep = {value for value, out in values if not out}
        if (
            None not in values_to_keep
            and not values_to_keep & {value for value, out in values if out}
            and len(values_to_keep) <= _NAME_LIMIT
        ):
            return f"{label} in ({_sql_list(values_to_keep)})"
    return f"id not in ({_sql_list(ids)})"


def _sql_list(values: Iterable[str]) -> str:
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
        shapes = parse_json((pq.read_schema(path).metadata or {})[LAYOUT_KEY])
    except UNREADABLE as error:
        raise durable.damaged_error(path, durable.reason(error)) from None
    return {name: tuple(shape) for name, shape in shapes.items()}
