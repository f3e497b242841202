"""Episodes that a learned world makes: rows in memory, read as windows by models and simulators alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.loaders import Windows
from candata.loaders.cache import Cache
from candata.policy_evaluation.contract import Array
from candata.rotation import difference, exp, multiply, normalise
from candata.training.rollout import CONTACT_THRESHOLD


@dataclass(frozen=True, eq=False)
class ImaginedEpisodes:
    """n episodes of equal length that begin at rest and are written as they are made.

    Attributes
    ----------
    windows : Windows
        Over the rows in memory, of a model's history, horizon and rate.
    rows : (n, R) structured
        The rows, one field a channel; a view of what the windows read.
    first_row : int
        Row 0 of the policy; the rows before it are the past at rest.
    stride : int
        Rows a model step.
    cloud : (n,) int64
        Number of each episode's point cloud.
    """

    windows: Windows
    rows: NDArray
    first_row: int
    stride: int
    cloud: NDArray[np.int64]

    def batch(self, step: int) -> dict[str, NDArray]:
        """Return the windows whose present is `step` model steps after row 0, one of each episode."""
        present_rows = self.windows.cache.begin + self.first_row + step * self.stride
        owner = np.arange(len(present_rows))
        batch = replace(self.windows, present_row=present_rows, owner=owner).batch(owner)
        batch["cloud"] = self.cloud
        return batch

    def poses(self, step: int) -> Array:
        """Return the poses `(n, 7)` at a model step."""
        return np.asarray(self.rows["object_pose"][:, self.first_row + step * self.stride], np.float64)

    def write_step(self, step: int, pose: Array, contact: Array | None) -> None:
        """Write the poses `(n, 7)` of model step `step` and of the rows that lead there, straight and evenly turned.

        A probability of contact `(n,)` holds for the same rows.
        """
        stop = self.first_row + step * self.stride + 1
        pose_before = self.rows["object_pose"][:, stop - 1 - self.stride].astype(np.float64)[:, None]
        share = (np.arange(1, self.stride + 1) / self.stride)[:, None]
        turn = exp(share * difference(pose[:, None, 3:], pose_before[..., 3:]))
        position = (1 - share) * pose_before[..., :3] + share * pose[:, None, :3]
        part = slice(stop - self.stride, stop)
        self.rows["object_pose"][:, part] = np.concatenate(
            [position, normalise(multiply(turn, pose_before[..., 3:]))], -1
        )
        if contact is not None and "contact" in (self.rows.dtype.names or ()):
            self.rows["contact"][:, part] = contact[:, None] >= CONTACT_THRESHOLD


def imagined_episodes(
    source: Windows, episodes: NDArray[np.int64], past_rows: dict[str, Array], rows: int
) -> ImaginedEpisodes:
    """Return episodes that have a past and room for what comes.

    Parameters
    ----------
    source : Windows
        As a model reads recordings: names, channels, history, horizon, rate and clouds.
    episodes : (n,) int64
        Number in `source` of the recording that each begins from: its rate and point cloud.
    past_rows : dict of str to (n, L, ...) ndarray
        Channels of the rows up to row 0, itself included.
    rows : int
        Rows of the policy, which model steps and the horizon behind them cover.
    """
    count, lead = len(episodes), next(iter(past_rows.values())).shape[1] - 1
    stride = int(source.stride[episodes[0]])
    length = lead + (-(-rows // stride) + source.horizon) * stride + 1
    store = np.zeros(count * length, source.cache.rows.dtype)
    view = store.reshape(count, length)
    for name in view.dtype.names or ():
        if name in past_rows:
            view[name][:, : lead + 1] = past_rows[name]
            view[name][:, lead + 1 :] = past_rows[name][:, -1:]
    file = source.cache.file.model_copy(
        update={
            "ids": tuple(str(k) for k in range(count)),
            "rows": (length,) * count,
            "rate_hz": (source.cache.file.rate_hz[episodes[0]],) * count,
            "clouds": tuple(source.cache.file.clouds[e] for e in episodes),
        }
    )
    memory = Cache(source.cache.folder, file, store, np.ones(len(store), bool), np.zeros(len(store), np.int32))
    own_windows = replace(
        source,
        cache=memory,
        stride=np.full(count, stride, np.int64),
        present_row=memory.begin,
        owner=np.arange(count),
        fit_episodes=np.arange(count),
    )
    names = {name: k for k, name in enumerate(source.cloud_names)}
    cloud = np.array([-1 if name is None else names[name] for name in file.clouds], np.int64)
    return ImaginedEpisodes(own_windows, view, lead, stride, cloud)
