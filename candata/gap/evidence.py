"""What a report draws beside the record: values only, no files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeatMap:
    """Excess of the recorded loss over the floor, channel element by phase.

    Attributes
    ----------
    rows : tuple of str
        `channel` or `channel element` labels.
    phases : tuple of str
        Column labels.
    ratio : (R, P) float64
        Loss over floor; 1 is the floor, NaN where there is no data.
    p : (R, P) float64
        Family-wise p-value over episodes; NaN where there is no data.
    """

    rows: tuple[str, ...]
    phases: tuple[str, ...]
    ratio: Array
    p: Array


@dataclass(frozen=True)
class Trace:
    """One element of one channel in the example episode: recorded, nominal and repaired, `(T,)` each."""

    channel: str
    element: str
    unit: str
    real: Array
    before: Array
    after: Array | None


@dataclass(frozen=True)
class Example:
    """One held-out episode before and after the repair.

    Attributes
    ----------
    episode : str
        Its id.
    time_s : (T,) float64 [s]
    traces : tuple of Trace
        The most telling elements, worst first.
    qpos_real, qpos_before, qpos_after : (T, nq) float64
        Model positions for the filmstrip: recorded, nominal simulation, repaired simulation.
    """

    episode: str
    time_s: Array
    traces: tuple[Trace, ...]
    qpos_real: Array
    qpos_before: Array
    qpos_after: Array | None


@dataclass(frozen=True)
class EpisodeLosses:
    """Floor-normalised held-out discrepancy of each episode, `(E,)` each, beside its id."""

    ids: tuple[str, ...]
    before: Array
    after: Array
    floor_low: Array
    floor_high: Array


@dataclass(frozen=True)
class Evidence:
    """Everything the figures need."""

    heat: HeatMap | None = None
    example: Example | None = None
    losses: EpisodeLosses | None = None
