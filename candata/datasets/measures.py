"""What an episode does, as samples that two worlds can be compared by: motion, force, contact timing, following."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.datasets.elements import actuator_labels, fingertip_labels, joint_labels
from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.rotation import difference
from candata.schema.contact import fingertip_contact
from candata.schema.episode import Episode
from candata.schema.phases import CONTACT_PHASES, contact_phases

Array = NDArray[np.float64]
#: Element of what is gathered over all fingertips.
ALL_FINGERTIPS = "all fingertips"
#: Longest lag of a joint behind its command that is looked for.
LONGEST_LAG_S = 0.3
#: Correlation of command and position changes below which a lag is no finding, but noise.
LEAST_CORRELATION = 0.5


@dataclass(frozen=True, order=True)
class Statistic:
    """One thing measured: its group, name and unit (`joint` is rad or m), and the element it is of."""

    group: str
    name: str
    unit: str
    element: str = ""


Samples = dict[Statistic, Array]


def measure(episode: Episode, step_s: float) -> Samples:
    """Return the samples of every statistic that the episode has channels for; a statistic without any is left out.

    Parameters
    ----------
    episode : Episode
        Values that are not valid, and steps over a gap, are left out.
    step_s : float
        Time over which positions are differenced, rounded to whole rows: the same for all that is compared.
    """
    samples = {**_motion(episode, step_s), **_touch_samples(episode), **_following_samples(episode)}
    return {key: finite_values for key, values in samples.items() if len(finite_values := values[np.isfinite(values)])}


def _stride(episode: Episode, step_s: float) -> int:
    """Return the rows of a step."""
    return max(1, round(step_s * episode.meta.rate_hz))


def _differences(episode: Episode, channel: str, step_s: float) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return first and last rows of whole steps between valid rows, and their lengths in seconds."""
    stride = _stride(episode, step_s)
    start_rows = np.arange(max(len(episode) - stride, 0))
    gaps = np.cumsum(~episode.valid(channel))
    length = (episode["time_ns"][start_rows + stride] - episode["time_ns"][start_rows]) * 1e-9
    is_whole = (gaps[start_rows + stride] == gaps[start_rows]) & episode.valid(channel)[start_rows]
    is_whole &= length < 1.5 * stride / episode.meta.rate_hz
    return start_rows[is_whole], start_rows[is_whole] + stride, length[is_whole]


def _motion(episode: Episode, step_s: float) -> Samples:
    """Return speeds and accelerations of joints and object."""
    samples: Samples = {}
    if "joint_position" in episode:
        position = np.asarray(episode["joint_position"], float)
        velocity, acceleration = _rates(episode, "joint_position", position, step_s)
        for i, name in enumerate(joint_labels(episode.meta, position.shape[1])):
            samples[Statistic("motion", "joint speed", "joint/s", name)] = np.abs(velocity[:, i])
            samples[Statistic("motion", "joint acceleration", "joint/s\N{SUPERSCRIPT TWO}", name)] = np.abs(
                acceleration[:, i]
            )
    if "object_pose" in episode:
        pose = np.asarray(episode["object_pose"], float)
        velocity, acceleration = _rates(episode, "object_pose", pose[:, :3], step_s)
        start_rows, end_rows, length = _differences(episode, "object_pose", step_s)
        turn = np.linalg.norm(difference(pose[end_rows, 3:], pose[start_rows, 3:]), axis=1)
        samples[Statistic("motion", "object speed", "m/s")] = np.linalg.norm(velocity, axis=1)
        samples[Statistic("motion", "object acceleration", "m/s\N{SUPERSCRIPT TWO}")] = np.linalg.norm(
            acceleration, axis=1
        )
        samples[Statistic("motion", "object turning rate", "rad/s")] = turn / length
    return samples


def _rates(episode: Episode, channel: str, values: Array, step_s: float) -> tuple[Array, Array]:
    """Return velocities `(N, D)` and accelerations `(M, D)` by differences over whole steps."""
    start_rows, end_rows, length = _differences(episode, channel, step_s)
    velocity = np.full_like(values, np.nan)
    velocity[start_rows] = (values[end_rows] - values[start_rows]) / length[:, None]
    acceleration = (velocity[end_rows] - velocity[start_rows]) / length[:, None]
    return velocity[start_rows], acceleration


def _touch_samples(episode: Episode) -> Samples:
    """Return forces in contact and the timing of contacts, a fingertip and in all."""
    flags = touches(episode)
    force = np.asarray(episode["fingertip_force"], float) if "fingertip_force" in episode else None
    if force is not None:
        is_known = episode.valid("fingertip_force")
        names = fingertip_labels(episode.meta, force.shape[1])
        if "fingertip_contact" not in episode:
            flags = dict(zip(names, (fingertip_contact(force) & is_known[:, None]).T, strict=True)) | flags
        flags.setdefault(ANY_FINGERTIP, np.any([flags[name] for name in names], axis=0))
        size = np.where(is_known[:, None], np.linalg.norm(force, axis=2), np.nan)
    samples: Samples = {}
    for name, touch in flags.items():
        samples |= _timing(episode, touch, name)
        if force is not None and name in names:
            samples |= _forces(episode, touch, size[:, names.index(name)], name)
    if force is not None:
        samples |= _pool_forces(samples, names)
    if ANY_FINGERTIP in flags:
        phases = contact_phases(flags[ANY_FINGERTIP], episode.meta.rate_hz)
        for phase in CONTACT_PHASES:
            samples[Statistic("contact", "share of the episode in phase", "1", phase)] = np.array(
                [np.mean(phases == phase)]
            )
    return samples


def _timing(episode: Episode, touch: NDArray[np.bool_], name: str) -> Samples:
    """Return durations, onsets a second and the share of time in contact."""
    element = name or "any fingertip"
    spans = np.array([length for _, _, length in _contacts(episode, touch)])
    length = float(episode.time_s[-1])
    onsets = np.sum(touch[1:] & ~touch[:-1])
    return {
        Statistic("contact", "contact duration", "s", element): spans,
        Statistic("contact", "onsets per second", "1/s", element): np.array([onsets / length]) if length else spans[:0],
        Statistic("contact", "share of the episode in contact", "1", element): np.array([touch.mean()]),
    }


def _contacts(episode: Episode, touch: NDArray[np.bool_]) -> Iterator[tuple[int, int, float]]:
    """Yield first row, row behind the last, and length [s] of each contact, cut off where the episode is."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touch.astype(np.int8), [0]])))
    for start_row, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        duration = float(episode.time_s[stop - 1] - episode.time_s[start_row])
        yield start_row, stop, duration + 1 / episode.meta.rate_hz


def _forces(episode: Episode, touch: NDArray[np.bool_], size: Array, name: str) -> Samples:
    """Return the magnitude in contact, and of each contact its impulse and its peak."""
    step = np.diff(episode.time_s, prepend=-1 / episode.meta.rate_hz)
    spans = [(a, b) for a, b, _ in _contacts(episode, touch) if np.isfinite(size[a:b]).any()]
    return {
        Statistic("force", "force in contact", "N", name): size[touch],
        Statistic("force", "impulse per contact", "N s", name): np.array(
            [np.nansum(size[a:b] * step[a:b]) for a, b in spans]
        ),
        Statistic("force", "peak force per contact", "N", name): np.array([np.nanmax(size[a:b]) for a, b in spans]),
    }


def _pool_forces(samples: Samples, names: tuple[str, ...]) -> Samples:
    """Return the samples of force of all fingertips together: what differs in all of them is surer in their sum."""
    of: dict[Statistic, list[Array]] = {}
    for key, values in samples.items():
        if key.group == "force" and key.element in names:
            of.setdefault(replace(key, element=ALL_FINGERTIPS), []).append(values)
    return {key: np.concatenate(values) for key, values in of.items()} if len(names) > 1 else {}


def _following_samples(episode: Episode) -> Samples:
    """Return rms of command minus position, and lag behind the command, for each joint with a command of its name."""
    samples: Samples = {}
    for name, command, position in commanded_joints(episode):
        error = command - position
        if np.isfinite(error).any():
            rms = float(np.sqrt(np.nanmean(error**2)))
            samples[Statistic("following", "rms of command minus position", "joint", name)] = np.array([rms])
        samples[Statistic("following", "lag behind the command", "s", name)] = np.array(
            [lag_s(command, position, episode.meta.rate_hz)]
        )
    return samples


def commanded_joints(episode: Episode) -> Iterator[tuple[str, Array, Array]]:
    """Yield joint, its command and its position at the end of the step that the command was held for.

    A command belongs to the joint of its name; where one side has no names, to that in its place if there are equally
    many. Rows that are not valid are NaN.
    """
    if "action" not in episode or "joint_position" not in episode:
        return
    command, position = (np.array(episode[c], float) for c in ("action", "joint_position"))
    for values, channel in ((command, "action"), (position, "joint_position")):
        values[~episode.valid(channel)] = np.nan
    if episode.meta.action == "next":
        command, position = command[:-1], position[1:]
    joints = joint_labels(episode.meta, position.shape[1])
    has_names = episode.meta.joint_names and episode.meta.actuator_names
    if not has_names and position.shape[1] != command.shape[1]:
        return
    drivers = actuator_labels(episode.meta, command.shape[1]) if has_names else joints
    for i, name in enumerate(joints):
        if name in drivers:
            yield name, command[:, drivers.index(name)], position[:, i]


def lag_s(command: Array, position: Array, rate_hz: float) -> float:
    """Return by how much the position's changes lag behind the command's, NaN where they hardly correlate.

    The lag of the largest correlation between 0 and 0.3 s, refined by a parabola through its neighbours; counted from
    the end of the step that the command was held for.

    Parameters
    ----------
    command, position : (T,) float64
        NaN where not valid.
    rate_hz : float
        Rows a second.
    """
    a, b = np.diff(command), np.diff(position)
    reach = min(round(LONGEST_LAG_S * rate_hz), len(a) // 2)
    if reach < 1:
        return float("nan")
    correlations = np.array([_correlation(a[: len(a) - k], b[k:]) for k in range(reach + 1)])
    best_lag = int(np.argmax(correlations))
    if not correlations[best_lag] >= LEAST_CORRELATION:
        return float("nan")
    if not 0 < best_lag < reach:
        return best_lag / rate_hz
    left_value, peak_value, right_value = correlations[best_lag - 1 : best_lag + 2]
    bend = left_value - 2 * peak_value + right_value
    return float((best_lag + (0.5 * (left_value - right_value) / bend if bend < 0 else 0.0)) / rate_hz)


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two courses where both are known; -1 where one does not change."""
    is_known = np.isfinite(a) & np.isfinite(b)
    if is_known.sum() < 3:
        return -1.0
    x, y = a[is_known] - a[is_known].mean(), b[is_known] - b[is_known].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0 else -1.0
