"""What an emulated hand says: the rows of an episode as the counts and frames of a device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UsageError, Where
from candata.record.devices import Device, Encoder
from candata.record.devices._wire import wire_time_ns
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Episode, EpisodeMeta

#: The taxels lie in rows of ten; a press spreads over them as a Gaussian of this width [taxels] about the middle.
#: The taxels' places are not published: a fixed pattern that reaches many of them is all that a test needs.
ROW_OF_TAXELS, SPREAD = 10, 1.5
#: Channels of an episode that an emulated hand, or a stream beside it, sends.
PLAYED = ("joint_position", "action", "fingertip_force", "object_pose")
#: Its frames are made before the first is sent.
STILL_MAX_S = 600.0


@dataclass(frozen=True)
class Script:
    """Rows to be sent, a still stretch first.

    Attributes
    ----------
    meta : EpisodeMeta
        Of the episode that is played.
    device : Device
        Whose frames these are.
    encoder : Encoder
        What wrote them.
    rate_hz : float
        Rows a second.
    newton_per_count : float
        Scale of the counts.
    rest_rows : int
        Rows of the still stretch.
    row : (n,) int64
        Row of the episode.
    joint_position, joint_target : (n, J) float32 [rad]
        Of the device's joints, as sent.
    force : (n, F, 3) float64 [N]
        Before it is counted.
    force_counts, taxel_counts : (n, F, 3), (n, F, taxels, 3) int16
        As sent.
    force_clipped, taxels_clipped : (n,) int64
        Numbers of counts that were out of the device's range.
    unwired_channels : dict of str to (n, k) float64
        `joint_position`, `action`, `object_pose`: what the wire does not carry.
    unwired_joints, unwired_actuators : tuple of str
        Names of those joints and actuators.
    commands, states : tuple of bytes
        The frames.
    """

    meta: EpisodeMeta
    device: Device
    encoder: Encoder
    rate_hz: float
    newton_per_count: float
    rest_rows: int
    row: NDArray[np.int64]
    joint_position: NDArray[np.float32]
    joint_target: NDArray[np.float32]
    force: NDArray[np.float64]
    force_counts: NDArray[np.int16]
    taxel_counts: NDArray[np.int16]
    force_clipped: NDArray[np.int64]
    taxels_clipped: NDArray[np.int64]
    unwired_channels: dict[str, NDArray[np.float64]]
    unwired_joints: tuple[str, ...]
    unwired_actuators: tuple[str, ...]
    commands: tuple[bytes, ...]
    states: tuple[bytes, ...]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.row)


def tip_pattern(taxels: int) -> NDArray[np.float64]:
    """Return `(taxels,) float64`: the share of a fingertip's force that each taxel feels; they sum to 1, if any.

    Taxel i lies at row i // 10, column i % 10; its share is a Gaussian of 1.5 taxels about the middle of the rows.
    """
    if not taxels:
        return np.zeros(0)
    row, column = np.divmod(np.arange(taxels), ROW_OF_TAXELS)
    square = (row - row.max() / 2) ** 2 + (column - column.max() / 2) ** 2
    share = np.exp(-square / (2 * SPREAD**2))
    return share / share.sum()


def to_counts(force: NDArray, device: Device, newton_per_count: float) -> tuple[NDArray[np.int16], NDArray[np.int64]]:
    """Return forces as the device counts them, and how many counts of each row its range clipped.

    Parameters
    ----------
    force : ndarray
        `(n, ..., 3) float [N]`.
    device : Device
        Gives the range of a count.
    newton_per_count : float
        Scale.
    """
    # To a millionth first: the noise of float32 must not decide halves, nor make a half below zero a clipped count.
    counts = np.rint(np.round(force / newton_per_count, 6))
    clipped_counts = np.clip(counts, device.count_low, device.count_high)
    clip_count = (clipped_counts != counts).sum(axis=tuple(range(1, force.ndim)))
    return clipped_counts.astype(np.int16), clip_count.astype(np.int64)


def write_script(
    episode: Episode,
    device_name: str,
    device: Device,
    *,
    rate_hz: float | None = None,
    still_s: float = 3.5,
    newton_per_count: float | None = None,
) -> Script:
    """Return what an emulated device sends to play `episode`.

    Parameters
    ----------
    episode : Episode
        With the device's joints, actuators and fingertips among its own, by name.
    device_name, device : str, Device
        The device and its registered name.
    rate_hz : float, optional
        Rows a second; the episode's own by default.
    still_s : float
        Time for which the first row is held before, untouched.
    newton_per_count : float, optional
        Scale of the forces; the device's default by default.

    Raises
    ------
    UsageError
        When the device cannot be emulated, the episode lacks one of its parts, or a number makes no sense.
    DataError
        When the episode lacks a channel or has gaps in one.
    """
    encoder = encoder_of(device_name, device)
    rate = episode.meta.rate_hz if rate_hz is None else rate_hz
    scale = device.newton_per_count if newton_per_count is None else newton_per_count
    joints = _places("joints", device.joint_names, episode.meta.joint_names, episode)
    actuators = _places("actuators", device.joint_names, episode.meta.actuator_names, episode)
    tips = _places("fingertips", device.fingertip_names, episode.meta.fingertip_names, episode)
    _check_numbers(rate, still_s, scale, encoder, device)
    rest_rows = round(still_s * rate)
    row = np.concatenate([np.zeros(rest_rows, np.int64), np.arange(len(episode))])
    position, action = (
        _complete_channel(episode, "joint_position"),
        _next_actions(_complete_channel(episode, "action"), episode.meta),
    )
    recorded_force = _complete_channel(episode, "fingertip_force")[:, tips] if tips else np.zeros((len(episode), 0, 3))
    force = recorded_force[row].astype(np.float64)
    force[:rest_rows] = 0
    force_counts, force_clipped = to_counts(force, device, scale)
    shares = tip_pattern(device.taxels)[:, None]
    taxel_counts, taxels_clipped = to_counts(force[:, :, None] * shares, device, scale)
    wire_values = position[row][:, joints], action[row][:, actuators]
    unwired_joints = [k for k in range(position.shape[1]) if k not in joints]
    unwired_actuators = [k for k in range(action.shape[1]) if k not in actuators]
    unwired_channels = {"joint_position": position[row][:, unwired_joints], "action": action[row][:, unwired_actuators]}
    if "object_pose" in episode:
        unwired_channels["object_pose"] = _complete_channel(episode, "object_pose")[row]
    return Script(
        meta=episode.meta,
        device=device,
        encoder=encoder,
        rate_hz=rate,
        newton_per_count=scale,
        rest_rows=rest_rows,
        row=row,
        joint_position=wire_values[0].astype(np.float32),
        joint_target=wire_values[1].astype(np.float32),
        force=force,
        force_counts=force_counts,
        taxel_counts=taxel_counts,
        force_clipped=force_clipped,
        taxels_clipped=taxels_clipped,
        unwired_channels={name: block.astype(np.float64) for name, block in unwired_channels.items() if block.shape[1]},
        unwired_joints=tuple(episode.meta.joint_names[k] for k in unwired_joints),
        unwired_actuators=tuple(episode.meta.actuator_names[k] for k in unwired_actuators),
        commands=tuple(encoder.command_frames(wire_values[1])),
        states=tuple(encoder.state_frames(wire_values[0], force_counts, taxel_counts)),
    )


def joined(episodes: Sequence[Episode], rest_s: float) -> Episode:
    """Return the episodes one after the other, with rests between, and at the end a rest in the first row of all.

    In a rest the hand is untouched and stands in the first row of what comes next.

    Parameters
    ----------
    episodes : sequence of Episode
        At least one; of one hand, scene and rate.
    rest_s : float
        Time of a rest; it has a row at least.

    Raises
    ------
    UsageError
        When the rest is no time, or the episodes are of different hands, scenes or rates.
    """
    if not 0 <= rest_s < float("inf"):
        raise UsageError("the rest between episodes is no time", expected="0 s or more", found=f"{rest_s:g}")
    first = episodes[0]
    for other in episodes[1:]:
        for field in ("scene", "rate_hz", "joint_names", "actuator_names", "fingertip_names", "action"):
            if getattr(other.meta, field) != getattr(first.meta, field):
                raise UsageError(
                    "the episodes do not play one after the other",
                    expected=f"{field} {getattr(first.meta, field)}, as {first.meta.id}",
                    found=str(getattr(other.meta, field)),
                    where=Where(episode=other.meta.id),
                    fix="name one with --episode",
                )
    rest_rows = max(1, round(rest_s * first.meta.rate_hz))
    arrays = {name: _joined_channel(name, episodes, rest_rows) for name in PLAYED if all(name in e for e in episodes)}
    arrays["time_ns"] = np.round(np.arange(len(arrays["joint_position"])) * 1e9 / first.meta.rate_hz).astype(np.int64)
    tasks = {episode.meta.task for episode in episodes}
    meta = first.meta.model_copy(update={} if len(tasks) == 1 else {"task": None})
    return Episode(meta, arrays)


def _joined_channel(name: str, episodes: Sequence[Episode], rest_rows: int) -> NDArray:
    """Return a channel of episodes, each followed by a rest."""
    values = [_complete_channel(episode, name) for episode in episodes]
    parts = []
    for episode_values, next_values in zip(values, [*values[1:], values[0]], strict=True):
        rest = np.repeat(next_values[:1], rest_rows, axis=0)
        parts += [episode_values, np.zeros_like(rest) if name == "fingertip_force" else rest]
    return np.concatenate(parts)


def encoder_of(name: str, device: Device) -> Encoder:
    """Return what writes the frames of a device, which is registered as `name`.

    Raises
    ------
    UsageError
        When it has none.
    """
    if device.encoder is None:
        raise UsageError(f"{name} cannot be emulated", expected="a device with an encoder")
    return device.encoder


def ceiling_hz(encoder: Encoder, device: Device) -> float:
    """Return the rate at which requests and replies fill the wire [Hz]."""
    joints, tips = len(device.joint_names), len(device.fingertip_names)
    zeros = np.zeros((1, joints)), np.zeros((1, tips, 3), int), np.zeros((1, tips, device.taxels, 3), int)
    size = len(encoder.command_frames(zeros[0])[0]) + len(encoder.state_frames(*zeros)[0])
    return 1e9 / wire_time_ns(size, device.baud)


def _check_numbers(rate_hz: float, still_s: float, scale: float, encoder: Encoder, device: Device) -> None:
    """Refuse a rate, a still stretch or a scale that makes no sense."""
    ceiling = ceiling_hz(encoder, device)
    if not 0 < rate_hz <= ceiling:
        raise UsageError(
            "the wire cannot carry this rate",
            expected=f"above 0, at most {ceiling:.0f} Hz",
            found=f"{rate_hz:g} Hz",
            fix="give a --rate that request and reply fit in",
        )
    if not 0 <= still_s <= STILL_MAX_S:
        raise UsageError(
            "the still stretch has a wrong length", expected=f"0 to {STILL_MAX_S:g} s", found=f"{still_s:g} s"
        )
    if not 0 < scale < np.inf:
        raise UsageError("the scale of the forces is wrong", expected="more than 0 N a count", found=f"{scale:g}")


def _places(kind: str, device_names: tuple[str, ...], episode_names: tuple[str, ...], episode: Episode) -> list[int]:
    """Return where the device's parts are among the episode's."""
    absent_names = [name for name in device_names if name not in episode_names]
    if absent_names:
        raise UsageError(
            f"the episode lacks {kind} of the device",
            expected=", ".join(absent_names),
            found=", ".join(episode_names) or "no names",
            where=Where(episode=episode.meta.id),
            fix="take an episode of a scene with this hand, such as xhand_tabletop",
        )
    return [episode_names.index(name) for name in device_names]


def _complete_channel(episode: Episode, channel: str) -> NDArray:
    """Return a channel that has no gaps."""
    invalid = int((~episode.valid(channel)).sum())
    if invalid:
        raise DataError(
            f"{channel} has gaps, and a hand cannot send them",
            found=f"{invalid} invalid rows",
            where=Where(episode=episode.meta.id, channel=channel + VALID_SUFFIX),
            fix="take an episode without gaps",
        )
    return episode[channel]


def _next_actions(action: NDArray, meta: EpisodeMeta) -> NDArray:
    """Return the actions such that row k is held from row k on; the last is held where the episode says no more."""
    return action if meta.action == "next" else np.concatenate([action[1:], action[-1:]])
