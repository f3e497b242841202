"""Episodes from streams: where they begin and end, their rows, and every stream put on these by its role."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata import align
from candata.errors import DataError, UsageError, Where
from candata.formats import Reading
from candata.formats._assemble import checked_episode, derive_contact
from candata.formats._mcap_bag import Recording, TopicRow
from candata.formats._mcap_streams import TopicStream
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Alignment, ContactRule, Episode, EpisodeMeta
from candata.schema.topics import TopicMap

#: Rows that follow a channel's own stamps must come within this factor of the map's rate.
_RATE_FACTOR = 1.5
#: Largest number of rows of an episode: a stamp far off would otherwise ask for more than any memory.
MOST_ROWS = 50_000_000
_JOINT_CHANNELS = ("joint_position", "joint_velocity", "joint_effort")


@dataclass(frozen=True)
class Window:
    """First and last time of an episode [ns], and what its id ends in."""

    start_ns: int
    end_ns: int
    suffix: str = ""


def episodes(
    recording: Recording, streams: Sequence[TopicStream], marks: Sequence[TopicRow], mapping: TopicMap, reading: Reading
) -> Iterator[Episode]:
    """Yield the episodes of a recording.

    Raises
    ------
    DataError
        When streams do not overlap, a window holds too little, or (without gaps allowed) there is a gap in it.
    UsageError
        When the windows or the rate of the reference are wrong.
    """
    start, end = _common_span(recording, streams)
    for window in windows(recording, streams, marks, mapping, start, end):
        yield _episode(recording, streams, mapping, reading, window)


def _common_span(recording: Recording, streams: Sequence[TopicStream]) -> tuple[int, int]:
    """Return the first and last time that all streams cover [ns]."""
    start, end = max(int(s.time_ns[0]) for s in streams), min(int(s.time_ns[-1]) for s in streams)
    if start > end:
        spans = "; ".join(f"{s.entry.topic} {s.time_ns[0] * 1e-9:.3f} to {s.time_ns[-1] * 1e-9:.3f} s" for s in streams)
        raise DataError(
            "the topics were not recorded at one time",
            expected="stamps that overlap",
            found=spans,
            where=recording.where,
            fix="where a header's clock is not the recorder's, say `clock: fitted` or `clock: log`",
        )
    return start, end


def windows(
    recording: Recording,
    streams: Sequence[TopicStream],
    marks: Sequence[TopicRow],
    mapping: TopicMap,
    start: int,
    end: int,
) -> list[Window]:
    """Return where the episodes of a recording begin and end, within what all streams cover.

    Raises
    ------
    UsageError
        When a range ends before it begins, or lies outside.
    DataError
        When a marker begins no episode.
    """
    cuts = mapping.episodes
    if cuts is None or not (cuts.ranges_s or cuts.marker):
        return [Window(start, end)]
    if cuts.ranges_s and cuts.marker:
        raise UsageError("episodes are cut by ranges or by a marker, not both", fix="leave one out of `episodes`")
    if cuts.marker:
        spans = _between_marks(marks, cuts.clock, start, end)
    else:
        zero = min(int(s.time_ns[0]) for s in streams)
        spans = [(zero + round(a * 1e9), zero + round(b * 1e9)) for a, b in cuts.ranges_s]
    cut_windows = [Window(max(a, start), min(b, end), f"-{k}") for k, (a, b) in enumerate(spans)]
    for (a, b), window in zip(spans, cut_windows, strict=True):
        if window.end_ns <= window.start_ns and not cuts.marker:
            zero = min(int(s.time_ns[0]) for s in streams)
            raise UsageError(
                "an episode's range holds nothing",
                expected=f"within {(start - zero) * 1e-9:.3f} to {(end - zero) * 1e-9:.3f} s, end after begin",
                found=f"{(a - zero) * 1e-9:g} to {(b - zero) * 1e-9:g} s",
                where=recording.where,
            )
    cut_windows = [window for window in cut_windows if window.end_ns > window.start_ns]
    if not cut_windows:
        raise DataError(
            "the marker begins no episode",
            expected=f"messages of {cuts.marker} while all topics run",
            found=f"{len(marks)} messages",
            where=recording.where,
        )
    return cut_windows


def _between_marks(marks: Sequence[TopicRow], clock: str, start: int, end: int) -> list[tuple[int, int]]:
    """Return the spans that a marker opens and closes."""
    spans: list[tuple[int, int]] = []
    begin_ns: int | None = None
    for mark in marks:
        at = mark.log_ns if clock in ("log", "fitted") else mark.publish_ns if clock == "publish" else mark.header_ns
        flag = bool(mark.values[0]) if mark.values else None
        if begin_ns is not None and flag is not True:
            spans.append((begin_ns, at))
            begin_ns = None
        if flag is not False and begin_ns is None:
            begin_ns = at
    return spans if begin_ns is None else [*spans, (begin_ns, end)]


def _episode(
    recording: Recording, streams: Sequence[TopicStream], mapping: TopicMap, reading: Reading, window: Window
) -> Episode:
    """Return one episode, its gaps refused or marked."""
    identity = recording.name + window.suffix
    location = Where(path=recording.where.path, episode=identity)
    rows_ns = _rows(streams, mapping, window, location)
    _refuse_jumps(streams, mapping, rows_ns, reading, location)
    arrays, names = _align_streams(streams, rows_ns, mapping)
    arrays = _trim_rows(arrays, location)
    flags = [name for name in arrays if name.endswith(VALID_SUFFIX)]
    invalid = {name.removesuffix(VALID_SUFFIX): int((~arrays[name]).sum()) for name in flags if not arrays[name].all()}
    if invalid and not reading.allow_gaps:
        raise _gap(arrays, invalid, streams, location)
    for name in flags:
        if arrays[name].all():
            del arrays[name]
    if invalid:
        counts = ", ".join(f"{channel} {count}" for channel, count in invalid.items())
        reading.note(f"{identity}: rows marked invalid by gaps: {counts} of {len(arrays['time_ns'])}")
    rule = derive_contact(arrays, invalid)
    return checked_episode(
        _meta(identity, mapping, reading, names, rule, streams, invalid), arrays, Path(str(location.path))
    )


def _rows(streams: Sequence[TopicStream], mapping: TopicMap, window: Window, location: Where) -> NDArray[np.int64]:
    """Return the times of the rows: those of the reference, or even ones."""
    if mapping.reference is None:
        if (window.end_ns - window.start_ns) * 1e-9 * mapping.rate_hz > MOST_ROWS:
            raise DataError(
                "the stamps span too long a time",
                expected=f"at most {MOST_ROWS} rows",
                found=f"{(window.end_ns - window.start_ns) * 1e-9:.0f} s",
                where=location,
            )
        rows_ns = align.grid(window.start_ns, window.end_ns, mapping.rate_hz)
    else:
        reference_ns = np.unique(next(s.time_ns for s in streams if s.channel == mapping.reference))
        rows_ns = reference_ns[(reference_ns >= window.start_ns) & (reference_ns <= window.end_ns)]
        times = align.period_ns(rows_ns) * 1e-9 * mapping.rate_hz
        if len(rows_ns) > 1 and not 1 / _RATE_FACTOR < times < _RATE_FACTOR:
            raise UsageError(
                f"the rows of {mapping.reference} do not come at rate_hz",
                expected=f"{mapping.rate_hz:g} Hz",
                found=f"{mapping.rate_hz / times:.4g} Hz",
                where=location,
                fix="correct rate_hz, or leave `reference` out: the rows are then rate_hz apart",
            )
    if len(rows_ns) < 2:
        raise DataError(
            "too little is left for an episode",
            expected="at least 2 rows",
            found=f"{len(rows_ns)} rows in {(window.end_ns - window.start_ns) * 1e-9:.3f} s",
            where=location,
        )
    return rows_ns


def _refuse_jumps(
    streams: Sequence[TopicStream], mapping: TopicMap, rows_ns: NDArray[np.int64], reading: Reading, location: Where
) -> None:
    """Refuse, or tell of, steps between rows at which the reference itself has a gap."""
    if mapping.reference is None:
        return
    reference = next(s for s in streams if s.channel == mapping.reference)
    steps = np.diff(rows_ns)
    jumps = np.flatnonzero(steps > reference.entry.max_gap_periods * align.period_ns(reference.time_ns))
    if not len(jumps):
        return
    row, topic = int(jumps[0]) + 1, reference.entry.topic
    if not reading.allow_gaps:
        raise DataError(
            f"{topic} has a gap",
            expected="a reading near every row",
            found=f"none over {steps[row - 1] * 1e-9:.3f} s ({len(jumps)} gaps)",
            where=Where(path=location.path, episode=location.episode, channel=reference.channel, index=row),
            fix="import with --allow-gaps: time then jumps there; or raise `max_gap_periods` in the map",
        )
    reading.note(f"{location.episode}: time jumps at {len(jumps)} gaps of {topic}, by up to {steps.max() * 1e-9:.3f} s")


def _align_streams(
    streams: Sequence[TopicStream], rows_ns: NDArray[np.int64], mapping: TopicMap
) -> tuple[dict[str, NDArray], dict[str, tuple[str, ...]]]:
    """Return every channel with its flags on the rows, and the names of its columns."""
    arrays: dict[str, NDArray] = {"time_ns": rows_ns}
    names: dict[str, tuple[str, ...]] = {}
    for channel in dict.fromkeys(s.channel for s in streams):
        channel_streams = [s for s in streams if s.channel == channel]
        parts = [_on_rows(s, rows_ns, mapping) for s in channel_streams]
        values = [f.values for f in parts]
        arrays[channel] = np.concatenate(values, axis=1) if len(values) > 1 else values[0]
        arrays[channel + VALID_SUFFIX] = np.logical_and.reduce([f.valid for f in parts])
        names[channel] = tuple(name for s in channel_streams for name in s.names)
    joints = {channel: names[channel] for channel in _JOINT_CHANNELS if channel in names}
    if len(set(joints.values())) > 1:
        raise UsageError(
            "the joints differ between channels",
            expected="the same joints in one order",
            found="; ".join(f"{channel}: {', '.join(labels)}" for channel, labels in joints.items()),
            fix="say `joints: [...]` in each",
        )
    return arrays, names


def _on_rows(stream: TopicStream, rows_ns: NDArray[np.int64], mapping: TopicMap) -> align.ResampledStream:
    """Return a stream on the rows."""
    role = stream.entry.role
    if role is None and stream.channel == "fingertip_force" and mapping.force == "instant":
        role = "state"
    return align.on_rows(
        stream.channel,
        stream.time_ns,
        stream.values,
        rows_ns,
        max_gap_periods=stream.entry.max_gap_periods,
        role=role,
        action=mapping.action,
    )


def _trim_rows(arrays: dict[str, NDArray], location: Where) -> dict[str, NDArray]:
    """Return the rows from the first to the last that every channel has begun and not ended by."""
    flags = [arrays[name] for name in arrays if name.endswith(VALID_SUFFIX)]
    for name, flag in ((n, arrays[n]) for n in arrays if n.endswith(VALID_SUFFIX)):
        if not flag.any():
            channel = name.removesuffix(VALID_SUFFIX)
            raise DataError(
                f"no row has a valid {channel}",
                found=f"{len(flag)} rows, all within gaps",
                where=Where(path=location.path, episode=location.episode, channel=channel),
                fix="raise `max_gap_periods` of its topic where its rate varies, or leave it out",
            )
    start = max(int(np.argmax(flag)) for flag in flags)
    stop = min(len(flag) - int(np.argmax(flag[::-1])) for flag in flags)
    if stop - start < 2:
        raise DataError(
            "too little is left for an episode",
            expected="at least 2 rows that all topics cover",
            found=str(max(stop - start, 0)),
            where=location,
        )
    return {name: values[start:stop] for name, values in arrays.items()}


def _gap(
    arrays: Mapping[str, NDArray], invalid: Mapping[str, int], streams: Sequence[TopicStream], location: Where
) -> DataError:
    """Return the error of a gap."""
    channel = next(iter(invalid))
    flag, time_ns = arrays[channel + VALID_SUFFIX], arrays["time_ns"]
    row = int(np.argmin(flag))
    topics = ", ".join(dict.fromkeys(s.entry.topic for s in streams if s.channel == channel))
    end_row = row + int(np.argmax(np.append(flag[row:], True)))
    counts = ", ".join(f"{name} {count}" for name, count in invalid.items())
    length_s = (time_ns[min(end_row, len(time_ns) - 1)] - time_ns[row]) * 1e-9
    return DataError(
        f"{topics} has a gap",
        expected="a reading near every row",
        found=f"none over {length_s:.3f} s, {(time_ns[row] - time_ns[0]) * 1e-9:.3f} s after the first row "
        f"(rows without: {counts} of {len(time_ns)})",
        where=Where(path=location.path, episode=location.episode, channel=channel, index=row),
        fix="import with --allow-gaps: such rows are kept and marked invalid; or raise `max_gap_periods` in the map, "
        "or cut the episodes",
    )


def _meta(
    identity: str,
    mapping: TopicMap,
    reading: Reading,
    names: Mapping[str, tuple[str, ...]],
    rule: ContactRule | None,
    streams: Sequence[TopicStream],
    invalid: dict[str, int],
) -> EpisodeMeta:
    """Return who, what, when."""
    return EpisodeMeta(
        id=identity,
        source=mapping.source or reading.source,
        rate_hz=mapping.rate_hz,
        scene=mapping.scene or reading.scene,
        object=mapping.object or reading.object,
        task=mapping.task or reading.task,
        force=mapping.force,
        action=mapping.action,
        joint_names=next((names[c] for c in _JOINT_CHANNELS if c in names), ()),
        actuator_names=names.get("action", ()),
        fingertip_names=next((names[c] for c in ("fingertip_force", "fingertip_contact") if c in names), ()),
        contact_rule=rule,
        alignment=_alignment(mapping, streams),
        invalid_counts=invalid,
    )


def _alignment(mapping: TopicMap, streams: Sequence[TopicStream]) -> Alignment:
    """Return how the streams were put on one clock; offset and drift of the first that has both clocks."""
    parts = [
        f"{s.channel} from {s.entry.topic} by {s.entry.clock or mapping.clock}, {_role(s, mapping)}" for s in streams
    ]
    rows = f"rows at the stamps of {mapping.reference}" if mapping.reference else f"rows at {mapping.rate_hz:g} Hz"
    clock_stream = next((s for s in streams if s.clocks is not None), None)
    if clock_stream is None or clock_stream.clocks is None:
        return Alignment(method="; ".join([rows, *parts]))
    applied_text = "applied" if (clock_stream.entry.clock or mapping.clock) == "fitted" else "not applied"
    topic = clock_stream.entry.topic
    clock_text = f"offset and drift: the recorder's clock against the header stamps of {topic}, {applied_text}"
    method = "; ".join([rows, *parts, clock_text])
    return clock_stream.clocks.model_copy(update={"method": method})


def _role(stream: TopicStream, mapping: TopicMap) -> str:
    """Return a stream's role in words."""
    if stream.entry.role is not None:
        return stream.entry.role
    instant = stream.channel == "fingertip_force" and mapping.force == "instant"
    return "state" if instant else align.ROLES.get(stream.channel, "state")
