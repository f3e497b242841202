"""A stream beside the hand while it is recorded: bytes and values go to the log, rate, gaps and losses are counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from typing import Any

import numpy as np

from candata.errors import SetupError, Where
from candata.record.addresses import StreamSource
from candata.record.devices import Frame, Framer
from candata.record.log_streams import StreamWriter, TopicWriter
from candata.record.reader_link import Event, ReaderLink
from candata.record.recorder_tally import Beat
from candata.record.recorder_values import StreamPhase, StreamView

#: A slow stream may be silent for so many of its periods before it is said, however short the patience. Chosen.
SILENT_PERIODS = 10.0
#: What a framer counts that is no loss.
_NO_LOSSES = ("frames", "bytes")


class StreamRecording:
    """One stream under way; feed it the events of its reader."""

    def __init__(
        self,
        source: StreamSource,
        link: ReaderLink,
        log: TopicWriter,
        opened_ns: int,
        patience_s: float,
        say: Callable[[str], None],
    ) -> None:
        """Begin in the log; `say` is given notes for people, `patience_s` as in `RecorderSettings`."""
        self.source, self.link = source, link
        self._device, self._writer, self._say = source.device, StreamWriter(log, source), say
        self._patience_s = max(patience_s, SILENT_PERIODS / source.device.rate_hz)
        self._beat = Beat(source.device.rate_hz)
        self._framer: Framer = source.device.framer()
        self._past_losses: dict[str, int] = {}
        self._opened_ns = self._heard_ns = opened_ns
        self._first_byte_ns: int | None = None
        self._phase: StreamPhase = "waiting"
        self._unplugs, self._clock_steps, self._device_ns = 0, 0, -(2**62)
        self._findings: list[str] = []

    def take(self, events: Sequence[Event]) -> None:
        """Write what the reader passed on.

        Raises
        ------
        SetupError
            When the disk takes no more.
        DataError
            When the device's decoder disagrees with what it declares.
        """
        for event in events:
            if event.kind == "data":
                self._bytes(event)
            elif event.kind == "lost":
                self._phase, self._unplugs = "unplugged", self._unplugs + 1
                self._frames(self._framer.finish())
                self._note("the connection is gone; waiting for it to come back")
            elif event.kind == "back":
                self._past_losses, self._framer = self._losses(), self._device.framer()
                self._phase, self._heard_ns = "recording", event.stamp_ns
                self._note("it is back; the recording goes on")
            elif event.kind == "failed":
                self._phase = "unplugged"
                self._note("it did not come back; the recording goes on without it")

    def check(self, now_ns: int) -> None:
        """Say what is new: silence, findings.

        Raises
        ------
        SetupError
            When the stream was never heard, or never gave a good frame.
        """
        findings = self._device.findings(self._framer)
        for finding in (text for text in findings if text not in self._findings):
            self._findings.append(finding)
            self._note(finding)
        if self._phase == "waiting":
            since_ns = self._opened_ns if self._first_byte_ns is None else self._first_byte_ns
            if now_ns - since_ns > 1e9 * self._patience_s:
                raise self.never_heard(now_ns)
        elif self._phase == "recording" and now_ns - self._heard_ns > 1e9 * self._patience_s:
            self._phase = "silent"
            self._note(f"no good frame for {self._patience_s:g} s: a gap in the recording")

    def never_heard(self, now_ns: int) -> SetupError:
        """Return the error of a stream that gave no good frame until `now_ns`."""
        name, place = self.source.name, Where(path=str(self.source.address))
        if self._first_byte_ns is None:
            return SetupError(
                f"the stream {name} was never heard",
                expected=f"{self.source.device_name} at about {self._device.rate_hz:g} Hz",
                found=f"no byte in {(now_ns - self._opened_ns) * 1e-9:.1f} s",
                where=place,
                fix="switch it on, check its address, or leave it out",
            )
        losses = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in self._losses().items() if count)
        return SetupError(
            f"the stream {name} gives bytes but no good frame: another device, version, length or baud rate",
            expected=f"frames of {self.source.device_name}",
            found="; ".join([losses or "not one whole frame", *self._findings]),
            where=place,
            fix="check what is at this address, its settings and its baud rate",
        )

    @property
    def is_waiting(self) -> bool:
        """Whether no good frame has come yet."""
        return self._phase == "waiting"

    def view(self, now_ns: int) -> StreamView:
        """Return what can be seen of it now."""
        return StreamView(
            name=self.source.name,
            phase=self._phase,
            rate_hz=self._beat.recent_rate_hz(now_ns),
            nominal_hz=self._device.rate_hz,
            frames=self._beat.count,
            gaps=self._beat.gaps,
            losses=self._losses(),
            silent_s=(now_ns - self._heard_ns) / 1e9,
        )

    def facts(self, end_ns: int) -> dict[str, Any]:
        """Return the counts as plain data; `silent_s` is how long the last good frame lay back at `end_ns`."""
        return {
            "device": self.source.device_name,
            "address": str(self.source.address),
            "frames": self._beat.count,
            "duration_s": round(self._beat.duration_s, 6),
            "rate_hz": round(self._beat.rate_hz, 3),
            "gaps": self._beat.gaps,
            "longest_gap_s": round(self._beat.longest_gap_s, 6),
            "silent_s": round((end_ns - self._heard_ns) / 1e9, 3),
            "losses": self._losses(),
            "unplugs": self._unplugs,
            "clock_steps_back": self._clock_steps,
            "findings": list(self._findings),
        }

    def _bytes(self, event: Event) -> None:
        if self._first_byte_ns is None:
            self._first_byte_ns = event.stamp_ns
        self._writer.wire(event.data, event.stamp_ns)
        self._frames(self._framer.feed(event.data, event.stamp_ns))

    def _frames(self, frames: Sequence[Frame]) -> None:
        states = [frame for frame in frames if frame.kind == "state"]
        if not states:
            return
        stamps_ns = [frame.stamp_ns for frame in states]
        for stamp_ns in stamps_ns:
            self._beat.frame_at(stamp_ns)
        if self._phase in ("waiting", "silent"):
            self._phase = "recording"
        self._heard_ns = max(self._heard_ns, stamps_ns[-1])
        for first, stop in _equal_runs([self._device.held_signals(frame.data) for frame in states]):
            part = [frame.data for frame in states[first:stop]]
            values = self._device.values(part)
            self._writer.values(stamps_ns[first:stop], self._device.held_signals(part[0]), values)
            if self._device.device_time in values:
                self._clock(values[self._device.device_time])

    def _clock(self, device_ns: np.ndarray) -> None:
        """Count and say steps back of the device's clock; its readings stand in the log as they came."""
        readings = [self._device_ns, *(int(value) for value in device_ns if np.isfinite(value))]
        for before, after in pairwise(readings):
            if after < before:
                self._clock_steps += 1
                if self._clock_steps == 1:
                    self._note(f"its clock stepped back by {(before - after) * 1e-9:.3f} s; stamps of arrival hold")
        self._device_ns = readings[-1]

    def _losses(self) -> dict[str, int]:
        counts = {kind: int(count) for kind, count in self._framer.counts.items() if kind not in _NO_LOSSES}
        return {kind: count + self._past_losses.get(kind, 0) for kind, count in counts.items()}

    def _note(self, text: str) -> None:
        self._say(f"{self.source.name}: {text}")


@contextmanager
def open_streams(
    sources: Sequence[StreamSource], reconnect_s: float
) -> Iterator[list[tuple[StreamSource, ReaderLink, Event]]]:
    """Yield every stream with its running reader and the event that it opened; leaving ends the readers.

    Raises
    ------
    SetupError
        When a port or address cannot be opened.
    """
    with ExitStack() as stack:
        links = [stack.enter_context(ReaderLink(source.address, reconnect_s)) for source in sources]
        yield [(source, link, link.opened()) for source, link in zip(sources, links, strict=True)]


def _equal_runs(items: Sequence[object]) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each run of equal neighbours."""
    begin = 0
    for at in range(1, len(items) + 1):
        if at == len(items) or items[at] != items[begin]:
            yield begin, at
            begin = at
