"""Is the scene fit for a blind check: joints follow their targets, every effect moves a channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError
from candata.gap.blind.draws import draw_setting, possible_effects
from candata.gap.data.lag import drives
from candata.policies import command_limits
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode
from candata.simulate.episodes import EpisodeJob, make_episodes, tried_episodes
from candata.simulate.jobs import possible_policies

#: A joint is moved where its command spans more than this share of its range. Command noise alone, 0.004 of the range
#: (1 sd), spans 0.04 at most, and faster than a soft servo follows.
MOVING = 0.05
#: Longest lag within which a joint has to follow [s], and the correlation that counts as following. In free sweeps of
#: three hands: soft servos whose fingers touch each other 0.57 and more (150 seeds), reversed ones 0.26 at most.
LAG_S, FOLLOWS = 0.15, 0.4
#: A joint that moves by less than this share of its target's span is held.
STILL = 0.1
#: Smallest largest change of a channel, in its own unit, that counts as a change at all.
MOVES = 1e-3
COMPARED = ("joint_position", "object_pose", "fingertip_force")


@dataclass(frozen=True)
class Fitness:
    """What a check of a scene found.

    Attributes
    ----------
    moving : int
        Driven joints that the motions move.
    follows : float
        Smallest correlation of these with their targets; NaN without any.
    worst : str
        The joint whose correlation that is; empty without any.
    moved : dict of str to float
        Largest change of a channel that each effect makes, in the channel's unit; 0 where MuJoCo cannot step it.
    """

    moving: int
    follows: float
    worst: str
    moved: dict[str, float]

    @property
    def live(self) -> tuple[str, ...]:
        """Effects that move a channel; no other can be asked of a diagnosis."""
        return tuple(name for name, change in self.moved.items() if change >= MOVES)

    @property
    def dead(self) -> tuple[str, ...]:
        """Effects that move nothing in these motions, or so much that they cannot be simulated."""
        return tuple(name for name in self.moved if name not in self.live)


def check_scene(scene: Scene, *, seed: int, duration_s: float, only: Sequence[str] = ()) -> Fitness:
    """Return how the scene does on one motion of each policy, and with each effect at a drawn value.

    Raises
    ------
    SceneError
        When moving joints do not follow: accuracy proves no sane scene.
    DataError
        When MuJoCo cannot step the nominal scene.
    """
    names, policies = possible_effects(scene, only), possible_policies(scene)
    rng = np.random.default_rng(seed)
    nominal = make_episodes(scene, _jobs(policies, (), seed), duration_s=duration_s)
    following = [pair for episode in nominal for pair in _following(scene, episode)]
    least, worst = min(following, default=(float("nan"), ""))
    found = Fitness(
        len({joint for _, joint in following}),
        least,
        worst,
        {
            name: _moved(scene, nominal, _jobs(policies, (draw_setting(scene, name, rng),), seed), duration_s)
            for name in names
        },
    )
    if following and found.follows < FOLLOWS:
        raise SceneError(
            f"joints of scene {scene.name} do not follow their targets",
            expected=f"correlation of at least {FOLLOWS:g} within {LAG_S:g} s",
            found=f"{found.follows:.2f} at joint {found.worst}",
            fix="check the actuators' gains and the order of joints and actuators",
        )
    return found


def _jobs(policies: Sequence[str], world: tuple[EffectSetting, ...], seed: int) -> list[EpisodeJob]:
    """Return one episode of each policy in a world."""
    return [EpisodeJob(f"check-{i}", i, name, seed, world) for i, name in enumerate(policies)]


def _following(scene: Scene, episode: Episode) -> list[tuple[float, str]]:
    """Return the best correlation, over lags, of each servo's joint that moves in free motion with its target."""
    if "action" not in episode or ("contact" in episode and episode["contact"].any()):
        return []
    lags, servos = range(round(LAG_S * scene.file.rate_hz) + 1), drives(scene)
    target, read = servos.targets(episode["action"]), episode["joint_position"][:, servos.joints]
    moved = np.ptp(episode["action"], axis=0) > MOVING * np.ptp(command_limits(scene), axis=1)
    names = [scene.file.joints[j] for j in servos.joints]
    return [(_correlation(target[:, s], read[:, s], lags), names[s]) for s in np.flatnonzero(moved[servos.columns])]


def _correlation(target: NDArray[np.float64], read: NDArray[np.float64], lags: range) -> float:
    """Return the largest correlation over lags; 0 for a joint that hardly moves."""
    if np.ptp(read) < STILL * np.ptp(target):
        return 0.0
    return max(float(np.corrcoef(target[: len(target) - k], read[k:])[0, 1]) for k in lags)


def _moved(scene: Scene, nominal: list[Episode], jobs: Sequence[EpisodeJob], duration_s: float) -> float:
    """Return the largest change of a compared channel in a world; 0 where MuJoCo gives it up."""
    other, fails = tried_episodes(scene, jobs, duration_s=duration_s)
    if np.isfinite(fails).any():
        return 0.0
    pairs = [(a[c], b[c]) for a, b in zip(nominal, other, strict=True) for c in COMPARED if c in a]
    return max((float(np.abs(a - b).max()) for a, b in pairs), default=0.0)
