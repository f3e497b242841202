"""Rule: a channel has one scale throughout the set: no episode is a unit's factor away from the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._scales import reaches, scales
from candata.checks._signal import UNITS, spread, unit_of
from candata.checks._view import EpisodeView, round_evidence

Array = NDArray[np.float64]
#: An episode's id and a channel of it.
_Key = tuple[str, str]
#: Fewest episodes that have a scale, and spreads (of the logarithm) by which one is apart from them.
FEWEST, SPREADS = 5, 5.0
#: Smallest factor that is looked at; nearness to a unit's factor, as a difference of logarithms.
FACTOR, UNIT_NEARNESS = 20.0, 0.5
#: Share of a channel's elements that must be apart in the same way.
ELEMENT_SHARE = 0.6
#: Nearness of the noise's factor to a unit's, as a difference of logarithms: a factor of three.
NOISE_NEARNESS = 1.1
REMEDY = "give the unit of the source in its map, and import these episodes again"


@dataclass(frozen=True)
class _Scales:
    """Sizes of what moves in an episode, how far its values reach, and their noise, by `channel/element`."""

    id: str
    sizes: dict[str, float]
    reach: dict[str, float]
    noise: dict[str, float]


def _gather(view: EpisodeView) -> _Scales | None:
    """Return the sizes of an episode; None where nothing moves."""
    sizes = scales(view)
    return _Scales(view.id, sizes, *reaches(view)) if sizes else None


def _judge(episodes: Sequence[_Scales]) -> Iterator[Finding]:
    """Yield the channels of episodes that are a unit's factor away from the others.

    Commands as far away as the positions of their joints ask for less motion, no more: they are in another unit only
    where those positions are found to be.
    """
    sizes, apart_elements = _compare(episodes)
    units = {key: unit for key in sizes if (unit := _unit(sizes[key], apart_elements[key], key[1]))}
    confirmed_units = {
        key: (ratio, unit)
        for key, (ratio, unit) in units.items()
        if _is_scaled(episodes, key, apart_elements[key], ratio)
    }
    for name, channel in sizes:
        if (
            channel == "action"
            and (name, channel) in confirmed_units
            and (name, "joint_position") not in confirmed_units
        ):
            joint_sizes = sizes.get((name, "joint_position"), {})
            explained_elements = {
                k
                for k in apart_elements[name, channel]
                if abs(sizes[name, channel][k] - joint_sizes.get(k, np.inf)) < UNIT_NEARNESS
            }
            if not _unit(sizes[name, channel], apart_elements[name, channel] - explained_elements, channel):
                del confirmed_units[name, channel]
    for (name, channel), (ratio, unit_name) in confirmed_units.items():
        problem = f"{channel} is on another scale than in the other episodes"
        yield Finding(
            "warning",
            "scale",
            f"{problem}: {ratio:.3g} times, as in {unit_name}",
            episode=name,
            channel=channel,
            problem=problem,
            evidence=round_evidence({"ratio": ratio, "as": unit_name, "elements": len(apart_elements[name, channel])}),
            remedy=REMEDY,
        )


def _compare(episodes: Sequence[_Scales]) -> tuple[dict[_Key, dict[str, float]], dict[_Key, set[str]]]:
    """Return logarithms of the elements' sizes over those of most episodes, and the elements that are apart."""
    sizes: dict[_Key, dict[str, float]] = defaultdict(dict)
    apart_elements: dict[_Key, set[str]] = defaultdict(set)
    for key in sorted({k for episode in episodes for k in episode.sizes}):
        members = [episode for episode in episodes if key in episode.sizes]
        if len(members) < FEWEST:
            continue
        channel, _, element = key.partition("/")
        logs = np.log([episode.sizes[key] for episode in members])
        offsets = logs - np.median(logs)
        # Half the set may be wrong: the spread is that of the half that lies closest together.
        scale = max(_closest_half(logs), 0.5 * spread(logs), 0.05)
        for episode, ratio in zip(members, offsets, strict=True):
            sizes[episode.id, channel][element] = float(ratio)
            if abs(ratio) > max(np.log(FACTOR), SPREADS * scale):
                apart_elements[episode.id, channel].add(element)
    return sizes, apart_elements


def _is_scaled(episodes: Sequence[_Scales], key: _Key, apart_elements: set[str], ratio: float) -> bool:
    """Tell whether an episode's values are scaled by a ratio, not only moved by it: noise tells, else their reach."""
    name, channel = key
    (episode,) = [scales for scales in episodes if scales.id == name]
    keys = {f"{channel}/{element}" for element in apart_elements if element != "distance"}
    for quantity, tolerance in (("noise", NOISE_NEARNESS), ("reach", UNIT_NEARNESS)):
        sizes, set_values = getattr(episode, quantity), [getattr(scales, quantity) for scales in episodes]
        usual_values = {k: np.median([values[k] for values in set_values if k in values]) for k in keys & sizes.keys()}
        if 2 * len(usual_values) > len(keys):
            return bool(
                abs(np.median([np.log(sizes[k] / usual_values[k]) for k in usual_values]) - np.log(ratio)) < tolerance
            )
    return not keys


def _unit(sizes: dict[str, float], apart_elements: set[str], channel: str) -> tuple[float, str] | None:
    """Return the ratio of the elements apart and its unit; None where they are too few, or the ratio is of none."""
    if not apart_elements or len(apart_elements) < ELEMENT_SHARE * len(sizes):
        return None
    ratio = float(np.exp(np.median([sizes[k] for k in apart_elements])))
    unit = unit_of(ratio, UNIT_NEARNESS)
    return (ratio, unit) if unit and _is_possible(channel, unit) else None


def _closest_half(values: Array) -> float:
    """Return a standard deviation by the shortest interval that holds half the values (Rousseeuw 1984)."""
    sorted_values = np.sort(values)
    half_count = len(sorted_values) // 2 + 1
    return float((sorted_values[half_count - 1 :] - sorted_values[: len(sorted_values) - half_count + 1]).min() / 1.349)


def _is_possible(channel: str, unit: str) -> bool:
    """Tell whether a channel may be in a unit: forces in no degrees, places in no gram-force."""
    names = list(UNITS)
    impossible_units = {"fingertip_force": names[-1:], "object_pose": names[2:], "hand_pose": names[2:]}
    return unit not in impossible_units.get(channel, names[2:4])


RULE = Rule(
    meaning="a channel has one scale throughout the set", gather=_gather, judge=_judge, idle_reason="nothing moves"
)
