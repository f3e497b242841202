"""What is in a dataset: counts, ranges, contact and phases, in one pass."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.datasets.dataset import Dataset
from candata.datasets.versions import numbers
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata.schema.phases import CONTACT_PHASES, contact_phases
from candata.schema.record import Record


class ChannelSummary(Record):
    """One channel over all episodes; `low` and `high` are null where no value is valid.

    Shapes are without the time axis; several where episodes differ.
    """

    name: str
    unit: str
    shapes: tuple[tuple[int, ...], ...]
    episodes: int
    low: float | None
    high: float | None
    invalid_share: float


class Summary(Record):
    """What `candata inspect` prints; shares are of rows, null where no episode knows contact.

    Counts by scene, object and task leave out episodes that state none.
    """

    name: str
    digest: str
    version: int
    versions: int
    episodes: int
    rows: int
    duration_s: float
    sources: dict[str, int]
    scenes: dict[str, int]
    objects: dict[str, int]
    tasks: dict[str, int]
    channels: tuple[ChannelSummary, ...]
    contact_share: float | None
    fingertip_contact_shares: dict[str, float]
    phases: dict[str, float] | None
    lineage: tuple[Lineage, ...]


@dataclass
class _Range:
    """Running range of one channel."""

    shapes: set[tuple[int, ...]] = field(default_factory=set)
    episodes: int = 0
    rows: int = 0
    invalid: int = 0
    low: float = np.inf
    high: float = -np.inf

    def add(self, values: NDArray, valid: NDArray[np.bool_]) -> None:
        """Take in one episode."""
        self.shapes.add(values.shape[1:])
        self.episodes += 1
        self.rows += len(values)
        self.invalid += int((~valid).sum())
        kept = values[valid]
        if kept.size:
            self.low, self.high = min(self.low, float(kept.min())), max(self.high, float(kept.max()))

    def summary(self, name: str) -> ChannelSummary:
        """Return the range so far."""
        return ChannelSummary(
            name=name,
            unit=CHANNELS[name].unit,
            shapes=tuple(sorted(self.shapes)),
            episodes=self.episodes,
            low=self.low if self.low <= self.high else None,
            high=self.high if self.low <= self.high else None,
            invalid_share=self.invalid / self.rows,
        )


def summarise(dataset: Dataset, progress: Callable[[], None] = lambda: None) -> Summary:
    """Return what is in a version, read once from beginning to end.

    Parameters
    ----------
    dataset : Dataset
        Version to read.
    progress : callable
        Called after each episode.

    Raises
    ------
    DataError
        When a part is damaged; names the file.
    """
    ranges: dict[str, _Range] = defaultdict(_Range)
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    touch: dict[str, list[NDArray[np.bool_]]] = defaultdict(list)
    phases: Counter[str] = Counter()
    rows, duration_s = 0, 0.0
    for episode in dataset.episodes():
        rows, duration_s = rows + len(episode), duration_s + float(episode.time_s[-1])
        for name in (n for n in episode.arrays if not n.endswith(VALID_SUFFIX)):
            ranges[name].add(episode[name], episode.valid(name))
        for key in ("source", "scene", "object", "task"):
            counts[key].update([v for v in [getattr(episode.meta, key)] if v is not None])
        for label, flags in touches(episode).items():
            touch[label].append(flags)
            if label == ANY:
                phases.update(contact_phases(flags, episode.meta.rate_hz).tolist())
        progress()
    shares = {label: float(np.concatenate(flags).mean()) for label, flags in touch.items()}
    known = sum(phases.values())
    return Summary(
        name=dataset.name,
        digest=dataset.digest,
        version=dataset.version,
        versions=len(numbers(dataset.path)),
        episodes=len(dataset),
        rows=rows,
        duration_s=duration_s,
        sources=dict(counts["source"]),
        scenes=dict(counts["scene"]),
        objects=dict(counts["object"]),
        tasks=dict(counts["task"]),
        channels=tuple(ranges[name].summary(name) for name in CHANNELS if name in ranges),
        contact_share=shares.pop(ANY, None),
        fingertip_contact_shares=shares,
        phases={name: phases[name] / known for name in CONTACT_PHASES} if known else None,
        lineage=dataset.lineage,
    )


#: Label of the touch of any fingertip.
ANY = ""


def touches(episode: Episode) -> dict[str, NDArray[np.bool_]]:
    """Return `(T,) bool` touch a fingertip and, under `ANY`, of any; empty where the episode has neither.

    Rows without a valid value count as no touch.
    """
    found: dict[str, NDArray[np.bool_]] = {}
    if "fingertip_contact" in episode:
        flags = episode["fingertip_contact"] & episode.valid("fingertip_contact")[:, None]
        names = episode.meta.fingertip_names or [f"fingertip {i}" for i in range(flags.shape[1])]
        found = dict(zip(names, flags.T, strict=True))
        found[ANY] = np.asarray(flags.any(axis=1))
    if "contact" in episode:
        found[ANY] = episode["contact"] & episode.valid("contact")
    return found
