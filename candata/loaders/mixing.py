"""Mixing: windows of several datasets, such as simulated and real ones, in given shares that are reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.datasets import Dataset
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.loaders.feed import Windows, thin_cloud
from candata.loaders.gather import Batch, Gather, Stores, WindowList, host_index
from candata.loaders.layout import row_shapes
from candata.loaders.normaliser import SAMPLE, Normaliser, Sample, fit_normaliser
from candata.loaders.resident import move
from candata.loaders.sampling import Sampler
from candata.loaders.shares import Effective, Mixture, effective, parse_mixture
from candata.schema.channels import canonical_order


@dataclass(frozen=True, eq=False)
class MixedWindows:
    """Windows of several sources, one behind the other; map-style as `Windows`, drawn in shares by `sampler`.

    Batches are those of `Windows.batch` with `domain` (B,) int64, an index into `names`; `episode` is an index into
    `episode_ids` of all sources, `cloud` into the clouds of all.

    Attributes
    ----------
    mixture : Mixture
        Shares.
    sources : tuple of Windows
        In the order of the mixture.
    """

    mixture: Mixture
    sources: tuple[Windows, ...]

    def __repr__(self) -> str:
        """Return number and sources in one line."""
        return f"MixedWindows({len(self):,} windows of {', '.join(map(repr, self.sources))})"

    def __len__(self) -> int:
        """Return the number of windows."""
        return sum(map(len, self.sources))

    def __getitem__(self, number: int) -> Batch:
        """Return one window: a batch without the first axis."""
        return {name: values[0] for name, values in self.batch([number]).items()}

    def __getitems__(self, numbers: Sequence[int]) -> WindowList:
        """Return these windows, gathered at once: what a DataLoader asks for."""
        return WindowList(self.batch(numbers))

    def batch(self, numbers: ArrayLike) -> Batch:
        """Return the windows with these numbers, in their order; see `Windows.batch`.

        Raises
        ------
        IndexError
            When a number is out of range.
        """
        return self.gather.batch(numbers)

    def sampler(self, batch_size: int, seed: int = 0, rank: int = 0, world: int = 1) -> Sampler:
        """Return the sampler that draws each source in its share."""
        counts = tuple(map(len, self.sources))
        return Sampler(counts, batch_size, seed, rank, world, self.mixture.parts)

    def resident(self, device: str) -> Gather:
        """Return a copy on the device that gives the same batches as tensors; see `candata.loaders.resident.move`."""
        return move(self.gather, [source.cache.rows for source in self.sources], device)

    def effective(self, sampler: Sampler, steps: int) -> tuple[Effective, ...]:
        """Return what each source really gave in the first `steps` steps, all ranks together."""
        draw_counts = sampler.draw_counts(steps)
        windows = [len(source) for source in self.sources]
        unique = [min(pair) for pair in zip(draw_counts, windows, strict=True)]
        return effective(self.mixture, windows, [_rows(source) for source in self.sources], draw_counts, unique)

    @cached_property
    def gather(self) -> Gather:
        """The place of each window, the rows of the sources standing one behind the other."""
        parts = [source.gather for source in self.sources]
        episodes = [len(part.begin) for part in parts]
        row = _offsets([len(source.cache.rows) for source in self.sources])
        return Gather(
            channels=parts[0].channels,
            history=parts[0].history,
            steps=parts[0].steps,
            present_row=_renumber_parts([part.present_row for part in parts], row),
            owner=_renumber_parts([part.owner for part in parts], _offsets(episodes)),
            begin=_renumber_parts([part.begin for part in parts], row),
            last_row=_renumber_parts([part.last_row for part in parts], row),
            stride=np.concatenate([part.stride for part in parts]),
            columns={"cloud": self._cloud_of, "domain": np.repeat(np.arange(len(parts)), episodes)},
            valid=_concatenate_flags(
                [source.cache.valid for source in self.sources], all(part.valid is None for part in parts)
            ),
            stretch=_concatenate_flags(
                [source.cache.stretch for source in self.sources], all(part.stretch is None for part in parts)
            ),
            index=host_index,
            take=Stores(tuple(source.cache.rows for source in self.sources)),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Send the fields alone to a worker."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sources; `domain` of a batch is an index into them."""
        return self.mixture.names

    @property
    def episode_ids(self) -> tuple[str, ...]:
        """`SOURCE/ID` of all episodes; `episode` of a batch is an index into them."""
        pairs = zip(self.names, self.sources, strict=True)
        return tuple(f"{name}/{episode}" for name, source in pairs for episode in source.episode_ids)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of a row, in canonical order."""
        return self.sources[0].channels

    @property
    def rate_hz(self) -> float:
        """Rate of the model's steps."""
        return self.sources[0].rate_hz

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, the same in all sources."""
        return self.sources[0].joint_names

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators, the same in all sources."""
        return self.sources[0].actuator_names

    @property
    def fingertip_names(self) -> tuple[str, ...]:
        """Names of the fingertips, the same in all sources."""
        return self.sources[0].fingertip_names

    def sizes(self) -> dict[str, int]:
        """Return what fixes a model; see `Windows.sizes`."""
        return self.sources[0].sizes() | {"points": self.clouds.shape[1]}

    @cached_property
    def clouds(self) -> NDArray[np.float32]:
        """`(C, N, 3) float32 [m]`: the clouds of all sources, thinned to the smallest N of those that have any."""
        clouds_by_source = [source.clouds for source in self.sources if len(source.clouds)]
        points = min((clouds.shape[1] for clouds in clouds_by_source), default=0)
        thinned_clouds = [thin_cloud(cloud, points) for clouds in clouds_by_source for cloud in clouds]
        return np.stack(thinned_clouds) if thinned_clouds else np.zeros((0, 0, 3), np.float32)

    @property
    def _cloud_of(self) -> NDArray[np.int64]:
        """Index of each episode's cloud, -1 without one."""
        cloud_ids = [source.gather.columns["cloud"] for source in self.sources]
        offsets = _offsets([len(source.cloud_names) for source in self.sources])
        return np.concatenate(
            [np.where(ids < 0, ids, ids + offset) for ids, offset in zip(cloud_ids, offsets, strict=True)]
        )

    @cached_property
    def normaliser(self) -> Normaliser:
        """Shared statistics: of the rows as the mixture shows them, each source with its share."""
        first_source, samples = self.sources[0], [source.fit_sample() for source in self.sources]
        shares = tuple(self.mixture.shares.values())
        rows = _sample_by_share([sample.rows for sample in samples], shares)
        poses, is_real = (_sample_by_share([sample[k] for sample in samples], shares) for k in (1, 2))
        return fit_normaliser(
            first_source.method,
            Sample(rows, poses, is_real),
            dataset=str(self.mixture),
            digest="+".join(source.dataset.digest for source in self.sources),
            episodes=sum(len(source.fit_episodes) for source in self.sources),
            rate_hz=self.rate_hz,
            horizon=first_source.horizon,
        )

    @property
    def normalisers(self) -> dict[str, Normaliser]:
        """Separate statistics: those of each source alone."""
        return {name: source.normaliser for name, source in zip(self.names, self.sources, strict=True)}


def mix(sources: Mapping[str, Windows], mixture: Mixture | str) -> MixedWindows:
    """Return the windows of several datasets, to be drawn in shares.

    Parameters
    ----------
    sources : mapping of str to Windows
        Windows by name: of the same channels, sizes, rate, joints, actuators and fingertips.
    mixture : Mixture or str
        Share of each, such as `sim:0.7,real:0.3`.

    Raises
    ------
    UnknownNameError
        When the mixture names a source that is not given.
    UsageError
        When the text is no mixture, a source has no share, or windows differ in size, rate or method.
    DataError
        When channels, their shapes, or the names of joints, actuators or fingertips differ.
    """
    mixture = parse_mixture(mixture) if isinstance(mixture, str) else mixture
    for name in mixture.names:
        if name not in sources:
            raise UnknownNameError("source of the mixture", name, sources)
    sources_without_share = [name for name in sources if name not in mixture.names]
    if sources_without_share:
        raise UsageError(
            f"the source {sources_without_share[0]} has no share",
            expected=f"a share for each of {', '.join(sources)}",
            found=str(mixture),
            fix=f"add a share of {sources_without_share[0]}, or leave it out",
        )
    windows_by_name = {name: sources[name] for name in mixture.names}
    for name in mixture.names[1:]:
        _check_alike(mixture.names[0], name, windows_by_name)
    return MixedWindows(mixture, tuple(windows_by_name.values()))


def common_channels(*datasets: Dataset) -> tuple[str, ...]:
    """Return the channels that all episodes of all datasets hold in one shape: what to give `windows(channels=...)`.

    Raises
    ------
    DataError
        When there is none.
    """
    shapes = [row_shapes(dataset, None) for dataset in datasets]
    common_names = [name for name in shapes[0] if all(layout.get(name) == shapes[0][name] for layout in shapes)]
    if not common_names:
        raise DataError(
            "the datasets have no channel in common",
            found="; ".join(
                f"{dataset.name}: {', '.join(channel_shapes)}"
                for dataset, channel_shapes in zip(datasets, shapes, strict=True)
            ),
        )
    return tuple(canonical_order(common_names))


def _check_alike(first_name: str, second_name: str, sources: Mapping[str, Windows]) -> None:
    """Refuse to mix windows that are not of one kind; names both."""
    a, b = sources[first_name], sources[second_name]
    for name in ("history", "horizon", "rate_hz", "method"):
        if getattr(a, name) != getattr(b, name):
            raise UsageError(
                f"windows of {first_name} and {second_name} differ in {name}",
                expected=f"{first_name}: {getattr(a, name)}",
                found=f"{second_name}: {getattr(b, name)}",
                fix=f"open both with the same {name}",
            )
    location = Where(path=str(b.dataset.path))
    if a.channels != b.channels:
        shared_channels = [name for name in a.channels if name in b.channels]
        raise DataError(
            f"{first_name} and {second_name} hold different channels",
            expected=f"{first_name}: {', '.join(a.channels)}",
            found=f"{second_name}: {', '.join(b.channels)}",
            where=location,
            fix=f"open both with channels={shared_channels}, or see common_channels(...)",
        )
    for name, shape in a.cache.file.shapes.items():
        if b.cache.file.shapes[name] != shape:
            raise DataError(
                f"{first_name} and {second_name} differ in the shape of {name}",
                expected=f"{first_name}: {('T', *shape)}",
                found=f"{second_name}: {('T', *b.cache.file.shapes[name])}",
                where=location,
                fix="mix data of one hand",
            )
    fingertip_keys = ("fingertip_names",) if a.sizes()["fingertips"] else ()
    for key in ("joint_names", "actuator_names", *fingertip_keys):
        first_labels, second_labels = getattr(a, key), getattr(b, key)
        if first_labels != second_labels:
            is_reordered = sorted(first_labels) == sorted(second_labels)
            raise DataError(
                f"{first_name} and {second_name} differ in their {key.replace('_', ' ')}"
                + (": another order" if is_reordered else ""),
                expected=f"{first_name}: {', '.join(first_labels) or 'none'}",
                found=f"{second_name}: {', '.join(second_labels) or 'none'}",
                where=location,
                fix="import one of them again with the names and the order of the other",
            )


def _rows(windows: Windows) -> int:
    """Return how many rows the episodes of the windows have."""
    return int(np.array(windows.cache.file.rows)[np.unique(windows.owner)].sum())


def _offsets(counts: Sequence[int]) -> NDArray[np.int64]:
    """Return where each part begins when they stand one behind the other."""
    return np.cumsum([0, *counts[:-1]])


def _renumber_parts(parts: Sequence[NDArray], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers of the parts as numbers of the whole."""
    return np.concatenate([part + offset for part, offset in zip(parts, offsets, strict=True)])


def _concatenate_flags(parts: Sequence[NDArray], needless: bool) -> NDArray | None:
    """Return the flags of all rows; None where no source needs them."""
    return None if needless else np.concatenate(parts)


def _sample_by_share(parts: Sequence[NDArray], shares: Sequence[float]) -> NDArray:
    """Return what the parts hold, each evenly thinned to its share; where one is too short, some of it comes twice."""
    count = min(SAMPLE, sum(map(len, parts)))
    samples = []
    for part, share in zip(parts, shares, strict=True):
        numbers = np.linspace(0, len(part) - 1, max(1, round(count * share))) if len(part) else np.empty(0)
        samples.append(part[numbers.round().astype(np.int64)])
    return np.concatenate(samples)
