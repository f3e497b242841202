"""What a page shows of a dataset: its summary, its distributions and a few whole episodes, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from candata.datasets.dataset import Dataset
from candata.datasets.elements import Element, columns, elements
from candata.datasets.histograms import Distribution, Histogram
from candata.datasets.summary import ANY_FINGERTIP, Summary, summarise, touches
from candata.schema.channels import CHANNELS, DENSE_CHANNELS, VALID_SUFFIX
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
class ExampleEpisode:
    """An episode to show whole, and why it was chosen; dense channels are left out."""

    reason: str
    episode: Episode


@dataclass(frozen=True)
class Survey:
    """What one pass found.

    Attributes
    ----------
    summary : Summary
        Counts, ranges, contact, lineage.
    distributions : tuple of ChannelDistribution
        By channel in the schema's order; of `time_ns` the steps from row to row, in ms.
    examples : tuple of ExampleEpisode
        The first episode by id, the longest, and the one with the largest share of rows in contact.
    sets_left_out : int
        Sets of elements without histograms, as there were too many different ones.
    """

    summary: Summary
    distributions: tuple[ChannelDistribution, ...]
    examples: tuple[ExampleEpisode, ...]
    sets_left_out: int


def survey(dataset: Dataset, progress: Callable[[], None] = lambda: None, ids: Sequence[str] | None = None) -> Survey:
    """Return what a page shows of a version, or of some of its episodes.

    Parameters
    ----------
    dataset : Dataset
        Version to read, once.
    progress : callable
        Called after each episode.
    ids : sequence of str, optional
        Only these episodes.

    Raises
    ------
    UnknownNameError
        When an id is not in the version.
    DataError
        When a part is damaged; names the file.
    """
    bins, picker = _Bins(), _ExamplePicker()

    def watch(episode: Episode) -> None:
        bins.add(episode)
        picker.add(episode)

    summary = summarise(dataset, progress, ids, watch)
    return Survey(summary, bins.distributions(), picker.examples(), len(bins.left_out))


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


@dataclass
class _ExamplePicker:
    """The episodes that are best by each rule so far; ties go to the first."""

    best_by_rule: dict[str, tuple[float, Episode]] = field(default_factory=dict)

    def add(self, episode: Episode) -> None:
        """Take in one episode."""
        touch = touches(episode).get(ANY_FINGERTIP)
        scores = {"the first": 0.0, "the longest": float(episode.time_s[-1])}
        if touch is not None and touch.any():
            scores["the most contact"] = float(touch.mean())
        for rule, score in scores.items():
            if rule not in self.best_by_rule or score > self.best_by_rule[rule][0]:
                self.best_by_rule[rule] = (score, _light(episode))

    def examples(self) -> tuple[ExampleEpisode, ...]:
        """Return the chosen episodes, each once with all that it is."""
        reasons: dict[str, list[str]] = {}
        episodes = {episode.meta.id: episode for _, episode in self.best_by_rule.values()}
        for rule, (_, episode) in self.best_by_rule.items():
            reasons.setdefault(episode.meta.id, []).append(rule)
        return tuple(ExampleEpisode(" and ".join(rules), episodes[name]) for name, rules in reasons.items())


def _light(episode: Episode) -> Episode:
    """Return an episode without its dense channels, which are large and not drawn."""
    if not any(name.removesuffix(VALID_SUFFIX) in DENSE_CHANNELS for name in episode.arrays):
        return episode
    return Episode(
        episode.meta, {n: a for n, a in episode.arrays.items() if n.removesuffix(VALID_SUFFIX) not in DENSE_CHANNELS}
    )
