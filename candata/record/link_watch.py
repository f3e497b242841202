"""What a hand's line lacks while it is recorded: bytes, good frames, states. It is said; a session may end of it."""

from __future__ import annotations

from collections.abc import Callable

from candata.record.logs import LogMeta
from candata.record.recorder_errors import no_state, silent_session
from candata.record.recorder_tally import RecorderTally
from candata.record.recorder_values import RecorderSettings


class LinkWatch:
    """Tells of silence and of bytes without a good frame, once each time it begins; a silent session ends."""

    def __init__(self, settings: RecorderSettings, meta: LogMeta, opened_ns: int) -> None:
        """Begin with a port that was opened at `opened_ns`."""
        self._settings, self._meta = settings, meta
        # When bytes came last, since when they have come without a good frame among them, and what was said of it.
        self._heard_ns, self._bad_since_ns, self._silent, self._bad = opened_ns, 0, False, False
        self._plugged_ns = opened_ns

    def heard(self, stamp_ns: int, has_frames: bool) -> None:
        """Take that bytes came, and whether a good frame was whole with them."""
        if stamp_ns - self._heard_ns > 1e9 * self._settings.patience_s:
            self._bad_since_ns = 0  # a glitch before a silence says nothing of what comes now
        self._heard_ns, self._silent = stamp_ns, False
        if has_frames:
            self._bad_since_ns, self._bad = 0, False
        else:
            self._bad_since_ns = self._bad_since_ns or stamp_ns

    def plugged(self, stamp_ns: int) -> None:
        """Take that the port came back."""
        self._heard_ns = self._plugged_ns = stamp_ns
        self._bad_since_ns = 0

    def check(self, now_ns: int, tally: RecorderTally, say: Callable[[str], None], in_session: bool) -> None:
        """Say what is wrong with a port that is plugged in; only a session under way ends of silence.

        Raises
        ------
        SetupError
            When bytes came and never a good frame, or a session had no state for `silence_s`.
        """
        patience_s, silence_s = self._settings.patience_s, self._settings.silence_s
        if self._bad_since_ns and self._heard_ns - self._bad_since_ns > 1e9 * patience_s:
            if not sum(tally.frames.values()):
                raise no_state(tally, self._meta)
            if not self._bad:
                self._bad = True
                say(f"bytes but no good frame for {patience_s:g} s: check the wiring and what else is on it")
        if not self._silent and now_ns - self._heard_ns > 1e9 * patience_s:
            self._silent = True
            say(f"no bytes for {patience_s:g} s: is the hand on, and does its program ask it for its state?")
        if in_session and now_ns - max(self._plugged_ns, tally.last_ns or 0) > 1e9 * silence_s:
            raise silent_session(tally, self._meta, silence_s) if tally.frames["state"] else no_state(tally, self._meta)
