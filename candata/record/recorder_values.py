"""What goes into a recorder and what comes out: settings, the view of a running one, the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from candata.errors import CandataError
from candata.record.calibration import CalibrationLimits
from candata.record.session_run import SessionView
from candata.schema.episode import ContactRule

Phase = Literal["waiting", "calibrating", "recording", "unplugged", "checking"]
StreamPhase = Literal["waiting", "recording", "silent", "unplugged"]
#: Silence of a hand that ends a session, unless another is given [s]. Chosen: longer than it takes to put the object
#: back and start the hand's program again, and short enough that nobody waits in vain for a night.
SILENCE_S = 60.0


@dataclass(frozen=True)
class RecorderSettings:
    """How to record.

    Attributes
    ----------
    duration_s : float or None
        How long to record after the calibration [s]; None: until told to stop.
    calibrate_s : float
        Window of the calibration [s]; 0: none.
    limits : Limits
        What counts as a resting, untouched hand.
    reconnect_s : float
        How long to wait for a port that was unplugged [s].
    reserve_bytes : int
        Free space on the disk at which the recording ends.
    patience_s : float
        How long a port may be silent, or give bytes without one good frame, before it is said [s].
    silence_s : float
        How long a hand on a plugged port may give no state before its session ends [s].
    contact : ContactRule
        When a fingertip is shown as touching, and an episode begins by touch; its scale is not used.
    poll_rad : tuple of float, optional
        Set-point of the joints that is written to the hand, again and again; None: nothing is ever written.
    """

    duration_s: float | None = None
    calibrate_s: float = 3.0
    limits: CalibrationLimits = field(default_factory=CalibrationLimits)
    reconnect_s: float = 10.0
    reserve_bytes: int = 200_000_000
    patience_s: float = 2.0
    silence_s: float = SILENCE_S
    contact: ContactRule = field(default_factory=ContactRule)
    poll_rad: tuple[float, ...] | None = None


@dataclass(frozen=True)
class StreamView:
    """What can be seen of a stream beside the hand.

    Attributes
    ----------
    name, phase : str
        Its name in the log; `waiting` (no good frame yet), `recording`, `silent` or `unplugged`.
    rate_hz, nominal_hz : float
        Frames in the last second, and what the device gives when all is well.
    frames, gaps : int
        Frames so far; intervals of more than 1.5 periods.
    losses : dict
        What was lost, by kind.
    silent_s : float
        Since the last good frame [s].
    """

    name: str
    phase: StreamPhase
    rate_hz: float
    nominal_hz: float
    frames: int
    gaps: int
    losses: dict[str, int]
    silent_s: float


@dataclass(frozen=True, eq=False)
class RecorderView:
    """What can be seen of a recording while it runs.

    Attributes
    ----------
    phase : str
        `waiting` (no good frame yet), `calibrating`, `recording`, `unplugged`, or `checking` (of drift, at the end).
    elapsed_s : float
        Since the port was opened [s].
    rate_hz, nominal_hz : float
        States in the last second, and what the device gives when all is well.
    force_N : (F, 3) float64 [N]
        Newest force of each fingertip, less the bias where calibrated.
    contact : (F,) bool
        Whether each fingertip touches something, by the rule of the settings.
    fingertip_names : tuple of str
        In the order of `force_N`.
    frames, losses, saturated : dict
        Counts so far, by kind.
    gaps, size_bytes : int
        Intervals of more than 1.5 periods; size of the log.
    session : SessionView or None
        Episodes and marks; None where no session is recorded.
    streams : tuple of StreamView
        What is recorded beside the hand.
    """

    phase: Phase
    elapsed_s: float
    rate_hz: float
    nominal_hz: float
    force_N: NDArray[np.float64]
    contact: NDArray[np.bool_]
    fingertip_names: tuple[str, ...]
    frames: dict[str, int]
    losses: dict[str, int]
    saturated: dict[str, int]
    gaps: int
    size_bytes: int
    session: SessionView | None = None
    streams: tuple[StreamView, ...] = ()


@dataclass(frozen=True)
class RecordingReport:
    """What a recording came to; `failure` is the error that ended it, if one did."""

    facts: dict[str, Any]
    failure: CandataError | None
