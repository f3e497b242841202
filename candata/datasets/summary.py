"""What is in a dataset: counts, ranges, contact and phases, in one pass."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.datasets.dataset import Dataset
from candata.datasets.elements import fingertip_labels
from candata.datasets.versions import numbers
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata.schema.phases import CONTACT_PHASES, contact_phases
from candata.schema.record import ResultRecord


class ChannelSummary(ResultRecord):
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


class Summary(ResultRecord):
    """What `candata inspect` prints; shares are of rows, null where no episode knows contact.

    `collision_shares` are those in which a fingertip's geoms met the object, `label_disagreements` those in which that
    and its contact by force differ; both are empty where no episode knows it.
    Counts by scene, object and task leave out episodes that state none. `outcomes` counts episodes by task and outcome;
    those without an outcome are left out, and those without a task stand under an empty one.
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
    outcomes: dict[str, dict[str, int]]
    channels: tuple[ChannelSummary, ...]
    contact_share: float | None
    fingertip_contact_shares: dict[str, float]
    collision_shares: dict[str, float]
    label_disagreements: dict[str, float]
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
        valid_values = values[valid]
        if valid_values.size:
            self.low, self.high = min(self.low, float(valid_values.min())), max(self.high, float(valid_values.max()))

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


@dataclass
class _Touch:
    """Running counts of contact: rows in touch and rows in all by label, rows by phase; the same of collision."""

    rows: Counter[str] = field(default_factory=Counter)
    touch_rows: Counter[str] = field(default_factory=Counter)
    phases: Counter[str] = field(default_factory=Counter)
    collision_rows: Counter[str] = field(default_factory=Counter)
    collided_rows: Counter[str] = field(default_factory=Counter)
    compared_rows: Counter[str] = field(default_factory=Counter)
    differing_rows: Counter[str] = field(default_factory=Counter)

    def add(self, episode: Episode) -> None:
        """Take in one episode."""
        touch_by_label = touches(episode)
        for label, flags in collisions(episode).items():
            self.collision_rows[label] += len(flags)
            self.collided_rows[label] += int(flags.sum())
            if label in touch_by_label:
                self.compared_rows[label] += len(flags)
                self.differing_rows[label] += int((flags != touch_by_label[label]).sum())
        for label, flags in touch_by_label.items():
            self.rows[label] += len(flags)
            self.touch_rows[label] += int(flags.sum())
            if label == ANY_FINGERTIP:
                self.phases.update(contact_phases(flags, episode.meta.rate_hz).tolist())

    def shares(self) -> dict[str, float]:
        """Return the share of rows in touch by label."""
        return {label: self.touch_rows[label] / rows for label, rows in self.rows.items()}

    def collision_shares(self) -> dict[str, float]:
        """Return the share of rows in collision by label."""
        return {label: self.collided_rows[label] / rows for label, rows in self.collision_rows.items()}

    def label_disagreements(self) -> dict[str, float]:
        """Return the share of rows in which collision and contact differ by label."""
        return {label: self.differing_rows[label] / rows for label, rows in self.compared_rows.items()}

    def phase_shares(self) -> dict[str, float] | None:
        """Return the share of rows by phase; None where contact is not known."""
        row_count = sum(self.phases.values())
        return {name: self.phases[name] / row_count for name in CONTACT_PHASES} if row_count else None


def summarise(
    dataset: Dataset,
    progress: Callable[[], None] = lambda: None,
    ids: Sequence[str] | None = None,
    watch: Callable[[Episode], None] = lambda episode: None,
) -> Summary:
    """Return what is in a version, read once from beginning to end; memory does not grow with its length.

    Parameters
    ----------
    dataset : Dataset
        Version to read.
    progress : callable
        Called after each episode.
    ids : sequence of str, optional
        Only these episodes.
    watch : callable
        Called with each episode, for what else is gathered in the same pass.

    Raises
    ------
    UnknownNameError
        When an id is not in the version.
    DataError
        When a part is damaged; names the file.
    """
    ranges: dict[str, _Range] = defaultdict(_Range)
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    outcomes: dict[str, Counter[str]] = defaultdict(Counter)
    touch = _Touch()
    episodes, rows, duration_s = 0, 0, 0.0
    for episode in dataset.episodes(ids):
        episodes, rows, duration_s = episodes + 1, rows + len(episode), duration_s + float(episode.time_s[-1])
        for name in (n for n in episode.arrays if not n.endswith(VALID_SUFFIX)):
            ranges[name].add(episode[name], episode.valid(name))
        for key in ("source", "scene", "object", "task"):
            counts[key].update([v for v in [getattr(episode.meta, key)] if v is not None])
        if episode.meta.outcome is not None:
            outcomes[episode.meta.task or ""][episode.meta.outcome] += 1
        touch.add(episode)
        watch(episode)
        progress()
    shares = touch.shares()
    return Summary(
        name=dataset.name,
        digest=dataset.digest,
        version=dataset.version,
        versions=len(numbers(dataset.path)),
        episodes=episodes,
        rows=rows,
        duration_s=duration_s,
        sources=dict(counts["source"]),
        scenes=dict(counts["scene"]),
        objects=dict(counts["object"]),
        tasks=dict(counts["task"]),
        outcomes={task: dict(outcomes[task]) for task in sorted(outcomes)},
        channels=tuple(ranges[name].summary(name) for name in CHANNELS if name in ranges),
        contact_share=shares.pop(ANY_FINGERTIP, None),
        fingertip_contact_shares=shares,
        collision_shares=touch.collision_shares(),
        label_disagreements=touch.label_disagreements(),
        phases=touch.phase_shares(),
        lineage=dataset.lineage,
    )


#: Label of the touch of any fingertip.
ANY_FINGERTIP = ""


def touches(episode: Episode) -> dict[str, NDArray[np.bool_]]:
    """Return `(T,) bool` touch a fingertip and, under `ANY`, of any; empty where the episode has neither.

    Rows without a valid value count as no touch.
    """
    touch_by_label: dict[str, NDArray[np.bool_]] = {}
    if "fingertip_contact" in episode:
        flags = episode["fingertip_contact"] & episode.valid("fingertip_contact")[:, None]
        touch_by_label = dict(zip(fingertip_labels(episode.meta, flags.shape[1]), flags.T, strict=True))
        touch_by_label[ANY_FINGERTIP] = np.asarray(flags.any(axis=1))
    if "contact" in episode:
        touch_by_label[ANY_FINGERTIP] = episode["contact"] & episode.valid("contact")
    return touch_by_label


def collisions(episode: Episode) -> dict[str, NDArray[np.bool_]]:
    """Return `(T,) bool` whether each fingertip's geoms met the object; empty where the episode does not know it.

    Rows without a valid value count as none.
    """
    if "fingertip_collision" not in episode:
        return {}
    flags = episode["fingertip_collision"] & episode.valid("fingertip_collision")[:, None]
    return dict(zip(fingertip_labels(episode.meta, flags.shape[1]), flags.T, strict=True))
