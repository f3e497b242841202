"""Clean simulated sets of every built-in scene, made once; and a way to check episodes that need no disk."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from candata.checks import check, rule_names
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes


def simulated(scene, count, noise=True, seed=5, effects=(), duration_s=3.2):
    """Episodes of a scene's own policies in turn."""
    names = [scene.policies[i % len(scene.policies)] for i in range(count)]
    jobs = [
        EpisodeJob(id=f"{name}-{i}", index=i, policy=name, seed=seed, effects=tuple(effects))
        for i, name in enumerate(names)
    ]
    return make_episodes(scene, jobs, duration_s=duration_s, noise=scene.file.noise if noise else None)


@pytest.fixture(scope="session")
def hand_scene():
    return load_scene("xhand_tabletop")


@pytest.fixture(scope="session")
def toss_scene():
    return load_scene("cube_toss")


@pytest.fixture(scope="session")
def light_scene():
    return load_scene("gripper_tabletop")


@pytest.fixture(scope="session")
def light(light_scene):
    """Twelve episodes of a light scene with the declared noise."""
    return simulated(light_scene, 12, duration_s=1.8)


@pytest.fixture(scope="session")
def hand(hand_scene):
    """Ten episodes, two of each motion, with the declared noise."""
    return simulated(hand_scene, 10)


@pytest.fixture(scope="session")
def tosses(toss_scene):
    """Sixteen tosses with the declared noise."""
    return simulated(toss_scene, 16)


@pytest.fixture(scope="session")
def judged():
    """Findings above info of stored episodes, without files: `judged(raws, scene=None, rules=None)`."""

    def look(raws, scene=None, rules=None):
        raws = list(raws)
        part = SimpleNamespace(rows=lambda: [{"row_group": 0}], group=lambda number, rows: raws)
        dataset = SimpleNamespace(file=SimpleNamespace(exclusions=()), raw_parts=lambda: [part])
        content = [name for name in rules or rule_names() if name != "hashes"]
        return [f for f in check(dataset, rules=content, scene=scene) if f.level in ("error", "warning")]

    return look
