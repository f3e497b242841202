"""Mixing: windows of several datasets, say simulated and real ones, in shares that are asked for and reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.datasets import Dataset
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.loaders.feed import Windows, thinned
from candata.loaders.gather import Batch, Gather, Stores, host_index
from candata.loaders.layout import row_shapes
from candata.loaders.normaliser import SAMPLE, Normaliser, Sample, fitted
from candata.loaders.resident import move
from candata.loaders.sampling import Sampler
from candata.loaders.shares import Effective, Mixture, effective, parse_mixture
from candata.schema.channels import canonical_order


@dataclass(frozen=True, eq=False)
class Mixed:
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

    def __len__(self) -> int:
        """Return the number of windows."""
        return sum(map(len, self.sources))

    def __getitem__(self, number: int) -> Batch:
        """Return one window: a batch without the first axis."""
        return {name: values[0] for name, values in self.batch([number]).items()}

    def __getitems__(self, numbers: Sequence[int]) -> Batch:
        """Return the batch of these windows: what a DataLoader asks for."""
        return self.batch(numbers)

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
        return move(self.gather, [one.cache.rows for one in self.sources], device)

    def effective(self, sampler: Sampler, steps: int) -> tuple[Effective, ...]:
        """Return what each source really gave in the first `steps` steps, all ranks together."""
        drawn = sampler.drawn(steps)
        windows = [len(one) for one in self.sources]
        unique = [min(pair) for pair in zip(drawn, windows, strict=True)]
        return effective(self.mixture, windows, [_rows(one) for one in self.sources], drawn, unique)

    @cached_property
    def gather(self) -> Gather:
        """Where each window lies, the rows of the sources standing one behind the other."""
        parts = [one.gather for one in self.sources]
        episodes = [len(one.begin) for one in parts]
        row = _offsets([len(one.cache.rows) for one in self.sources])
        return Gather(
            channels=parts[0].channels,
            past=parts[0].past,
            steps=parts[0].steps,
            present=_joined([one.present for one in parts], row),
            owner=_joined([one.owner for one in parts], _offsets(episodes)),
            begin=_joined([one.begin for one in parts], row),
            last=_joined([one.last for one in parts], row),
            stride=np.concatenate([one.stride for one in parts]),
            columns={"cloud": self._cloud_of, "domain": np.repeat(np.arange(len(parts)), episodes)},
            valid=_all([one.cache.valid for one in self.sources], all(one.valid is None for one in parts)),
            stretch=_all([one.cache.stretch for one in self.sources], all(one.stretch is None for one in parts)),
            index=host_index,
            take=Stores(tuple(one.cache.rows for one in self.sources)),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Send the fields alone to a worker."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sources; `domain` of a batch is an index into them."""
        return self.mixture.names

    @property
    def episode_ids(self) -> tuple[str, ...]:
        """`SOURCE/ID` of all episodes; `episode` of a batch is an index into them."""
        pairs = zip(self.names, self.sources, strict=True)
        return tuple(f"{name}/{episode}" for name, one in pairs for episode in one.episode_ids)

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
        found = [one.clouds for one in self.sources if len(one.clouds)]
        points = min((clouds.shape[1] for clouds in found), default=0)
        thin = [thinned(cloud, points) for clouds in found for cloud in clouds]
        return np.stack(thin) if thin else np.zeros((0, 0, 3), np.float32)

    @property
    def _cloud_of(self) -> NDArray[np.int64]:
        """Index of each episode's cloud, -1 without one."""
        own = [one.gather.columns["cloud"] for one in self.sources]
        offsets = _offsets([len(one.cloud_names) for one in self.sources])
        return np.concatenate([np.where(ids < 0, ids, ids + more) for ids, more in zip(own, offsets, strict=True)])

    @cached_property
    def normaliser(self) -> Normaliser:
        """Shared statistics: of the rows as the mixture shows them, each source with its share."""
        first, samples = self.sources[0], [one.fit_sample() for one in self.sources]
        shares = tuple(self.mixture.shares.values())
        rows = _shared([one.rows for one in samples], shares)
        poses, good = (_shared([one[k] for one in samples], shares) for k in (1, 2))
        return fitted(
            first.method,
            Sample(rows, poses, good),
            dataset=str(self.mixture),
            digest="+".join(one.dataset.digest for one in self.sources),
            episodes=sum(len(one.fit_episodes) for one in self.sources),
            rate_hz=self.rate_hz,
            horizon=first.horizon,
        )

    @property
    def normalisers(self) -> dict[str, Normaliser]:
        """Separate statistics: those of each source alone."""
        return {name: one.normaliser for name, one in zip(self.names, self.sources, strict=True)}


def mix(sources: Mapping[str, Windows], mixture: Mixture | str) -> Mixed:
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
        When the text tells no mixture, a source has no share, or windows differ in size, rate or method.
    DataError
        When channels, their shapes, or the names of joints, actuators or fingertips differ.
    """
    mixture = parse_mixture(mixture) if isinstance(mixture, str) else mixture
    for name in mixture.names:
        if name not in sources:
            raise UnknownNameError("source of the mixture", name, sources)
    idle = [name for name in sources if name not in mixture.names]
    if idle:
        raise UsageError(
            f"the source {idle[0]} has no share",
            expected=f"a share for each of {', '.join(sources)}",
            found=str(mixture),
            fix=f"add a share of {idle[0]}, or leave it out",
        )
    chosen = {name: sources[name] for name in mixture.names}
    for name in mixture.names[1:]:
        _check_alike(mixture.names[0], name, chosen)
    return Mixed(mixture, tuple(chosen.values()))


def common_channels(*datasets: Dataset) -> tuple[str, ...]:
    """Return the channels that all episodes of all datasets hold in one shape: what to give `windows(channels=...)`.

    Raises
    ------
    DataError
        When there is none.
    """
    shapes = [row_shapes(dataset, None) for dataset in datasets]
    found = [name for name in shapes[0] if all(one.get(name) == shapes[0][name] for one in shapes)]
    if not found:
        raise DataError(
            "the datasets have no channel in common",
            found="; ".join(f"{one.name}: {', '.join(held)}" for one, held in zip(datasets, shapes, strict=True)),
        )
    return tuple(canonical_order(found))


def _check_alike(first: str, second: str, sources: Mapping[str, Windows]) -> None:
    """Refuse to mix windows that are not of one kind; names both."""
    a, b = sources[first], sources[second]
    for name in ("history", "horizon", "rate_hz", "method"):
        if getattr(a, name) != getattr(b, name):
            raise UsageError(
                f"windows of {first} and {second} differ in {name}", expected=f"{first}: {getattr(a, name)}",
                found=f"{second}: {getattr(b, name)}", fix=f"open both with the same {name}",
            )  # fmt: skip
    where = Where(path=str(b.dataset.path))
    if a.channels != b.channels:
        common = [name for name in a.channels if name in b.channels]
        raise DataError(
            f"{first} and {second} hold different channels", expected=f"{first}: {', '.join(a.channels)}",
            found=f"{second}: {', '.join(b.channels)}", where=where,
            fix=f"open both with channels={common}, or see common_channels(...)",
        )  # fmt: skip
    for name, shape in a.cache.file.shapes.items():
        if b.cache.file.shapes[name] != shape:
            raise DataError(
                f"{first} and {second} differ in the shape of {name}", expected=f"{first}: {('T', *shape)}",
                found=f"{second}: {('T', *b.cache.file.shapes[name])}", where=where, fix="mix data of one hand",
            )  # fmt: skip
    read = ("fingertip_names",) if a.sizes()["fingertips"] else ()
    for key in ("joint_names", "actuator_names", *read):
        mine, other = getattr(a, key), getattr(b, key)
        if mine != other:
            turned = sorted(mine) == sorted(other)
            raise DataError(
                f"{first} and {second} differ in their {key.replace('_', ' ')}" + (": another order" if turned else ""),
                expected=f"{first}: {', '.join(mine) or 'none'}", found=f"{second}: {', '.join(other) or 'none'}",
                where=where, fix="import one of them again with the names and the order of the other",
            )  # fmt: skip


def _rows(windows: Windows) -> int:
    """Return how many rows the episodes of the windows have."""
    return int(np.array(windows.cache.file.rows)[np.unique(windows.owner)].sum())


def _offsets(counts: Sequence[int]) -> NDArray[np.int64]:
    """Return where each part begins when they stand one behind the other."""
    return np.cumsum([0, *counts[:-1]])


def _joined(parts: Sequence[NDArray], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers of the parts as numbers of the whole."""
    return np.concatenate([part + offset for part, offset in zip(parts, offsets, strict=True)])


def _all(parts: Sequence[NDArray], needless: bool) -> NDArray | None:
    """Return the flags of all rows; None where no source needs them."""
    return None if needless else np.concatenate(parts)


def _shared(parts: Sequence[NDArray], shares: Sequence[float]) -> NDArray:
    """Return what the parts hold, each evenly thinned to its share; where one is too short, some of it comes twice."""
    count = min(SAMPLE, sum(map(len, parts)))
    taken = []
    for part, share in zip(parts, shares, strict=True):
        numbers = np.linspace(0, len(part) - 1, max(1, round(count * share))) if len(part) else np.empty(0)
        taken.append(part[numbers.round().astype(np.int64)])
    return np.concatenate(taken)
