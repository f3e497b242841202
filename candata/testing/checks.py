"""What every check keeps: sound data say nothing, its own defect is found and said, and no data break it."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from candata.checks import LEVELS, RULES, Finding, Rule, check
from candata.checks.defects import as_stored, with_arrays, write
from candata.datasets import RawEpisode, open_dataset
from candata.scenes import Scene, load_scene
from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.jobs import possible_policies
from candata.testing._claims import registered_name, require, require_words

Arrays = dict[str, NDArray]


class CheckConformance:
    """Conformance of one check.

    Attributes
    ----------
    rule : Rule
        The constant of the plug-in.
    scenes : tuple of str
        Scenes whose own motions, with their declared noise, are sound data.
    episodes, duration_s : int, float
        How many episodes of each scene, and how long they are.
    """

    rule: ClassVar[Rule]
    scenes: ClassVar[tuple[str, ...]] = ("gripper_tabletop", "cube_toss")
    episodes: ClassVar[int] = 8
    duration_s: ClassVar[float] = 1.8

    def damage(self, arrays: Arrays, rate_hz: float, rng: np.random.Generator) -> Arrays | None:
        """Return an episode's arrays with the defect that the rule must find; None where they cannot have it."""
        raise AssertionError("give the suite a `damage(self, arrays, rate_hz, rng)` that the rule must find")

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it says."""
        require_words(RULES, self.rule)
        unknown_channels = set(self.rule.needs) - set(CHANNELS)
        require(not unknown_channels, f"it needs what is no channel: {', '.join(sorted(unknown_channels))}")
        looks = (self.rule.part, self.rule.episode, self.rule.gather, self.rule.sample)
        default = Rule(meaning="")
        require(looks != (default.part, default.episode, None, None), "it looks at nothing")
        require((self.rule.gather is None) == (self.rule.judge is None), "`gather` and `judge` go together")

    def test_sound_data_say_nothing(self) -> None:
        """A false alarm makes people ignore the next one. What cannot be checked may be said."""
        for name in self.scenes:
            scene, episodes = _sound_episodes(name, self.episodes, self.duration_s)
            for scene_given in (None, scene):
                alarms = [f for f in self._findings(episodes, scene_given) if f.level in ("error", "warning")]
                require(not alarms, f"scene {name}: sound data raise {alarms[:3]}")

    def test_its_own_defect_is_found(self) -> None:
        """In the data of one of the scenes at least, and said in words that can be acted on."""
        findings: list[Finding] = []
        for name in self.scenes:
            scene, episodes = _sound_episodes(name, self.episodes, self.duration_s)
            rng, raws = np.random.default_rng(0), [as_stored(episode) for episode in episodes]
            damaged_arrays = [self.damage(dict(raw.arrays), raw.meta().rate_hz, rng) for raw in raws]
            if any(arrays is not None for arrays in damaged_arrays):
                damaged_raws = [
                    r if a is None else with_arrays(r, a) for r, a in zip(raws, damaged_arrays, strict=True)
                ]
                findings += [f for f in self._findings(damaged_raws, scene) if f.level in ("error", "warning")]
        require(findings, "its defect is not found")
        for finding in findings:
            _require_said(finding, registered_name(RULES, self.rule))

    def test_no_data_break_it(self) -> None:
        """Channels that lack or hold nothing but NaN, and a single row: a finding or nothing, never an exception."""
        for name in self.scenes:
            scene, episodes = _sound_episodes(name, self.episodes, self.duration_s)
            raws = [as_stored(episode) for episode in episodes]
            for break_arrays in (_without_channels, _all_nan, _one_row):
                self._findings([with_arrays(raw, break_arrays(raw.arrays)) for raw in raws], scene)

    def _findings(self, episodes: Sequence[Episode | RawEpisode], scene: Scene | None) -> tuple[Finding, ...]:
        """Return what the rule finds in as_stored episodes."""
        with tempfile.TemporaryDirectory() as folder:
            root = write(Path(folder) / "set", [as_stored(episode) for episode in episodes])
            return check(open_dataset(root, partial=True), rules=[registered_name(RULES, self.rule)], scene=scene)


@cache
def _sound_episodes(name: str, count: int, duration_s: float) -> tuple[Scene, tuple[Episode, ...]]:
    """Return a scene and episodes of its own policies in turn, with its declared noise."""
    scene = load_scene(name)
    motions = possible_policies(scene)
    jobs = [EpisodeJob(f"{motions[k % len(motions)]}-{k}", k, motions[k % len(motions)], 5) for k in range(count)]
    return scene, tuple(make_episodes(scene, jobs, duration_s=duration_s, noise=scene.file.noise))


def _require_said(finding: Finding, name: str) -> None:
    """Claim that a finding can be shown, filtered and acted on."""
    require(finding.rule == name, f"the finding is of {finding.rule!r}, the rule is {name!r}")
    require(finding.level in LEVELS, f"no such level: {finding.level!r}")
    require(finding.message and finding.problem, "the finding has no message, or no problem in words without numbers")
    require(finding.remedy, "the finding does not say what to do (`remedy`)")
    json.dumps(asdict(finding) | {"evidence": dict(finding.evidence)}, allow_nan=False)


def _without_channels(arrays: Mapping[str, NDArray]) -> Arrays:
    """Return nothing but the stamps."""
    return {"time_ns": arrays["time_ns"]}


def _all_nan(arrays: Mapping[str, NDArray]) -> Arrays:
    """Return arrays without one number."""
    return {name: np.full_like(a, np.nan) if a.dtype.kind == "f" else a for name, a in arrays.items()}


def _one_row(arrays: Mapping[str, NDArray]) -> Arrays:
    """Return the first row."""
    return {name: a[:1] for name, a in arrays.items()}
