"""The recorder: what the reader passes on becomes a log, checked, counted and shown while it grows."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.errors import CandataError, SetupError, UsageError, Where
from candata.record.addresses import Address, StreamSource, require_distinct
from candata.record.calibration import Calibration
from candata.record.devices._contract import Commands, Device, Frame, States
from candata.record.drift import DriftWindow, drift_text, resting_hand
from candata.record.link_watch import LinkWatch
from candata.record.logs import LogMeta, LogWriter, meta_of
from candata.record.poll import poll_of
from candata.record.reader_link import Event, ReaderLink, port_error, wait_for_events
from candata.record.recorder_errors import check_space, no_state, reader_died
from candata.record.recorder_tally import RecorderTally, join_states
from candata.record.recorder_values import Phase, RecorderSettings, RecorderView, RecordingReport
from candata.record.session_run import RunningSession
from candata.record.stream_recorder import StreamRecording, open_streams
from candata.schema.contact import fingertip_contact

_WAIT_S = 0.05
_FLUSH_S, _STATISTICS_S, _SHOW_S, _SPACE_S = 0.25, 1.0, 0.2, 1.0


def record(
    device: Device,
    port: str | Address,
    out: Path,
    *,
    name: str,
    settings: RecorderSettings | None = None,
    overrides: dict[str, Any] | None = None,
    session: RunningSession | None = None,
    streams: Sequence[StreamSource] = (),
    stop: Callable[[], bool] = lambda: False,
    show: Callable[[RecorderView], None] = lambda view: None,
    say: Callable[[str], None] = lambda text: None,
) -> RecordingReport:
    """Listen to a hand and the streams beside it until told to stop, and return the report.

    Not one byte is written to a port or socket unless `settings.poll_rad` is given.

    Parameters
    ----------
    device : Device
        What the bytes mean.
    port : str or Address
        Serial port, or the address of a log that is played as one.
    out : Path
        Log to write; must not exist.
    name : str
        Registered name of the device.
    settings : RecorderSettings, optional
        How to record.
    overrides : dict, optional
        Values of the log's metadata that replace the device's own, such as `newton_per_count`.
    session : RunningSession, optional
        Makes marks of episodes; it ends the recording when it is done, and a drift check follows.
    streams : sequence of StreamSource
        What is recorded beside the hand into the same log.
    stop : callable
        Asked several times a second; True ends the recording in good order.
    show, say : callable
        Given what can be seen, five times a second, and notes for people.

    Raises
    ------
    UsageError
        When `out` exists, two streams have one name or address, the set-point to poll with is refused, or episodes
        are to begin by contact and no force tells of one.
    SetupError
        When a port or address cannot be opened, the disk is full, or pyserial is missing; the report has later ones.
    """
    settings = settings or RecorderSettings()
    if out.exists():
        raise UsageError("the output exists already", where=Where(path=str(out)), fix="choose another --out")
    check_space(out, settings.reserve_bytes)
    offset_ns = time.time_ns() - time.monotonic_ns()
    address = Address("serial", port) if isinstance(port, str) else port
    meta = meta_of(device, name, **{**(overrides or {}), "port": address.place, "wall_offset_ns": offset_ns})
    address = replace(address, baud=meta.baud)
    poll = None if settings.poll_rad is None else poll_of(device, name, settings.poll_rad)
    require_distinct(streams)
    if session is not None:
        session.check(meta.fingertip_names, settings.calibrate_s > 0)
    with ReaderLink(address, settings.reconnect_s, poll) as link, open_streams(streams, settings.reconnect_s) as opened:
        open_event = link.opened()
        if open_event.facts.get("note"):
            say(open_event.facts["note"])
        writer = LogWriter(out, meta)
        recording = _Recording(device, meta, writer, settings, open_event.stamp_ns, say, session)
        failure: CandataError | None = None
        try:
            recording.streams = [
                StreamRecording(source, stream_link, writer, event.stamp_ns, settings.patience_s, say)
                for source, stream_link, event in opened
            ]
            recording.run(link, stop, show)
        except CandataError as error:
            failure = error
        finally:
            unwritten = recording.close()
    failure = failure or unwritten
    return RecordingReport(recording.facts(address.place, out, failure), failure)


class _Recording:
    """A recording under way."""

    def __init__(
        self,
        device: Device,
        meta: LogMeta,
        writer: LogWriter,
        settings: RecorderSettings,
        opened_ns: int,
        say: Callable[[str], None],
        session: RunningSession | None,
    ) -> None:
        self._device, self._meta, self._writer, self._settings = device, meta, writer, settings
        self._say, self._opened_ns = say, opened_ns
        self._tally = RecorderTally(meta)
        self._framer = device.framer()
        self._tally.use(self._framer)
        self._calibration: Calibration | None = None
        self._window: list[States] | None = [] if settings.calibrate_s > 0 else None
        self._window_start_ns: int | None = None
        self._resting_ns = opened_ns  # since when the hand could be calibrated
        self._newest = np.zeros((len(meta.fingertip_names), 3))
        self._contact = np.zeros(len(meta.fingertip_names), bool)
        self._session, self._drift = session, DriftWindow(settings.calibrate_s)
        if session is not None:
            session.open(writer)
        self._unplugged = False
        self._watch = LinkWatch(settings, meta, opened_ns)
        self._due = dict.fromkeys(("flush", "statistics", "show", "space"), opened_ns)
        self.ended = "failed"
        self.streams: Sequence[StreamRecording] = ()
        self._end_stamp_ns = opened_ns

    def run(self, link: ReaderLink, stop: Callable[[], bool], show: Callable[[RecorderView], None]) -> None:
        """Record until `stop` says so or the time is up; raises CandataError for what ends it badly."""
        while True:
            now_ns, end_ns = time.monotonic_ns(), self._end_ns()
            is_done = self._session is not None and self._session.is_done
            if stop() or now_ns >= end_ns or is_done:
                self.ended = "duration" if now_ns >= end_ns else "episodes" if is_done else "stopped"
                self._take_last(link, now_ns)
                self._check_drift(link, show)
                return
            self._receive(link, show)
            if link.ended:
                self.ended = "replayed"
                self._take_last(link, now_ns)
                return

    def close(self) -> CandataError | None:
        """Write the last statistics and the end of the file; return the error of the disk, if there was one."""
        self._end_stamp_ns = time.monotonic_ns()
        try:
            if not self._writer.failed:
                self._statistics(self._end_stamp_ns)
            self._writer.close()
        except SetupError as error:
            return error
        return None

    def facts(self, port: str, out: Path, failure: CandataError | None) -> dict[str, Any]:
        """Return the report as plain data."""
        tally = self._tally
        with out.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        return {
            "log": str(out),
            "device": self._meta.device,
            "port": port,
            "ended": "failed" if failure else self.ended,
            "problem": failure.problem if failure else None,
            **tally.facts(port),
            "calibrated": self._calibration is not None,
            **(self._session.facts() if self._session is not None else {}),
            "bytes": out.stat().st_size,
            "sha256": sha256,
            "polled": self._settings.poll_rad is not None,
            "streams": {stream.source.name: stream.facts(self._end_stamp_ns) for stream in self.streams},
        }

    def _end_ns(self) -> float:
        """Return when the time is up: it is counted from the first state to calibrate with, once there is one."""
        if self._settings.duration_s is None:
            return float("inf")
        return self._resting_ns + 1e9 * (self._settings.duration_s + self._settings.calibrate_s)

    def _take_last(self, link: ReaderLink, end_ns: int) -> None:
        """Take what the reader had read by `end_ns`, and end the episode under way."""
        while events := link.receive(0.05):
            self._take([event for event in events if event.stamp_ns <= end_ns])
            if events[-1].stamp_ns > end_ns:
                break
        for stream in self.streams:
            stream.take([event for event in stream.link.receive(0.0) if event.stamp_ns <= end_ns])
            if stream.is_waiting:
                raise stream.never_heard(end_ns)
        if not self._tally.frames["state"]:
            raise no_state(self._tally, self._meta)
        if self._session is not None:
            self._session.stopped(end_ns)

    def _check_drift(self, link: ReaderLink, show: Callable[[RecorderView], None]) -> None:
        """Measure how far the forces of a session drifted, once the hand rests; a second Ctrl-C leaves it out."""
        is_played = link.address.link == "log"
        if self._session is None or self._calibration is None or self._unplugged or is_played:
            return
        self._say("the session is over; leave the hand at rest and untouched: the forces are checked for drift")
        self._drift.open(time.monotonic_ns())
        while (drift := self._drift.result(self._calibration, self._meta, self._settings.limits)) is None:
            self._receive(link, show)
        self._session.drifted(time.monotonic_ns(), drift)
        self._say(drift_text(drift))

    def _receive(self, link: ReaderLink, show: Callable[[RecorderView], None]) -> None:
        """Take what has come on all links, and do what is due; a played log may end."""
        wait_for_events([link, *(stream.link for stream in self.streams)], _WAIT_S)
        self._take(link.receive(0.0))
        for stream in self.streams:
            stream.take(stream.link.receive(0.0))
        self._tick(show)
        if link.ended and link.address.link != "log":
            raise reader_died(self._meta.port)

    def _statistics(self, now_ns: int) -> None:
        streams = {stream.source.name: stream.facts(now_ns) for stream in self.streams}
        self._writer.statistics(now_ns, {**self._tally.statistics(now_ns), "streams": streams})

    def _take(self, events: Sequence[Event]) -> None:
        for event in events:
            if event.kind == "data":
                self._bytes(event)
            elif event.kind == "lost":
                self._unplugged = True
                self._frames(self._framer.finish())
                self._tally.note_lost(event.stamp_ns)
                self._say(f"the port is gone; waiting {self._settings.reconnect_s:g} s for it to come back")
            elif event.kind == "back":
                self._go_on_replugged(event)
            elif event.kind == "failed":
                raise port_error(Address("serial", self._meta.port), event.facts)
            elif event.kind == "asked":
                self._asked(event)

    def _go_on_replugged(self, event: Event) -> None:
        self._unplugged = False
        self._tally.note_back(event.stamp_ns)
        self._framer = self._device.framer()
        self._tally.use(self._framer)
        self._watch.plugged(event.stamp_ns)
        if self._window is not None:
            self._window, self._window_start_ns, self._resting_ns = [], None, event.stamp_ns
        self._say("the port is back; the recording goes on in the same log")

    def _bytes(self, event: Event) -> None:
        self._writer.wire(event.data, event.stamp_ns)
        self._tally.read(event.data, event.stamp_ns)
        frames = self._framer.feed(event.data, event.stamp_ns)
        self._watch.heard(event.stamp_ns, bool(frames))
        self._frames(frames)

    def _asked(self, event: Event) -> None:
        """Log a set-point that was written to the hand; its echo on the wire is none of its own."""
        self._tally.frame(Frame("command", b"", event.stamp_ns))
        self._writer.commands([event.stamp_ns], Commands(np.array([self._settings.poll_rad], np.float64)))

    def _frames(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            if frame.kind != "command" or self._settings.poll_rad is None:
                self._tally.frame(frame)
        commands = [frame for frame in frames if frame.kind == "command"]
        if commands and self._settings.poll_rad is None:
            positions = self._device.commands([frame.data for frame in commands])
            self._writer.commands([frame.stamp_ns for frame in commands], positions)
        states = [frame for frame in frames if frame.kind == "state"]
        if states:
            self._states([frame.stamp_ns for frame in states], [frame.data for frame in states])

    def _states(self, stamps_ns: list[int], data: list[bytes]) -> None:
        states = self._device.states(data)
        self._writer.states(stamps_ns, states)
        self._tally.states(states)
        bias = self._calibration.force_bias_counts if self._calibration else 0.0
        force_N = (states.force_counts - bias) * self._meta.newton_per_count
        self._newest = force_N[-1]
        if self._window is None:
            self._touch(stamps_ns, force_N)
            self._drift.add(stamps_ns, states)
            return
        if self._window_start_ns is None:
            self._window_start_ns = self._resting_ns = stamps_ns[0]
        self._window.append(states)
        if stamps_ns[-1] - self._window_start_ns >= 1e9 * self._settings.calibrate_s:
            self._calibrate(join_states(self._window), stamps_ns[-1])

    def _touch(self, stamps_ns: list[int], force_N: NDArray) -> None:
        rule = self._settings.contact
        flags = fingertip_contact(force_N, rule.threshold_n, rule.release_n, self._contact)
        self._contact = flags[-1]
        if self._session is not None and not self._drift.is_open:
            self._session.begin(stamps_ns[0])
            self._session.touched(stamps_ns, flags)

    def _calibrate(self, states: States, end_ns: int) -> None:
        settings = self._settings
        resting = resting_hand(states, settings.calibrate_s, self._meta, settings.limits)
        self._calibration = replace(resting, end_ns=self._writer.unix_ns(end_ns))
        self._window = None
        self._writer.calibration(self._calibration)
        self._say(f"calibrated over {self._calibration.rows} states")

    def _tick(self, show: Callable[[RecorderView], None]) -> None:
        """Do what is due: flush, statistics with fsync, the view, the checks."""
        now_ns = time.monotonic_ns()
        if self._session is not None:
            self._session.tick(now_ns)
        if self._is_due("flush", now_ns, _FLUSH_S):
            self._writer.flush()
        if self._is_due("statistics", now_ns, _STATISTICS_S):
            self._statistics(now_ns)
            self._writer.sync_behind()
        if self._is_due("space", now_ns, _SPACE_S):
            check_space(self._writer.path, self._settings.reserve_bytes)
            if not self._unplugged:
                in_session = self._session is not None and not self._drift.is_open
                self._watch.check(now_ns, self._tally, self._say, in_session)
            if note := self._tally.bursts_note(self._meta.port):
                self._say(note)
            for stream in self.streams:
                stream.check(now_ns)
        if self._is_due("show", now_ns, _SHOW_S):
            show(self._view(now_ns))

    def _is_due(self, task: str, now_ns: int, period_s: float) -> bool:
        if now_ns < self._due[task]:
            return False
        self._due[task] = now_ns + int(1e9 * period_s)
        return True

    def _view(self, now_ns: int) -> RecorderView:
        tally = self._tally
        phase: Phase = "recording"
        if self._unplugged:
            phase = "unplugged"
        elif not tally.frames["state"]:
            phase = "waiting"
        elif self._window is not None:
            phase = "calibrating"
        elif self._drift.is_open:
            phase = "checking"
        return RecorderView(
            phase=phase,
            elapsed_s=(now_ns - self._opened_ns) / 1e9,
            rate_hz=tally.recent_rate_hz(now_ns),
            nominal_hz=self._meta.rate_hz,
            force_N=self._newest,
            contact=self._contact,
            fingertip_names=self._meta.fingertip_names,
            frames=dict(tally.frames),
            losses=tally.losses(),
            saturated=tally.saturated(),
            gaps=tally.gaps,
            size_bytes=self._writer.size,
            session=None if self._session is None else self._session.view(now_ns),
            streams=tuple(stream.view(now_ns) for stream in self.streams),
        )
