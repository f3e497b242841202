"""Windows: K + 1 rows of the past and H of the future at every row, gathered whole batches at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.datasets import Dataset, get_cloud, open_dataset
from candata.errors import UnknownNameError
from candata.loaders.cache import Cache, Progress, open_cache
from candata.loaders.gather import Batch, Gather, OneStore, WindowList, host_index
from candata.loaders.index import Pad, present_rows, strides
from candata.loaders.layout import known_channels
from candata.loaders.normaliser import METHODS, SAMPLE, Method, Normaliser, Sample, fit_normaliser
from candata.loaders.resident import move
from candata.loaders.sampling import Sampler
from candata.loaders.splits import Split, find_split, group_ids

#: Seed of the choice of points where clouds differ in size.
_THINNING_SEED = 0


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of a version, one for each present row; a map-style dataset for torch that needs no torch.

    Attributes
    ----------
    dataset : Dataset
        The version.
    cache : Cache
        Its rows, memory-mapped.
    split : Split or None
        The split, where one is used.
    history, horizon : int
        Rows of the past, the present one included, and steps of the future.
    rate_hz : float
        Rate of the model's steps.
    stride : (E,) int64
        Native rows a step, by episode.
    present_row : (n,) int64
        Row of the cache that is the present of each window.
    owner : (n,) int64
        Episode of each window, an index into `episode_ids`.
    fit_episodes : (m,) int64
        Episodes that the normaliser is fitted on: those that train, all without a split.
    method : str
        Method of the normaliser.
    """

    dataset: Dataset
    cache: Cache
    split: Split | None
    history: int
    horizon: int
    rate_hz: float
    stride: NDArray[np.int64]
    present_row: NDArray[np.int64]
    owner: NDArray[np.int64]
    fit_episodes: NDArray[np.int64]
    method: Method = "robust"

    def __repr__(self) -> str:
        """Return name, number and lengths in one line."""
        lengths = f"{self.history} rows of history, {self.horizon} steps ahead at {self.rate_hz:g} Hz"
        return f"Windows({self.dataset.name!r}, {len(self):,} windows, {lengths})"

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.present_row)

    def __getitem__(self, number: int) -> Batch:
        """Return one window: a batch without the first axis."""
        return {name: values[0] for name, values in self.batch([number]).items()}

    def __getitems__(self, numbers: Sequence[int]) -> WindowList:
        """Return these windows, gathered at once: what a DataLoader asks for."""
        return WindowList(self.batch(numbers))

    def batch(self, numbers: ArrayLike) -> Batch:
        """Return the windows with these numbers, raw SI values, channel by channel.

        - `history/<channel>` (B, K + 1, ...): the oldest row first, the present row last.
        - `future/<channel>` (B, H, ...): the H steps after it.
        - `planned/action` (B, H, A), where there are actions: those at the present row and at the H - 1 steps
          after it, which lead to `future`.
        - `history_pad` (B, K + 1) and `future_pad` (B, H) bool: rows beyond the episode (its first or last row
          stands there), rows in which any of the channels is not valid (its last valid value stands there), and rows
          beyond a break, where the clock shows that rows between them and the present one are missing. A pose
          increment is real where its row and the one before are both not flagged.
        - `cloud` (B,) int64: index into `clouds`, -1 without one; `episode` (B,) int64: index into `episode_ids`;
          `row` (B,) int64: the present row in its episode.

        Channels are views of one gathered block of this batch: not contiguous, free to write to; `planned/action`
        shares its memory with the actions of history and future.

        Parameters
        ----------
        numbers : (B,) int
            From 0 to `len(windows) - 1`.

        Raises
        ------
        IndexError
            When a number is out of range.
        """
        return self.gather.batch(numbers)

    def sampler(self, batch_size: int, seed: int = 0, rank: int = 0, world: int = 1) -> Sampler:
        """Return the sampler of these windows; see `Sampler`."""
        return Sampler((len(self),), batch_size, seed, rank, world)

    def resident(self, device: str) -> Gather:
        """Return a copy on the device that gives the same batches as tensors; see `candata.loaders.resident.move`."""
        return move(self.gather, [self.cache.rows], device)

    @cached_property
    def gather(self) -> Gather:
        """The place of each window."""
        cache = self.cache
        return Gather(
            channels=self.channels,
            history=self.history,
            steps=np.arange(1 - self.history, self.horizon + 1),
            present_row=self.present_row,
            owner=self.owner,
            begin=cache.begin,
            last_row=cache.end - 1,
            stride=self.stride,
            columns={"cloud": self._cloud_of},
            valid=None if cache.all_valid else cache.valid,
            stretch=None if cache.unbroken else cache.stretch,
            index=host_index,
            take=OneStore(cache.rows),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Send the fields alone to a worker: what is derived from the cache maps the file anew."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of a row, in canonical order."""
        return tuple(self.cache.file.shapes)

    @property
    def episode_ids(self) -> tuple[str, ...]:
        """Ids of all episodes of the version; `episode` of a batch is an index into them."""
        return self.cache.file.ids

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of `joint_position`."""
        return self.cache.file.joint_names

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators, in the order of `action`."""
        return self.cache.file.actuator_names

    @property
    def fingertip_names(self) -> tuple[str, ...]:
        """Names of the fingertips, in the order of `fingertip_force`."""
        return self.cache.file.fingertip_names

    def sizes(self) -> dict[str, int]:
        """Return what fixes a model: history, horizon, joints, actuators, fingertips, points; 0 for what is absent."""
        shapes = self.cache.file.shapes
        tips = shapes.get("fingertip_force") or shapes.get("fingertip_contact") or (0,)
        return {
            "history": self.history,
            "horizon": self.horizon,
            "joints": shapes.get("joint_position", (0,))[0],
            "actuators": shapes.get("action", (0,))[0],
            "fingertips": tips[0],
            "points": self.clouds.shape[1],
        }

    @cached_property
    def cloud_names(self) -> tuple[str, ...]:
        """sha256 of each distinct cloud, sorted: the order of `clouds`."""
        return tuple(sorted({name for name in self.cache.file.clouds if name is not None}))

    @cached_property
    def _cloud_of(self) -> NDArray[np.int64]:
        """Index of each episode's cloud, -1 without one."""
        number = {name: i for i, name in enumerate(self.cloud_names)}
        return np.array([-1 if name is None else number[name] for name in self.cache.file.clouds], np.int64)

    @cached_property
    def clouds(self) -> NDArray[np.float32]:
        """`(C, N, 3) float32 [m]`: distinct point clouds, in the object's frame.

        Clouds of more points than the smallest are thinned to its N, by a fixed draw.

        Raises
        ------
        DataError
            When the file of a cloud is missing or damaged.
        """
        clouds = [get_cloud(self.dataset.path, name) for name in self.cloud_names]
        if not clouds:
            return np.zeros((0, 0, 3), np.float32)
        points = min(map(len, clouds))
        return np.stack([thin_cloud(cloud, points) for cloud in clouds])

    @cached_property
    def normaliser(self) -> Normaliser:
        """Centre and scale of the float channels and of the pose increments, from the training episodes only."""
        return fit_normaliser(
            self.method,
            self.fit_sample(),
            dataset=self.dataset.name,
            digest=self.dataset.digest,
            episodes=len(self.fit_episodes),
            rate_hz=self.rate_hz,
            horizon=self.horizon,
        )

    def fit_sample(self) -> Sample:
        """Return valid rows and poses of the training episodes, evenly spread: what a normaliser is fitted on."""
        rows = np.concatenate([np.arange(self.cache.begin[e], self.cache.end[e]) for e in self.fit_episodes])
        rows = rows[self.cache.valid[rows]]
        sampled_rows = self.cache.rows.take(rows[:: -(-len(rows) // SAMPLE) or 1])
        if "object_pose" not in self.channels:
            return Sample(sampled_rows, np.empty((0, self.horizon + 1, 7)), np.empty((0, self.horizon), bool))
        present_row, owner = present_rows(self.cache, self.fit_episodes, self.stride, 1, self.horizon, 1, pad="both")
        every = -(-len(present_row) * (self.horizon + 1) // (2 * SAMPLE)) or 1
        fit = replace(self, history=1, present_row=present_row[::every], owner=owner[::every])
        batch = fit.batch(np.arange(len(fit)))
        poses = np.concatenate([batch["history/object_pose"], batch["future/object_pose"]], axis=1)
        pad = np.concatenate([batch["history_pad"], batch["future_pad"]], axis=1)
        return Sample(sampled_rows, poses, ~(pad[:, 1:] | pad[:, :-1]))


def thin_cloud(cloud: NDArray[np.float32], points: int) -> NDArray[np.float32]:
    """Return `points` of a cloud; the points of a cloud are not in random order."""
    if len(cloud) == points:
        return cloud
    point_ids = np.random.default_rng(_THINNING_SEED).choice(len(cloud), points, replace=False)
    return cloud[np.sort(point_ids)]


def windows(
    dataset: Dataset | str | Path,
    history: int = 8,
    horizon: int = 16,
    rate_hz: float = 10.0,
    *,
    stride: int | None = None,
    channels: Sequence[str] | None = None,
    split: str | None = None,
    splits: Split | str | None = None,
    pad: Pad = "history",
    step: int = 1,
    method: Method = "robust",
    cache: str | Path | None = None,
    progress: Progress = lambda done_count, total: None,
) -> Windows:
    """Return the windows of a dataset: one at every native row that has a whole horizon ahead.

    The first call for a version and a set of channels makes a memory-mapped cache; later ones open it.

    Parameters
    ----------
    dataset : Dataset, str or Path
        Version, or folder of a dataset (its newest version).
    history : int
        Rows of the past, the present one included (K + 1).
    horizon : int
        Steps of the future (H).
    rate_hz : float
        Rate of the steps: every (episode's rate / rate_hz)-th row is taken, a whole number for each episode.
    stride : int, optional
        Native rows a step, instead of `rate_hz`.
    channels : sequence of str, optional
        Channels to hold; by default those that all episodes hold, without taxels. `point_cloud` demands a cloud
        of every object.
    split : str, optional
        `train`, `val` or `test`; all episodes when omitted.
    splits : Split or str, optional
        The split, or the name of a stored one; see `find_split`. The normaliser is fitted on its `train`.
    pad : str
        `history`: the past may begin before the episode, the future must be whole (default); `both`: at least
        one step of the future must be real; `none`: whole windows only.
    step : int
        Every how many native rows a window begins.
    method : str
        Method of the normaliser: `robust`, `std` or `quantile`; see `channel_scale`.
    cache : str or Path, optional
        Folder for caches; see `open_cache`.
    progress : callable
        Called with (episodes done, episodes in all) while the cache is made.

    Raises
    ------
    UsageError
        When a number is out of range, or there is no dataset.
    UnknownNameError
        When a channel, group, split, padding or method is not known.
    DataError
        When a channel is missing, rates do not divide, the group is empty, or no episode is long enough.
    SetupError
        When the cache cannot be written.
    """
    if method not in METHODS:
        raise UnknownNameError("method of a normaliser", method, METHODS)
    version = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    channel_names = None if channels is None else known_channels(channels)
    active_split = find_split(version, splits) if split is not None or splits is not None else None
    rows = open_cache(version, channel_names, None if cache is None else Path(cache), progress)
    number = {name: i for i, name in enumerate(rows.file.ids)}
    training = _numbers(number, group_ids(version, active_split, "train") if active_split else version.ids)
    episode_numbers = _numbers(
        number, group_ids(version, active_split, split) if active_split and split else version.ids
    )
    step_of, rate = strides(rows, np.union1d(training, episode_numbers), rate_hz, stride)
    present_row, owner = present_rows(rows, episode_numbers, step_of, history, horizon, step, pad)
    return Windows(version, rows, active_split, history, horizon, rate, step_of, present_row, owner, training, method)


def _numbers(number: dict[str, int], ids: Sequence[str]) -> NDArray[np.int64]:
    """Return the episodes' positions, ascending."""
    return np.array(sorted(number[name] for name in ids), np.int64)
