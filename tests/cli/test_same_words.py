"""`candata validate --scene` and `candata diagnose` say the same of recordings that are no physics."""

from __future__ import annotations

import json

import numpy as np
import pytest

from candata.checks import defects
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.cli.command import run

SCENE = "gripper_tabletop"


@pytest.fixture(scope="module")
def sound():
    """Eight episodes in which three fingertips press on an object."""
    scene = load_scene(SCENE)
    jobs = [EpisodeJob(f"e{i}", i, ("grasp_lift_shake", "push")[i % 2], 5) for i in range(8)]
    return make_episodes(scene, jobs, duration_s=1.5, noise=scene.file.noise)


@pytest.mark.parametrize(
    ("mistake", "fix"),
    [
        ("joints_exchanged", "put the columns of `joint_position` in the order of `joints` in scene.yaml"),
        ("pairs_exchanged", "put the columns of both in the order of `joints` and `actuators` in scene.yaml"),
        ("quaternion_conjugated", "conjugate them before the import: the signs of x, y and z change"),
    ],
)
def test_both_refuse_with_the_same_facts_and_the_same_fix(sound, tmp_path, mistake, fix):
    rng = np.random.default_rng(0)
    data = defects.write(tmp_path / "data", [defects.with_defect(e, mistake, rng) for e in sound])
    validated = run("validate", data, "--scene", SCENE, "--rule", "scene_match", "--json")
    refused = run("diagnose", data, "--scene", SCENE, "--out", tmp_path / "out", "--jobs", 1)
    (finding,) = [f for f in json.loads(validated.out)["findings"] if f["level"] == "error"]
    assert (validated.code, refused.code) == (1, 2)
    assert fix in finding["remedy"]
    lines = refused.err.splitlines()
    assert f"  do: {finding['remedy']}" in lines
    expected = next(line.removeprefix("  expected: ") for line in lines if line.startswith("  expected: "))
    observed = next(line.removeprefix("  found: ") for line in lines if line.startswith("  found: "))
    assert f"expected {expected}, found {observed}" in finding["message"]
    assert "as if" in observed
    assert "fingertip_force" not in refused.err
