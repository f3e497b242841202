"""What ends a recording badly: a full disk, a hand that gives no state or falls silent."""

from __future__ import annotations

import shutil
from pathlib import Path

from candata.errors import SetupError, Where
from candata.record.logs import LogMeta
from candata.record.recorder_tally import RecorderTally


def check_space(out: Path, reserve_bytes: int) -> None:
    """Refuse a disk with less free space than the reserve.

    Raises
    ------
    SetupError
        When the disk is too full.
    """
    folder = next(parent for parent in out.absolute().parents if parent.is_dir())
    free = shutil.disk_usage(folder).free
    if free < reserve_bytes:
        raise SetupError(
            "the disk is nearly full",
            expected=f"{reserve_bytes / 1e6:.0f} MB free",
            found=f"{free / 1e6:.0f} MB",
            where=Where(path=str(out)),
            fix="make room, choose another --out, or lower --reserve-mb",
        )


def no_state(tally: RecorderTally, meta: LogMeta) -> SetupError:
    """Return the error of a hand that gave no state."""
    place = Where(path=meta.port)
    if not tally.bytes:
        return SetupError(
            "the port gave no byte", where=place, fix="switch the hand on, start the program that drives it"
        )
    if tally.frames["command"]:
        return SetupError(
            "the hand gave no state",
            found=f"{tally.frames['command']} requests without a reply",
            where=place,
            fix="switch the hand on; check that the receiver hears both directions of the pair",
        )
    return SetupError(
        "the port gives bytes but no good frame: the baud rate is wrong, or it is another device",
        expected=f"frames of {meta.device} at {meta.baud} baud",
        found=f"{tally.bytes} bytes without one",
        where=place,
        fix="check --baud, --device and the wiring",
    )


def silent_session(tally: RecorderTally, meta: LogMeta, silence_s: float) -> SetupError:
    """Return the error of a hand that fell silent in a session."""
    return SetupError(
        "the hand fell silent, and the session ends",
        expected=f"a state within {silence_s:g} s",
        found=f"{tally.frames['state']} states before, none since",
        where=Where(path=meta.port),
        fix="see whether the hand is on and its program runs; the log is whole up to here; --silence waits longer",
    )


def reader_died(port: str) -> SetupError:
    """Return that the process that reads a port is gone."""
    return SetupError("the reader process died", where=Where(path=port), fix="the log is whole up to here; start again")
