"""Two datasets side by side: the same statistics of both, how far they lie apart, and how far luck alone would do."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.datasets.dataset import Dataset
from candata.datasets.distance import DEALS, Bars, Pool, spread_of
from candata.datasets.measures import Statistic, measure
from candata.errors import DataError
from candata.schema.channels import DENSE_CHANNELS, VALID_SUFFIX
from candata.schema.record import ResultRecord

#: Episodes of each dataset that are compared; more are drawn evenly along the sorted ids.
MOST_EPISODES = 400
#: Fewer ways to deal the episodes to two sides than this, and chance cannot be told from difference.
LEAST_WAYS = 40
#: Chance that any row of a comparison of two like datasets is called different.
LEVEL = 0.05


class Side(ResultRecord):
    """One of the two datasets, called `label`; `compared` of its `episodes` were read."""

    label: str
    name: str
    digest: str
    version: int
    episodes: int
    compared: int
    rows: int
    duration_s: float
    sources: dict[str, int]
    scenes: dict[str, int]
    rates_hz: tuple[float, ...]


class Spread(ResultRecord):
    """Median and the middle 90 % of the samples of one side; `episodes` had any."""

    samples: int
    episodes: int
    median: float
    low: float
    high: float


class ComparisonRow(ResultRecord):
    """One statistic of one element on both sides.

    `distance` is Wasserstein's: how far, on average, values must be moved to turn one distribution into the other, in
    the row's unit; `spreads` the same in standard deviations of both together. `luck` is the distance that 95 % of
    random deals of the same episodes stay below. `differs`: beyond luck, with all rows in view; null where there are
    too few episodes to say.
    """

    group: str
    statistic: str
    element: str
    unit: str
    this: Spread
    against: Spread
    distance: float
    spreads: float | None
    luck: float | None
    differs: bool | None


class DatasetComparison(ResultRecord):
    """What `candata inspect A --against B` prints; rows that differ first, then by `spreads`, the largest first.

    In units, `joint` stands for rad or m. `unmatched` says what only one side has, `notes` what else to know.
    """

    this: Side
    against: Side
    step_s: float
    rows: tuple[ComparisonRow, ...]
    unmatched: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ComparisonResult:
    """A comparison, and the distributions behind its rows, in the same order."""

    comparison: DatasetComparison
    bars: tuple[Bars, ...]


def episodes_compared(dataset: Dataset) -> int:
    """Return how many episodes of a dataset a comparison reads."""
    return min(len(dataset), MOST_EPISODES)


def compare(dataset: Dataset, reference: Dataset, progress: Callable[[], None] = lambda: None) -> ComparisonResult:
    """Return the statistics of two datasets side by side.

    Positions are differenced over the longer of the two control periods, so that both sides see the same
    bandwidth. Whether a row differs is judged by dealing the episodes of both sides anew, all rows at once.

    Parameters
    ----------
    dataset, reference : Dataset
        At most 400 episodes of each are read.
    progress : callable
        Called after each episode.

    Raises
    ------
    DataError
        When a part is damaged, or the two have no statistic in common.
    """
    sides = (_compared_ids(dataset), _compared_ids(reference))
    step_s = max(1 / _least_rate(d, ids) for d, ids in zip((dataset, reference), sides, strict=True))
    readers = [
        _Reader(d, step_s, label) for d, label in zip((dataset, reference), _labels(dataset, reference), strict=True)
    ]
    for reader, ids in zip(readers, sides, strict=True):
        reader.read(ids, progress)
    shared_keys = sorted(set(readers[0].found) & set(readers[1].found))
    if not shared_keys:
        raise DataError(
            "the two datasets have nothing in common to compare",
            expected="an object, or joints or fingertips of the same names, in both",
            found=f"{_channels(readers[0])} beside {_channels(readers[1])}",
        )
    sizes = (len(sides[0]), len(sides[1]))
    pools = [Pool.of(readers[0].found[key], readers[1].found[key], *sizes) for key in shared_keys]
    rows, bars = _rows(shared_keys, pools, *sizes)
    order = sorted(range(len(rows)), key=lambda i: (not rows[i].differs, -(rows[i].spreads or 0.0)))
    comparison = DatasetComparison(
        this=readers[0].side(),
        against=readers[1].side(),
        step_s=step_s,
        rows=tuple(rows[i] for i in order),
        unmatched=tuple(_unmatched_lines(*readers)),
        notes=tuple(_notes(readers)),
    )
    return ComparisonResult(comparison, tuple(bars[i] for i in order))


def _labels(dataset: Dataset, reference: Dataset) -> tuple[str, str]:
    """Return what to call the two: their names, told apart where they have the same."""
    if dataset.name != reference.name:
        return dataset.name, reference.name
    return f"{dataset.name} (this)", f"{reference.name} (against)"


def _compared_ids(dataset: Dataset) -> list[str]:
    """Return the ids that are compared: all, or evenly spaced ones."""
    places = np.unique(np.linspace(0, len(dataset) - 1, episodes_compared(dataset)).round().astype(int))
    return [dataset.ids[i] for i in places]


def _least_rate(dataset: Dataset, ids: Iterable[str]) -> float:
    """Return the lowest nominal rate of some episodes, from the catalog."""
    table = dataset.catalog().select(["id", "rate_hz"]).to_pydict()
    rates = dict(zip(table["id"], table["rate_hz"], strict=True))
    return float(min(rates[name] for name in ids))


class _Reader:
    """Gathers one side."""

    def __init__(self, dataset: Dataset, step_s: float, label: str) -> None:
        """Start without episodes."""
        self.dataset, self.step_s, self.label = dataset, step_s, label
        self.found: dict[Statistic, list[tuple[int, int, NDArray[np.float32]]]] = defaultdict(list)
        self.channels: set[str] = set()
        self.rates: set[float] = set()
        self.counts: dict[str, dict[str, int]] = {"sources": {}, "scenes": {}}
        self.rows, self.episodes, self.duration_s = 0, 0, 0.0

    def read(self, ids: list[str], progress: Callable[[], None]) -> None:
        """Take in the episodes; each statistic of each keeps a few numbers."""
        for number, episode in enumerate(self.dataset.episodes(ids)):
            meta = episode.meta
            self.channels |= {n for n in episode.arrays if not n.endswith(VALID_SUFFIX) and n not in DENSE_CHANNELS}
            self.rates.add(meta.rate_hz)
            for kind, value in (("sources", meta.source), ("scenes", meta.scene)):
                if value is not None:
                    self.counts[kind][value] = self.counts[kind].get(value, 0) + 1
            self.rows, self.episodes = self.rows + len(episode), self.episodes + 1
            self.duration_s += float(episode.time_s[-1])
            for key, values in measure(episode, self.step_s).items():
                self.found[key].append((number, len(values), Pool.sketch(values)))
            progress()

    def side(self) -> Side:
        """Return what was read."""
        d = self.dataset
        return Side(
            label=self.label,
            name=d.name,
            digest=d.digest,
            version=d.version,
            episodes=len(d),
            compared=self.episodes,
            rows=self.rows,
            duration_s=self.duration_s,
            sources=self.counts["sources"],
            scenes=self.counts["scenes"],
            rates_hz=tuple(sorted(self.rates)),
        )


def _rows(
    keys: list[Statistic], pools: list[Pool], first_count: int, second_count: int
) -> tuple[list[ComparisonRow], list[Bars]]:
    """Return the rows and what is drawn of them; all are dealt the same way at the same time."""
    rng = np.random.default_rng(0)  # the same page for the same data
    is_testable = math.comb(first_count + second_count, first_count) >= LEAST_WAYS
    deals = (
        np.stack([rng.permutation(first_count + second_count) < first_count for _ in range(DEALS)])
        if is_testable
        else None
    )
    true = np.arange(first_count + second_count) < first_count
    distances = [pool.distance(true[None])[0] for pool in pools]
    lucks = [np.zeros(0) if deals is None else pool.distance(deals) for pool in pools]
    differs_by_row = _differs_beyond_luck(np.array(distances), lucks) if is_testable else [None] * len(keys)
    rows, bars = [], []
    for key, pool, distance, luck, differs in zip(keys, pools, distances, lucks, differs_by_row, strict=True):
        spread = pool.spread(true)
        sides = [Spread(**vars(spread_of(pool, side))) for side in (true, ~true)]
        finite_luck = luck[np.isfinite(luck)]
        rows.append(
            ComparisonRow(
                group=key.group,
                statistic=key.name,
                element=key.element,
                unit=key.unit,
                this=sides[0],
                against=sides[1],
                distance=float(distance),
                spreads=float(distance / spread) if spread > 0 else None,
                luck=float(np.quantile(finite_luck, 1 - LEVEL)) if len(finite_luck) else None,
                differs=differs,
            )
        )
        bars.append(pool.bars(true))
    return rows, bars


def _differs_beyond_luck(distances: NDArray[np.float64], lucks: list[NDArray[np.float64]]) -> list[bool | None]:
    """Return which rows differ by more than luck when all are looked at: the maximum over rows of standard scores.

    Source: P. Westfall, S. Young, Resampling-Based Multiple Testing (1993), the single-step maxT procedure.
    """
    table = np.stack(lucks)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, width = np.nanmean(table, axis=1), np.nanstd(table, axis=1)
        scores = np.where(width[:, None] > 0, (table - mean[:, None]) / width[:, None], 0.0)
        row_scores = np.where(width > 0, (distances - mean) / width, 0.0)
    limit = float(np.quantile(np.nanmax(np.nan_to_num(scores, nan=0.0), axis=0), 1 - LEVEL))
    return [bool(score > limit) for score in row_scores]


def _channels(reader: _Reader) -> str:
    """Return the channels of one side."""
    return ", ".join(sorted(reader.channels - {"time_ns"}))


def _unmatched_lines(first_reader: _Reader, second_reader: _Reader) -> Iterable[str]:
    """Yield in words what only one of the two has: channels, then elements of statistics."""
    for reader, other_reader in ((first_reader, second_reader), (second_reader, first_reader)):
        channels = sorted(reader.channels - other_reader.channels)
        if channels:
            yield f"channels only in {reader.label}: {', '.join(channels)}"
        statistics_by_elements: dict[tuple[str, ...], list[str]] = defaultdict(list)
        names: dict[str, set[str]] = defaultdict(set)
        for key in set(reader.found) - set(other_reader.found):
            names[key.name].add(key.element)
        for name, elements in sorted(names.items()):
            statistics_by_elements[tuple(sorted(elements - {""}))].append(name)
        for element_names, statistics in sorted(statistics_by_elements.items()):
            of = f" of {', '.join(element_names)}" if element_names else ""
            yield f"only in {reader.label}: {', '.join(statistics)}{of}"


def _notes(readers: list[_Reader]) -> Iterable[str]:
    """Yield in words how things were measured where the two sides are not alike."""
    for reader in readers:
        if reader.episodes < len(reader.dataset):
            yield f"{reader.episodes} of {len(reader.dataset)} episodes of {reader.label} were read, evenly by id"
        if "fingertip_force" in reader.channels and "fingertip_contact" not in reader.channels:
            yield f"contact of fingertips in {reader.label} is derived: |Fx| + |Fy| + |Fz| above 0.3 N"
    if readers[0].rates != readers[1].rates:
        yield (
            f"rates differ: {_rates(readers[0])} beside {_rates(readers[1])}; speeds and accelerations are taken over "
            f"{1e3 * readers[0].step_s:.4g} ms in both"
        )


def _rates(reader: _Reader) -> str:
    """Return the rates of one side."""
    return ", ".join(f"{rate:g} Hz" for rate in sorted(reader.rates))
