"""From a log to an episode: streams put on one grid, forces calibrated, gaps marked.

The grid has the scene's rate. It begins when all streams have begun and the calibration window is over, on the beat
of the states (a command takes effect once its frame is whole, which is when the reply begins), and ends with the
first stream that ends. `action[k]` is what was commanded in the middle of the step that it is held over, and a
reading of force stands for the device's period before its stamp, so that it counts where the middle of that falls.
Where hand and grid have one rate, jitter of up to half a period then moves nothing into another row; where they
have not, commands and forces move by half a period at most, neither always early nor always late. Frames read in one
burst after a gap had waited for a reader that was held up: their stamps tell nothing, and they are left out. Where a
USB adapter's timer holds every frame, none is: their stamps are late by up to its period, which is said. Motor current
stays in the log: it is no joint effort, as no torque constant of the motors is published.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata import align
from candata.errors import DataError, UsageError, Where
from candata.record.bursts import WORDS, comes_in_bursts, remedy, seen_rate_hz
from candata.record.companions import Companion, RecordedStream
from candata.record.import_contact import add_contact, contact_shares
from candata.record.import_recipe import ImportRecipe
from candata.record.import_streams import (
    column_order,
    gap_periods,
    merge_streams,
    punctual,
    require_overlap,
    span,
    utc,
    wire_streams,
)
from candata.record.logged_companions import is_logged, logged_companions
from candata.record.logs import Log
from candata.record.stream_clocks import clock_notes, set_clocks
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Alignment, ContactRule, Episode, EpisodeMeta, StreamClock

Arrays = dict[str, NDArray]

#: States whose median beat the grid begins on: one late stamp must not shift it.
BEAT_ROWS = 81
#: Largest rate of the grid as a multiple of the hand's.
RATES = 20


@dataclass(frozen=True, eq=False)
class ImportedLog:
    """What a log became.

    Attributes
    ----------
    episode : Episode
        The whole session.
    digest : str
        sha256 over the recipe, the log and its companions.
    details : dict
        Plain data for the lineage: sources, recipe, calibration, what was clipped, left out and marked.
    notes : tuple of str
        What a person should know, a line each.
    """

    episode: Episode
    digest: str
    details: dict[str, Any]
    notes: tuple[str, ...]


def import_log(path: str | Path, log: Log, recipe: ImportRecipe, companions: Sequence[Companion] = ()) -> ImportedLog:
    """Return the episode in a log and the files recorded beside it.

    Parameters
    ----------
    path : str or Path
        File of the log, for messages and the lineage.
    log : Log
        As read.
    recipe : Recipe
        All settings.
    companions : sequence of Companion
        Poses, joints and commands that the wire does not carry.

    Raises
    ------
    DataError
        When the log holds no states or no calibration, a companion's stamps do not meet it, joints of the scene
        are in none of the files, or the scene has none of the hand's.
    UsageError
        When the rate is far above the hand's.
    """
    path = Path(path)
    _refuse(path, log, recipe)
    scale = recipe.newton_per_count or log.meta.newton_per_count
    in_bursts = comes_in_bursts(log.read_time_ns, (log.meta.rate_hz, seen_rate_hz(log.state_time_ns)))
    log, late_note = (log, "") if in_bursts else punctual(log, recipe.max_gap_periods)
    beside_hand, stream_notes = logged_companions(log)
    streams, notes = merge_streams(wire_streams(log, scale), [*beside_hand, *companions])
    if recipe.align == "stamps":
        clocks: tuple[StreamClock, ...] = ()
    else:
        streams, clocks = set_clocks(streams, by_motion=recipe.align == "clocks")
    notes += [*stream_notes, *clock_notes(clocks)]
    require_overlap(str(path), streams)
    rate_hz = recipe.roles.rate_hz if recipe.roles else recipe.rate_hz or log.meta.rate_hz
    _refuse_rate(path, log, rate_hz)
    grid_ns = _grid(path, log, streams, rate_hz)
    arrays, names = _align_streams(streams, grid_ns, recipe, in_bursts)
    add_contact(arrays, recipe.threshold_n, recipe.release_n)
    arrays = _from_first_command(arrays)
    flags = {n: n.removesuffix(VALID_SUFFIX) for n in arrays if n.endswith(VALID_SUFFIX)}
    invalid = {channel: int((~arrays[name]).sum()) for name, channel in flags.items() if not arrays[name].all()}
    episode_arrays = {name: values for name, values in arrays.items() if name not in flags or flags[name] in invalid}
    meta = _meta(log, recipe, companions, names, rate_hz, invalid, clocks)
    if recipe.roles is not None and "object_pose" in episode_arrays and meta.object == recipe.roles.object:
        meta = meta.model_copy(update={"point_cloud": recipe.point_cloud})
    episode = Episode(meta, episode_arrays)
    details = _details(path, log, recipe, companions, episode, scale)
    notes += [late_note] if late_note else []
    notes += [f"bytes {WORDS}, half of that in the mean; do: {remedy(log.meta.port)}"] if in_bursts else []
    return ImportedLog(episode, _digest(log, recipe, companions), details, (*notes, *_notes(log, episode, details)))


def _meta(
    log: Log,
    recipe: ImportRecipe,
    companions: Sequence[Companion],
    names: dict[str, tuple[str, ...]],
    rate_hz: float,
    invalid: dict[str, int],
    clocks: tuple[StreamClock, ...],
) -> EpisodeMeta:
    """Return who, what, when."""
    scale = recipe.newton_per_count or log.meta.newton_per_count
    rule = ContactRule(threshold_n=recipe.threshold_n, release_n=recipe.release_n, newton_per_count=scale)
    return EpisodeMeta(
        id=recipe.episode,
        source="real",
        rate_hz=rate_hz,
        scene=recipe.scene or _first_stated(c.scene for c in companions),
        object=recipe.object
        or _first_stated([*(c.object for c in companions), recipe.roles.object if recipe.roles else None]),
        task=recipe.task or _first_stated(c.task for c in companions),
        outcome=recipe.outcome,
        labels=recipe.labels,
        joint_names=names.get("joint_position", ()),
        actuator_names=names.get("action", ()),
        fingertip_names=names.get("fingertip_force", ()),
        contact_rule=rule if "fingertip_force" in names else None,
        newton_per_count=scale if "taxels" in names else None,
        alignment=_clock(log, recipe).model_copy(update={"streams": clocks}),
        invalid_counts=invalid,
    )


def _refuse(path: Path, log: Log, recipe: ImportRecipe) -> None:
    """Refuse a log without states or (unless asked for) calibration, and a release above the threshold."""
    place = Where(path=str(path))
    if recipe.release_n is not None and recipe.release_n > recipe.threshold_n:
        raise UsageError(
            "contact would end above the force at which it begins",
            expected=f"--release of at most {recipe.threshold_n:g} N, the threshold",
            found=f"{recipe.release_n:g} N",
        )
    if not len(log.state_time_ns):
        raise DataError(
            "the log holds no states",
            expected=f"state frames of {log.meta.device}",
            found=f"{len(log.command_time_ns)} commands, no states",
            where=place,
            fix="check port, baud rate and power of the hand, and record again",
        )
    if log.calibration is None and log.meta.fingertip_names and not recipe.uncalibrated:
        raise DataError(
            "the log has no calibration",
            expected="what the fingertips read at rest",
            where=place,
            fix="record with calibration; or import with --uncalibrated: forces then keep their offset, "
            "and contact may be wrong",
        )


def _refuse_rate(path: Path, log: Log, rate_hz: float) -> None:
    """Refuse a rate so far above the hand's that nearly every row would be made up."""
    highest_hz = RATES * log.meta.rate_hz
    if rate_hz > highest_hz:
        raise UsageError(
            "the rate is far above the hand's",
            expected=f"at most {highest_hz:g} Hz for a hand of {log.meta.rate_hz:g} Hz",
            found=f"{rate_hz:g} Hz",
            where=Where(path=str(path)),
            fix="give the rate that the model runs at, or another scene",
        )


def _grid(path: Path, log: Log, streams: Sequence[RecordedStream], rate_hz: float) -> NDArray[np.int64]:
    """Return the times that all streams cover, after the calibration; one beside the hand may fall silent."""
    states = log.state_time_ns
    calibrated_ns = _calibrated_ns(log)
    earliest = max(calibrated_ns, *(int(s.time_ns[0]) for s in streams))
    end_ns = min(int(s.time_ns[-1]) for s in streams if not is_logged(s))
    row = int(np.searchsorted(states, earliest))
    period = align.period_ns(states)
    grid_ns = np.zeros(0, np.int64)
    if row < len(states) and np.isfinite(period):
        grid_ns = align.grid(_on_beat(states[row : row + BEAT_ROWS], period, earliest), end_ns, rate_hz)
    if len(grid_ns) < 2:
        spans = "; ".join(f"{s.channel} of {s.origin} {span(s.time_ns)}" for s in streams)
        raise DataError(
            "too little is left of the log: all streams together cover less than two rows",
            expected=f"time that all streams cover after {utc(calibrated_ns)}, when the calibration ended",
            found=spans,
            where=Where(path=str(path)),
            fix="record longer",
        )
    return grid_ns


def _calibrated_ns(log: Log) -> int:
    """Return when the calibration was over [ns]: a hand that was unplugged meanwhile was calibrated anew."""
    if log.calibration is None:
        return int(log.state_time_ns[0])
    if log.calibration.end_ns is not None:
        return log.calibration.end_ns
    return int(log.state_time_ns[0]) + round(log.calibration.duration_s * 1e9)


def _on_beat(states: NDArray[np.int64], period_ns: float, earliest_ns: int) -> int:
    """Return the first time from `earliest_ns` on that lies on the median beat of `states`."""
    # From the first state on: unix nanoseconds are more than a float holds.
    phase_ns = (states - states[0] + period_ns / 2) % period_ns - period_ns / 2
    beat, earliest = float(np.median(phase_ns)), int(earliest_ns - states[0])
    return int(states[0]) + round(beat + period_ns * np.ceil((earliest - beat - 1) / period_ns))


def _align_streams(
    streams: Sequence[RecordedStream], grid_ns: NDArray[np.int64], recipe: ImportRecipe, in_bursts: bool
) -> tuple[Arrays, dict[str, tuple[str, ...]]]:
    """Return every channel with its flags on the grid, and the names of their columns; `in_bursts`: read in bursts."""
    arrays: Arrays = {"time_ns": grid_ns}
    names: dict[str, tuple[str, ...]] = {}
    for channel in dict.fromkeys(s.channel for s in streams):
        channel_streams = [s for s in streams if s.channel == channel]
        order, names[channel] = column_order(channel_streams, recipe.roles)
        gaps = [gap_periods(s, recipe.max_gap_periods, in_bursts) for s in channel_streams]
        sampled = [
            align.on_rows(s.channel, s.time_ns, s.values, grid_ns, max_gap_periods=gap)
            for s, gap in zip(channel_streams, gaps, strict=True)
        ]
        values = np.concatenate([f.values for f in sampled], axis=1) if len(sampled) > 1 else sampled[0].values
        arrays[channel] = values if order is None else values[:, order]
        arrays[channel + VALID_SUFFIX] = np.logical_and.reduce([f.valid for f in sampled])
    return arrays, names


def _from_first_command(arrays: Arrays) -> Arrays:
    """Return the rows from the first whose command is known: nothing can be replayed before."""
    valid = arrays.get("action" + VALID_SUFFIX)
    begin = 0 if valid is None or not valid.any() else int(np.argmax(valid))
    return {name: values[begin:] for name, values in arrays.items()} if begin else arrays


def _clock(log: Log, recipe: ImportRecipe) -> Alignment:
    """Return how the streams were aligned, with the wall clock against the log's over the recording."""
    method = (
        f"own stamps; states linear, commands held, forces the mean of the step, none over gaps of more than "
        f"{recipe.max_gap_periods:g} periods; offset and drift: the wall clock against the log's, not applied"
    )
    pairs = [s["clock"] for s in log.statistics if {"monotonic_ns", "wall_ns"} <= set(s.get("clock", ()))]
    reference = np.array([p["monotonic_ns"] for p in pairs], np.int64) + log.meta.wall_offset_ns
    return align.clock_fit(reference, np.array([p["wall_ns"] for p in pairs], np.int64), method)


def _first_stated(values: Iterable[str | None]) -> str | None:
    """Return the first that is stated, None if none is."""
    return next((value for value in values if value is not None), None)


def _digest(log: Log, recipe: ImportRecipe, companions: Sequence[Companion]) -> str:
    """Return the sha256 over everything that determines the episode."""
    text = "\n".join([recipe.model_dump_json(), log.sha256, *(c.digest for c in companions)])
    return hashlib.sha256(text.encode()).hexdigest()


def _details(
    path: Path, log: Log, recipe: ImportRecipe, companions: Sequence[Companion], episode: Episode, scale: float
) -> dict[str, Any]:
    """Return what the lineage keeps, as plain data."""
    time_ns, states = episode["time_ns"], log.state_time_ns
    rows = slice(*np.searchsorted(states, [time_ns[0], time_ns[-1]], side="right").tolist())
    calibration = log.calibration and {
        "rows": log.calibration.rows,
        "duration_s": log.calibration.duration_s,
        "force_bias_counts": log.calibration.force_bias_counts.tolist(),
    }
    return {
        "log": path.name,
        "log_sha256": log.sha256,
        "device": log.meta.device,
        "with": [{"file": c.name, "sha256": c.digest} for c in companions],
        "recipe": recipe.model_dump(mode="json"),
        "calibration": calibration,
        "newton_per_count": scale,
        "saturated": {
            "state_frames": rows.stop - rows.start,
            "force": _saturation_counts(log, log.force_counts[rows]),
            "taxels": {} if log.taxel_counts is None else _saturation_counts(log, log.taxel_counts[rows]),
        },
        "invalid": dict(episode.meta.invalid_counts),
        "left_out_s": {
            "before": (int(time_ns[0]) - int(states[0])) * 1e-9,
            "after": max(0.0, (int(states[-1]) - int(time_ns[-1])) * 1e-9),
        },
        "contact_share_by_newton_per_count": contact_shares(episode, scale),
        "torn": log.torn,
        "damaged_chunks": log.damaged_chunks,
    }


def _saturation_counts(log: Log, counts: NDArray[np.int16]) -> dict[str, int]:
    """Return, for each fingertip, the readings of which an axis stands at an end of its range.

    An axis that cannot be negative rests at its lower end: nothing can be said of it there.
    """
    at_end = np.zeros(counts.shape[:-1], bool)
    for axis, (low, high) in enumerate(zip(log.meta.count_low, log.meta.count_high, strict=True)):
        at_end |= counts[..., axis] >= high
        if low < 0:
            at_end |= counts[..., axis] <= low
    return {name: int(at_end[:, k].sum()) for k, name in enumerate(log.meta.fingertip_names)}


def _notes(log: Log, episode: Episode, details: dict[str, Any]) -> list[str]:
    """Return what a person should know of the import."""
    left_out, saturation = details["left_out_s"], details["saturated"]
    notes = [
        f"{details['log']}: {len(episode)} rows at {episode.meta.rate_hz:g} Hz; left out {left_out['before']:.2f} s "
        f"before (calibration, streams that had not begun) and {left_out['after']:.2f} s after",
        f"saturated readings: {sum(saturation['force'].values())} of fingertips, "
        f"{sum(saturation['taxels'].values())} of taxels, in {saturation['state_frames']} states",
    ]
    if episode.meta.invalid_counts:
        invalid_text = ", ".join(f"{name} {count}" for name, count in episode.meta.invalid_counts.items())
        notes.append(f"rows marked invalid by gaps: {invalid_text}")
    if log.calibration is None and log.meta.fingertip_names:
        notes.append("not calibrated: forces keep their offset, and contact may be wrong")
    if log.torn or log.damaged_chunks:
        notes.append(f"the log is torn or damaged ({log.damaged_chunks} chunks lost): what could be read was imported")
    fit = episode.meta.alignment
    moved_s = abs(fit.drift_ppm) * 1e-6 * float(episode.time_s[-1]) + abs(fit.offset_s) if fit else 0.0
    if details["with"] and moved_s * episode.meta.rate_hz > 0.5:
        notes.append(f"the wall clock moved against the log's by up to {moved_s:.3f} s: files with wall stamps may lag")
    return notes
