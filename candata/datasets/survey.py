"""What a page shows of a dataset: its summary, its distributions and a line about each episode, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from candata.datasets.dataset import Dataset
from candata.datasets.elements import Element, columns, elements
from candata.datasets.histograms import Distribution, Histogram
from candata.datasets.summary import ANY_FINGERTIP, Summary, summarise, touches
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode

#: Different sets of elements (other joints, other fingertips) of one channel that get histograms of their own.
MOST_SETS = 6


@dataclass(frozen=True)
class ChannelDistribution:
    """Distribution of one element of a channel; None where no value is valid."""

    channel: str
    element: Element
    distribution: Distribution | None


@dataclass(frozen=True)
class EpisodeFacts:
    """What the list of episodes says of one.

    Attributes
    ----------
    id, source : str
    scene, object, task, outcome : str or None
    rows : int
    duration_s : float
    contact_share : float or None
        Share of rows in which any fingertip touches; None where no channel says.
    invalid_share : float
        Share of rows in which any channel holds no value.
    """

    id: str
    source: str
    scene: str | None
    object: str | None
    task: str | None
    outcome: str | None
    rows: int
    duration_s: float
    contact_share: float | None
    invalid_share: float


@dataclass(frozen=True)
class Survey:
    """What one pass found.

    Attributes
    ----------
    summary : Summary
        Counts, ranges, contact, lineage.
    distributions : tuple of ChannelDistribution
        By channel in the schema's order; of `time_ns` the steps from row to row, in ms.
    episodes : tuple of EpisodeFacts
        In the order that they were read in.
    sets_left_out : int
        Sets of elements without histograms, as there were too many different ones.
    """

    summary: Summary
    distributions: tuple[ChannelDistribution, ...]
    episodes: tuple[EpisodeFacts, ...]
    sets_left_out: int


def survey(
    dataset: Dataset,
    progress: Callable[[], None] = lambda: None,
    ids: Sequence[str] | None = None,
    watch: Callable[[Episode], None] = lambda episode: None,
) -> Survey:
    """Return what a page shows of a version, or of some of its episodes.

    Parameters
    ----------
    dataset : Dataset
        Version to read, once.
    progress : callable
        Called after each episode.
    ids : sequence of str, optional
        Only these episodes.
    watch : callable
        Given each episode.

    Raises
    ------
    UnknownNameError
        When an id is not in the version.
    DataError
        When a part is damaged; names the file.
    """
    bins, facts = _Bins(), list[EpisodeFacts]()

    def add(episode: Episode) -> None:
        bins.add(episode)
        facts.append(_facts(episode))
        watch(episode)

    summary = summarise(dataset, progress, ids, add)
    return Survey(summary, bins.distributions(), tuple(facts), len(bins.left_out))


def _facts(episode: Episode) -> EpisodeFacts:
    """Return what the list says of an episode."""
    touch = touches(episode).get(ANY_FINGERTIP)
    invalid = np.zeros(len(episode), bool)
    for name, flags in episode.arrays.items():
        if name.endswith(VALID_SUFFIX):
            invalid |= ~flags
    meta = episode.meta
    return EpisodeFacts(
        *(meta.id, meta.source, meta.scene, meta.object, meta.task, meta.outcome),
        rows=len(episode),
        duration_s=float(episode.time_s[-1]),
        contact_share=None if touch is None else float(touch.mean()),
        invalid_share=float(invalid.mean()),
    )


_Key = tuple[str, tuple[Element, ...]]


@dataclass
class _Bins:
    """Histograms of every channel but flags, by the names of its elements."""

    of: dict[_Key, Histogram] = field(default_factory=dict)
    left_out: set[_Key] = field(default_factory=set)

    def add(self, episode: Episode) -> None:
        """Take in one episode."""
        self._add(("time_ns", (Element("step from row to row", "ms"),)), np.diff(episode["time_ns"])[:, None] * 1e-6)
        for name in episode.arrays:
            if name == "time_ns" or name.endswith(VALID_SUFFIX) or CHANNELS[name].dtype == "bool":
                continue
            values, rows = columns(episode, name)
            valid_values = values[np.repeat(episode.valid(name), rows)]
            self._add((name, elements(episode.meta, name, episode[name].shape[1:])), valid_values)

    def _add(self, key: _Key, values: np.ndarray) -> None:
        """Take in one channel of one episode."""
        if key not in self.of:
            if sum(channel == key[0] for channel, _ in self.of) >= MOST_SETS:
                self.left_out.add(key)
                return
            self.of[key] = Histogram(len(key[1]))
        self.of[key].add(values)

    def distributions(self) -> tuple[ChannelDistribution, ...]:
        """Return what was counted."""
        order = list(CHANNELS)
        return tuple(
            ChannelDistribution(key[0], element, self.of[key].distribution(i))
            for key in sorted(self.of, key=lambda key: order.index(key[0]))
            for i, element in enumerate(key[1])
        )
