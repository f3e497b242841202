"""The streams of a recording: readings of topics in SI units, on one clock, as a map asks for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata import align
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.formats._assemble import LARGEST_NUMBER
from candata.formats._mapping import check_channels, unit_factors
from candata.formats._mcap_bag import Bag, Recording, TopicRequest, TopicRow
from candata.formats._mcap_fields import Extract, extract, stamp_ns
from candata.formats._stamps import unit_of
from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.episode import Alignment
from candata.schema.topics import TopicEntry, TopicMap

#: Norms of recorded quaternions lie this close to 1, and are made 1; others are no rotations.
_NORM_TOLERANCE = 0.01
_FIT = "log time against header stamps"


@dataclass(frozen=True, eq=False)
class TopicStream:
    """One topic's part of a channel.

    Attributes
    ----------
    channel : str
        Name of the channel.
    entry : TopicEntry
        What the map says of it.
    names : tuple of str
        Elements of its columns; empty for poses.
    time_ns : (n,) int64 [ns]
        Stamps on the chosen clock, not decreasing.
    values : (n, ...) float64 or bool
        In the channel's unit; NaN where nothing was read.
    clocks : Alignment or None
        The recorder's clock against the header stamps; None where there are none.
    """

    channel: str
    entry: TopicEntry
    names: tuple[str, ...]
    time_ns: NDArray[np.int64]
    values: NDArray
    clocks: Alignment | None


def entries(mapping: TopicMap, location: Where) -> list[tuple[str, TopicEntry]]:
    """Return the channels and entries of a map, in its order.

    Raises
    ------
    UsageError
        When a channel is not known, there is neither object_pose nor joint_position, a channel that is one topic's has
        several, or names are given that it has no use for.
    """
    check_channels(mapping.channels, location)
    if mapping.reference is not None and mapping.reference not in mapping.channels:
        raise UnknownNameError("reference channel", mapping.reference, mapping.channels, location)
    pairs = []
    for name, value in mapping.channels.items():
        items = value if isinstance(value, tuple) else (value,)
        topic_entries = [TopicEntry(topic=item) if isinstance(item, str) else item for item in items]
        _check_entries(name, topic_entries, location)
        pairs += [(name, entry) for entry in topic_entries]
    return pairs


def _check_entries(channel: str, topic_entries: Sequence[TopicEntry], location: Where) -> None:
    """Refuse what a channel cannot have."""
    symbol = (*CHANNELS[channel].shape, "")[1]
    location = Where(path=location.path, channel=channel)
    if not topic_entries or (len(topic_entries) > 1 and symbol not in ("J", "A", "F")):
        raise UsageError(f"{channel} needs one topic", found=f"{len(topic_entries)} entries", where=location)
    for entry in topic_entries:
        for word, symbols in (("joints", ("J", "A")), ("fingertips", ("F",))):
            if getattr(entry, word) and symbol not in symbols:
                raise UsageError(f"{channel} has no {word}", fix=f"leave `{word}` out", where=location)


def topic_requests(mapping: TopicMap, location: Where) -> list[TopicRequest]:
    """Return what to take from a recording, an item an entry; a marker's topic comes last."""
    requests = [
        TopicRequest(entry.topic, lambda kind, c=channel, e=entry: extract(c, kind, e, location))  # type: ignore[misc]
        for channel, entry in entries(mapping, location)
    ]
    if mapping.episodes is not None and mapping.episodes.marker is not None:
        requests.append(TopicRequest(mapping.episodes.marker, _marker(mapping, location)))
    return requests


def _marker(mapping: TopicMap, location: Where) -> Callable[[str], Extract]:
    """Return what makes the extractor of the marker: its flag where it is one, else nothing but its time."""
    cuts = mapping.episodes
    if cuts is None or cuts.marker is None:
        raise UsageError("the map has no marker", where=location)
    topic, flag_field = cuts.marker, cuts.field

    def make(kind: str) -> Extract:
        flag = flag_field or ("data" if kind == "std_msgs/Bool" else None)
        if flag is None:
            return lambda message: [(stamp_ns(message), (), ())]
        return extract("contact", kind, TopicEntry(topic=topic, fields=(flag,)), location)

    return make


def require_topics(names: Sequence[str], bag: Bag, location: Where) -> None:
    """Refuse a map that names a topic which the recording lacks, or which is empty.

    Raises
    ------
    UnknownNameError
        Lists the topics and the nearest.
    DataError
        When the topic holds no message, or the files hold none at all.
    """
    if not any(topic.count for topic in bag.topics.values()):
        raise DataError(
            "the recording holds no message that can be read",
            found="; ".join(bag.damage) or "no messages",
            where=location,
        )
    for name in names:
        if name not in bag.topics:
            raise UnknownNameError("topic", name, bag.topics, location)
        if not bag.topics[name].count:
            filled_topics = [candidate for candidate, topic in bag.topics.items() if topic.count]
            raise DataError(
                f"topic {name} is empty",
                expected="messages",
                found="0 messages",
                where=location,
                fix=f"map one that has some: {', '.join(sorted(filled_topics))}",
            )


def stream(
    channel: str,
    entry: TopicEntry,
    rows: Sequence[TopicRow],
    mapping: TopicMap,
    recording: Recording,
    allow_gaps: bool,
    note: Callable[[str], None],
) -> TopicStream:
    """Return one entry's stream.

    Raises
    ------
    DataError
        When it has no reading or no stamps, stamps run back, rows differ in length or names, a quaternion is none, or
        (without `allow_gaps`) a value is not finite; names topic and message.
    UsageError
        When the unit does not fit.
    """
    location = Where(path=recording.where.path, channel=entry.topic)
    if not rows:
        sought = f"frame {entry.child}" if entry.child else f"joints {', '.join(entry.joints)}"
        raise DataError(
            f"{entry.topic} holds nothing for {channel}",
            expected=sought,
            found="no such message",
            where=location,
            fix="correct `child` or `joints` in the map",
        )
    time_ns, clocks = _stamps(rows, entry, entry.clock or mapping.clock, location, note)
    values = _matrix(rows, channel, location)
    columns = slice(0, 3) if channel in QUATERNION else slice(None)
    with np.errstate(over="ignore", invalid="ignore"):
        values *= np.array(unit_factors(channel, values.shape[1], entry.unit, location))
        values[:, columns] *= entry.scale
    _mark_gaps(values, rows, channel, entry, allow_gaps, location, note)
    if channel in QUATERNION:
        _make_unit(values, rows, location)
    shaped_values, names = _shape_values(channel, entry, values, rows, location)
    if CHANNELS[channel].dtype == "bool":
        is_read = np.isfinite(values).all(axis=1)
        return TopicStream(
            channel, entry, names, time_ns[is_read], _flags(shaped_values[is_read], rows, location), clocks
        )
    return TopicStream(channel, entry, names, time_ns, shaped_values, clocks)


def _stamps(
    rows: Sequence[TopicRow], entry: TopicEntry, clock: str, location: Where, note: Callable[[str], None]
) -> tuple[NDArray[np.int64], Alignment | None]:
    """Return the stamps of a topic on the chosen clock, and the recorder's clock against its header stamps."""
    header, log = (np.array([getattr(row, f"{name}_ns") for row in rows], np.int64) for name in ("header", "log"))
    # Simulated time begins at 0; a stamp that is always 0 was never filled in.
    unstamped_rows = np.flatnonzero(header < 0) if header.any() else np.arange(len(rows))
    fit = None if len(unstamped_rows) else align.clock_fit(header, log, _FIT)
    if clock in ("header", "fitted") and fit is None:
        is_partial = len(unstamped_rows) < len(rows)
        raise DataError(
            f"{entry.topic} has no header stamps",
            expected=f"a stamp in each message (clock: {clock})",
            found=f"{len(unstamped_rows)} of {len(rows)} messages without"
            if is_partial
            else "messages without a stamp",
            where=Where(path=location.path, channel=entry.topic, index=rows[int(unstamped_rows[0])].index),
            fix=f"{{topic: {entry.topic}, clock: log}} takes the time at which they were recorded",
        )
    if fit is not None and clock in ("header", "fitted"):
        _require_unit(header, log, entry, location)
    if clock == "log":
        time_ns = log
    elif clock == "publish":
        time_ns = np.array([row.publish_ns for row in rows], np.int64)
    else:
        time_ns = header
    backward_steps = np.flatnonzero(np.diff(time_ns) < 0)
    if len(backward_steps):
        k = int(backward_steps[0]) + 1
        raise DataError(
            f"the stamps of {entry.topic} run back",
            expected=f"at least {time_ns[k - 1]} ns",
            found=f"{time_ns[k]} ns ({len(backward_steps)} steps back)",
            where=Where(path=location.path, channel=entry.topic, index=rows[k].index),
            fix=f"{{topic: {entry.topic}, clock: log}} takes the time at which they were recorded",
        )
    repeat_count = int((np.diff(time_ns) == 0).sum())
    if repeat_count:
        note(f"{entry.topic}: {repeat_count} repeated stamps; of equal ones the last message counts")
    return (_fit_clock(header, log) if clock == "fitted" else time_ns), fit


def _require_unit(header: NDArray[np.int64], log: NDArray[np.int64], entry: TopicEntry, location: Where) -> None:
    """Refuse header stamps that were filled in another unit, as the time at which they were recorded shows."""
    spans = [float(times[-1] - times[0]) * 1e-9 for times in (header, log)]
    unit = unit_of(spans[0] / spans[1]) if min(spans) > 0 else None
    if unit is not None:
        raise DataError(
            f"the header stamps of {entry.topic} are in {unit}, not in s and ns",
            expected=f"{spans[1]:.4g} s from the first to the last, as in the log",
            found=f"{spans[0]:.4g} s",
            where=location,
            fix=f"{{topic: {entry.topic}, clock: log}} takes the time at which they were recorded",
        )


def _fit_clock(header: NDArray[np.int64], log: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return header stamps on the recorder's clock, by the straight line through both."""
    # From the first stamps on: unix nanoseconds are more than a float holds.
    elapsed_ns = header - header[0]
    fit = align.clock_fit(elapsed_ns, log - log[0], _FIT)
    shift_ns = fit.offset_s * 1e9 + fit.drift_ppm * 1e-6 * (elapsed_ns - np.median(elapsed_ns))
    return np.maximum.accumulate(log[0] + elapsed_ns + np.rint(shift_ns).astype(np.int64))


def _matrix(rows: Sequence[TopicRow], channel: str, location: Where) -> NDArray[np.float64]:
    """Return the readings as `(n, columns)`."""
    width, names = len(rows[0].values), rows[0].names
    row_shape = CHANNELS[channel].shape[1:]
    fixed_width = row_shape[0] if len(row_shape) == 1 and isinstance(row_shape[0], int) else None
    for row in rows:
        if len(row.values) != width or row.names != names or width == 0 or width != (fixed_width or width):
            raise DataError(
                f"a message of {location.channel} does not fit {channel}",
                expected=f"{fixed_width or width or 'some'} values" + (f" of {', '.join(names)}" if names else ""),
                found=f"{len(row.values)} values" + (f" of {', '.join(row.names)}" if row.names else ""),
                where=Where(path=location.path, channel=location.channel, index=row.index),
                fix="correct `fields` or `joints` in the map",
            )
    return np.array([row.values for row in rows], np.float64)


def _make_unit(values: NDArray[np.float64], rows: Sequence[TopicRow], location: Where) -> None:
    """Make quaternions unit."""
    norm = np.linalg.norm(values[:, 3:], axis=1)
    bad_rows = np.flatnonzero(np.isfinite(norm) & ~(np.abs(norm - 1) <= _NORM_TOLERANCE))
    if len(bad_rows):
        raise DataError(
            f"{location.channel} holds a quaternion that is not unit",
            expected="norm 1 (w x y z)",
            found=f"norm {norm[bad_rows[0]]:.4g} ({len(bad_rows)} of {len(rows)} messages)",
            where=Where(path=location.path, channel=location.channel, index=rows[int(bad_rows[0])].index),
            fix="check that the topic holds poses, and the order of `fields`",
        )
    values[:, 3:] /= norm[:, None]


def _mark_gaps(
    values: NDArray[np.float64],
    rows: Sequence[TopicRow],
    channel: str,
    entry: TopicEntry,
    allow_gaps: bool,
    location: Where,
    note: Callable[[str], None],
) -> None:
    """Make readings that are not finite, or quaternions of zeros (nothing was seen), NaN as a whole, or refuse them."""
    gaps = ~(np.abs(values) <= LARGEST_NUMBER).all(axis=1)
    if channel in QUATERNION:
        gaps |= ~values[:, QUATERNION[channel]].any(axis=1)
    if not gaps.any():
        return
    first_index = rows[int(np.argmax(gaps))].index
    if not allow_gaps:
        raise DataError(
            f"{entry.topic} is not finite",
            expected="finite numbers (and no quaternion of zeros)",
            found=f"a gap in message {first_index} ({int(gaps.sum())} of {len(rows)} messages)",
            where=Where(path=location.path, channel=entry.topic, index=first_index),
            fix="import with --allow-gaps: the rows that need them are kept and marked invalid",
        )
    values[gaps] = np.nan
    note(f"{entry.topic}: {int(gaps.sum())} of {len(rows)} messages are not finite and count as not read")


def _shape_values(
    channel: str, entry: TopicEntry, values: NDArray[np.float64], rows: Sequence[TopicRow], location: Where
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the values in the channel's shape, and the names of its elements."""
    shape = CHANNELS[channel].shape[1:]
    element_names = entry.joints or entry.fingertips or rows[0].names
    if len(shape) == 2:
        if values.shape[1] % 3:
            raise UsageError(f"{channel} needs three values a fingertip", found=str(values.shape[1]), where=location)
        values = values.reshape(len(values), -1, 3)
    if not shape:
        if values.shape[1] != 1:
            raise UsageError(f"{channel} needs one value", found=str(values.shape[1]), where=location)
        return values[:, 0], ()
    count = values.shape[1]
    if shape[0] not in ("J", "A", "F"):
        return values, ()
    if element_names and len(element_names) != count:
        raise UsageError(
            f"{entry.topic} has not one value a name",
            expected=f"{len(element_names)}: {', '.join(element_names)}",
            found=str(count),
            where=location,
            fix="correct `joints` or `fingertips` in the map",
        )
    topic_name = entry.topic.strip("/").replace("/", "_")
    return values, element_names or ((topic_name,) if count == 1 else tuple(f"{topic_name}_{k}" for k in range(count)))


def _flags(values: NDArray[np.float64], rows: Sequence[TopicRow], location: Where) -> NDArray[np.bool_]:
    """Return flags; they must be 0 or 1."""
    odd_rows = np.flatnonzero(((values != 0) & (values != 1)).reshape(len(values), -1).any(axis=1))
    if len(odd_rows):
        raise DataError(
            f"{location.channel} holds no flags",
            expected="0 or 1",
            found=str(values[odd_rows[0]]),
            where=Where(path=location.path, channel=location.channel, index=rows[int(odd_rows[0])].index),
        )
    return values == 1
