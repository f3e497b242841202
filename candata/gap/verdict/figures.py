"""What a report draws beside the record: values only, no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.gap.measure.symptoms import HeatMap

Array = NDArray[np.float64]


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
class Course:
    """One element over one episode: its index among the held-out episodes and `(T,)` values, SI."""

    episode: int
    time_s: Array
    real: Array
    before: Array
    after: Array | None


@dataclass(frozen=True)
class Element:
    """One element of one channel in every held-out episode.

    Attributes
    ----------
    channel, element, unit : str
        As in the layout of the residual.
    before, after, null : (E,) float64
        Mean size of the residual [unit]: nominal, repaired (None without a repair), and null replays; NaN where it
        was not recorded.
    courses : tuple of Course
        Some of the episodes, the worst first.
    """

    channel: str
    element: str
    unit: str
    before: Array
    after: Array | None
    null: Array
    courses: tuple[Course, ...]

    @property
    def label(self) -> str:
        """Channel and element, as the rows of the heat map are called."""
        return f"{self.channel} {self.element}".strip()


@dataclass(frozen=True)
class Elements:
    """Ids of the held-out episodes, and every element in them."""

    ids: tuple[str, ...]
    of: tuple[Element, ...]


@dataclass(frozen=True)
class Collinearity:
    """Candidates by label, best first, and the cosines `(N, N)` between what they change in the readings."""

    labels: tuple[str, ...]
    matrix: Array


@dataclass(frozen=True)
class Range:
    """Where a parameter was searched, and the value at which its effect vanishes (None: it replaces another)."""

    low: float
    high: float
    identity: float | None


@dataclass(frozen=True)
class Evidence:
    """Everything the figures need.

    `ranges` holds the ranges of the named effects' numbers by (effect, element, parameter).
    """

    heat: HeatMap | None = None
    example: Example | None = None
    losses: EpisodeLosses | None = None
    elements: Elements | None = None
    collinearity: Collinearity | None = None
    ranges: Mapping[tuple[str, str | None, str], Range] = field(default_factory=dict)
