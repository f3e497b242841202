"""`generate-sim`: wanted outcomes, episodes that are left out, shares of a set, and what a set would take."""

from __future__ import annotations

import json
import re

import pytest

from candata.policies import Policy, policy
from tests.cli.command import exit_code, run


@pytest.fixture
def toss(tmp_path):
    """Words of a small, quick set, and where it goes."""
    out = tmp_path / "set"
    words = ("generate-sim", "--scene", "cube_toss", "--episodes", 2, "--duration-s", 0.2, "--jobs", 1)
    return (*words, "--out", out), out


#: A set of grasps of which each second fails: 0.3 s of work a run.
GRASPS = (
    "generate-sim",
    "--scene",
    "gripper_tabletop",
    "--policies",
    "grasp_lift_shake",
    "--duration-s",
    2,
    "--jobs",
    1,
)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """A set of grasps of which half fail, and what generate-sim said."""
    out = tmp_path_factory.mktemp("mixed") / "set"
    return out, run(
        *GRASPS, "--episodes", 4, "--duration-s", 2, "--outcomes", "success:0.5,fail:0.5", "--json", "--out", out
    )


def test_generate_tells_outcomes(mixed):
    out, said = mixed
    told = json.loads(said.out)
    assert (told["dataset"], told["episodes"], told["quarantined"]) == (str(out), 4, [])
    counts = told["outcomes"]["grasp_lift_shake"]
    assert (counts["success"], sum(counts.values())) == (2, 4)
    assert "outcomes of grasp_lift_shake: success 2 (50 %), " in said.err


def test_a_set_with_outcomes_is_valid_filtered_and_shown(mixed, tmp_path, capsys):
    out, _ = mixed
    assert exit_code("validate", out) == 0
    assert exit_code("registry", "filter", out, "outcome != 'success'", "--out", tmp_path / "failed") == 0
    capsys.readouterr()
    assert exit_code("inspect", tmp_path / "failed", "--json") == 0
    (counts,) = json.loads(capsys.readouterr().out)["outcomes"].values()
    assert "success" not in counts
    assert sum(counts.values()) == 2
    page = tmp_path / "page.html"
    assert exit_code("inspect", out, "--html", page) == 0
    assert "outcomes of grasp_lift_shake: success 2 (50 %), " in capsys.readouterr().out
    assert "<h2>Outcomes</h2>" in page.read_text()


@pytest.fixture
def burying():
    """A policy that throws the cube, or puts it into the floor, as the seed decides."""

    def plan(scene, rng, duration_s):
        made = policy("toss").plan(scene, rng, duration_s)
        made.qpos[2] = -0.05 if rng.random() < 0.3 else made.qpos[2]
        return made

    return lambda _name: Policy("throw the object, or bury it", lambda scene: True, plan)


def test_generate_tells_what_it_left_out(toss, burying, monkeypatch, capsys):
    words, out = toss
    monkeypatch.setattr("candata.simulate.episodes.policy", burying)
    assert exit_code(*words, "--episodes", 20, "--json") == 0
    said = capsys.readouterr()
    left_out = json.loads(said.out)["quarantined"]
    assert len(left_out) + json.loads(said.out)["episodes"] == 20
    assert {e["problem"] for e in left_out} == {"the object starts inside table"}
    assert f"left out: {len(left_out)} episodes, each with its reason in {out}/quarantine\n" in said.err
    assert f"  the object starts inside table: {len(left_out)}, first {left_out[0]['id']} (" in said.err
    assert exit_code(*words, "--episodes", 20, "--seed", 2, "--strict") == 2
    assert capsys.readouterr().err.startswith("the object starts inside table\n")


def test_a_dry_run_makes_nothing(toss, capsys):
    words, out = toss
    assert exit_code(*words, "--dry-run") == 0
    said = capsys.readouterr().out
    assert re.fullmatch(
        r"tasks: toss 2\nobjects: object 2\n2 episodes, 60 rows, 600 steps of physics\n"
        r"0 s with 1 process, \S+ GB \(measured on 1 episodes\)\n",
        said,
    )
    assert not out.exists()
    assert exit_code("generate-sim", "--scene", "cube_toss", "--episodes", 2, "--dry-run", "--json") == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--outcomes", "success:0.5"), "the shares of --outcomes do not sum to 1"),
        (("--outcomes", "lost"), "unknown outcome 'lost'"),
        (("--outcomes", "success"), "policy toss has no goal"),
        (("--shard", "3/2"), "there is no such shard"),
        (("--shard", "half"), "--shard cannot be read"),
    ],
)
def test_a_mix_or_shard_that_is_none_is_one_error(toss, capsys, words, text):
    asked, out = toss
    assert exit_code(*asked, *words) == 2
    assert capsys.readouterr().err.startswith(text)
    assert not out.exists()
