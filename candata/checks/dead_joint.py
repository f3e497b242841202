"""Rule: joints follow their commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from candata.checks._drive import pairs
from candata.checks._finding import Finding, Rule
from candata.checks._forces import any_contact, forces
from candata.checks._signal import noise
from candata.checks._view import EpisodeView, round_evidence

#: A command that moves less than this share of its joint's usual way, or less than this [rad or m or 1] asks nothing.
ASKED_SHARE, LEAST_WAY = 0.2, 0.02
#: A joint that moves less than this share of what its command does, beyond noise, stands still.
STILL_SHARE = 0.03
#: Distance to a held command, as a share of its way, from which a joint stops short, where so much is commanded.
SHORT_SHARE, LARGE_WAY = 0.25, 0.1
#: Time for which a command must be held, within this share of its way [s].
HELD_S, HELD_WAY_SHARE = 0.4, 0.02
#: Share of an episode's rows with a touch from which something is held. Chosen.
HELD_SHARE = 0.5
REMEDY = "check motor and encoder; leave the joint out, or mark its rows invalid"


@dataclass(frozen=True)
class _Ways:
    """Ways of joints and commands in an episode, the joints' noise, and how far from held commands joints stop.

    `holds_something` tells whether something is touched most of the time: what fingers hold may stop them.
    """

    id: str
    names: tuple[str, ...]
    joint: np.ndarray
    command: np.ndarray
    noise: np.ndarray
    stop_distance: np.ndarray
    holds_something: bool


def _gather(view: EpisodeView) -> _Ways | None:
    """Return the ways of joints with a command; None where there are none."""
    column_pairs = pairs(view)
    joint, command = view.values("joint_position"), view.values("action")
    if not column_pairs or joint is None or command is None or len(joint) < 10:
        return None
    names = view.elements("joint_position")
    driven_joint, driving_command = joint[:, [j for j, _ in column_pairs]], command[:, [a for _, a in column_pairs]]
    stop_distances = _stop_distances(driven_joint, driving_command, round(HELD_S * view.rate_hz))
    return _Ways(
        view.id,
        tuple(names[j] for j, _ in column_pairs),
        _way(driven_joint),
        _way(driving_command),
        noise(driven_joint),
        stop_distances,
        _holds_something(view),
    )


def _holds_something(view: EpisodeView) -> bool:
    """Tell whether something is touched most of the time, by force where it is known, else by flag."""
    force = forces(view)
    touch = any_contact(view) if force is None else force.touch.any(axis=1)
    return touch is not None and bool(np.nanmean(touch) > HELD_SHARE)


def _way(values: np.ndarray) -> np.ndarray:
    """Return how far each column moves, without the farthest hundredth of rows on either side."""
    low, high = np.nanquantile(values, [0.01, 0.99], axis=0)
    return np.asarray(np.nan_to_num(high - low))


def _stop_distances(joint: np.ndarray, command: np.ndarray, rows: int) -> np.ndarray:
    """Return the distance of joints to commands held for so many rows, its 0.9 quantile; NaN where none was held."""
    if not 2 <= rows < len(command):
        return np.full(joint.shape[1], np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(command, rows, axis=0)
    is_held = windows.max(axis=-1) - windows.min(axis=-1) < HELD_WAY_SHARE * _way(command)
    distances = np.where(is_held, np.abs(command - joint)[rows - 1 :], np.nan)
    return np.asarray(np.nanquantile(distances, 0.9, axis=0))


def _judge(episodes: Sequence[_Ways]) -> Iterator[Finding]:
    """Yield joints that stand still while they are commanded, and those that stop short of their commands."""
    short_shares: dict[str, float] = {}
    for name in dict.fromkeys(n for episode in episodes for n in episode.names):
        members = [(episode, episode.names.index(name)) for episode in episodes if name in episode.names]
        ways = np.array(
            [
                (episode.joint[i], episode.command[i], episode.noise[i], episode.stop_distance[i])
                for episode, i in members
            ]
        ).T
        joint, command, noise_levels, distances = ways
        is_asked = command > max(LEAST_WAY, ASKED_SHARE * float(command.max()))
        is_still = is_asked & (joint < np.maximum(STILL_SHARE * command, np.minimum(8 * noise_levels, 0.1 * command)))
        for k in np.flatnonzero(is_still):
            problem = f"a joint does not follow its command: {name}"
            is_sure = joint[k] == 0 or (
                is_still.sum() == is_asked.sum() > 2 and not all(episode.holds_something for episode, _ in members)
            )
            yield Finding(
                "error" if is_sure else "warning",
                "dead_joint",
                f"{problem}, it moves {joint[k]:.3g} where {command[k]:.3g} is commanded",
                episode=members[k][0].id,
                channel="joint_position",
                problem=problem,
                evidence=round_evidence({"joint": name, "moved": joint[k], "commanded": command[k]}),
                remedy=REMEDY,
            )
        is_judged = np.isfinite(distances) & (command > LARGE_WAY)
        if (
            not is_still.any()
            and is_judged.sum() > 2
            and np.median(distances[is_judged] / command[is_judged]) > SHORT_SHARE
        ):
            short_shares[name] = float(np.median(distances[is_judged] / command[is_judged]))
    if short_shares:
        problem = "joints stop short of commands that are held"
        text = ", ".join(f"{name} by {share:.0%} of the way" for name, share in short_shares.items())
        yield Finding(
            "info",
            "dead_joint",
            f"{problem}: {text}",
            channel="joint_position",
            problem=problem,
            evidence=round_evidence(short_shares),
            remedy="blocked by what they hold or by a limit, weak, or commanded in another unit",
        )


RULE = Rule(
    meaning="joints follow their commands",
    gather=_gather,
    judge=_judge,
    needs=("joint_position", "action"),
    idle_reason="commands and joints do not go by the same names",
)
