"""`candata validate`: what it prints, how it exits, the page it writes, and what a wrong argument says."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from candata.checks import Finding, defects, group_findings
from candata.datasets import append, create_dataset
from candata.errors import DataError, SceneError, SetupError, UnknownNameError, UsageError
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata_cli.validate_command import _row, register

app = typer.Typer()
register(app)


app.callback()(lambda: None)  # an application of one command would not take its name


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


def smooth(name, seed=0, **meta):
    """An episode in which nothing is wrong: a joint that follows, an object that is pushed along."""
    rng = np.random.default_rng(seed)
    t = np.arange(160) / 80
    command = 0.3 * np.sin(2 * np.pi * (t[:, None] + rng.uniform(0, 1, 2)))
    pose = np.tile([0.1, 0.0, 0.05, 1.0, 0, 0, 0], (160, 1))
    pose[:, 0] += 0.02 * t + rng.normal(0, 1e-4, 160)
    arrays = {
        "time_ns": (t * 1e9).astype(np.int64),
        "object_pose": pose,
        "action": command,
        "joint_position": np.concatenate([command[:1], command[:1], command[:-2]]) + rng.normal(0, 1e-4, (160, 2)),
    }
    fields = {"source": "sim", "rate_hz": 80.0, "joint_names": ("a", "b"), "actuator_names": ("a", "b")} | meta
    return Episode(EpisodeMeta.model_validate({"id": name, **fields}), arrays)


@pytest.fixture
def root(tmp_path):
    root = create_dataset(tmp_path / "ds")
    append(root, [smooth(f"e{i}", seed=i) for i in range(4)], Lineage(operation="test"))
    return root


@pytest.fixture
def bad(tmp_path):
    episodes = [smooth(f"e{i}", seed=i) for i in range(5)]
    return defects.write(
        tmp_path / "bad", defects.inject(episodes, "quaternion_not_unit", np.random.default_rng(0), 0.8)
    )


def test_one_line_when_all_is_well_and_then_what_could_not_be_checked(root):
    result = run("validate", root)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[0] == "4 episodes, no findings"
    assert "no scene was given (--scene): joint_limits, penetration, proximity" in result.stdout


def test_findings_are_one_line_a_kind_with_the_first_episodes(bad):
    result = run("validate", bad)
    assert result.exit_code == 1
    head, line, remedy = result.stdout.splitlines()[:3]
    assert head.split() == ["level", "rule", "channel", "episodes", "what"]
    assert line.startswith("error  quaternions  object_pose  4 of 5")
    assert "norm 1.1, expected 1" in line
    assert line.endswith("and 1 more]")
    assert remedy.startswith("to do: quaternions: ")


def test_what_concerns_the_set_is_said_of_each_element():
    told = [
        Finding("info", "velocities", f"still: {name}", channel="joint_velocity", problem="still")
        for name in ("left", "right")
    ]
    (group,) = group_findings(told)
    assert _row(group, 5) == ("info", "velocities", "joint_velocity", "the set", "still: left; right")


def test_json_holds_every_finding_and_what_was_asked(bad):
    result = run("validate", bad, "--json")
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert (found["dataset"], found["episodes"], found["version"], found["deep"], found["scene"]) == (
        "bad",
        5,
        1,
        False,
        None,
    )
    errors = [f for f in found["findings"] if f["level"] == "error"]
    assert found["counts"]["error"] == len(errors) == 4
    assert set(errors[0]) == {
        "level",
        "rule",
        "message",
        "episode",
        "channel",
        "index",
        "problem",
        "ranges",
        "evidence",
        "remedy",
    }
    assert errors[0]["evidence"] == {"rows": 160, "median_norm": pytest.approx(1.1)}


@pytest.mark.parametrize(("fail_on", "code"), [("error", 0), ("warning", 1), ("info", 1), ("unknown", 1)])
def test_fail_on_says_what_is_bad_enough(tmp_path, fail_on, code):
    root = create_dataset(tmp_path / "ds")
    append(root, [smooth("a", rate_hz=100.0)], Lineage(operation="test"))  # the rate is stated wrong: a warning
    assert run("validate", root, "--fail-on", fail_on, "--rule", "time").exit_code == code


def test_unknown_alone_fails_only_when_asked(root):
    assert run("validate", root, "--fail-on", "info", "--rule", "penetration").exit_code == 0
    assert run("validate", root, "--fail-on", "unknown", "--rule", "penetration").exit_code == 1


def test_only_the_rules_that_were_asked_for(bad):
    assert run("validate", bad, "--rule", "time", "--rule", "finite").stdout == "5 episodes, no findings\n"


def test_deep_finds_what_sizes_do_not_tell(root):
    (path,) = root.glob("parts/*/episodes.parquet")
    data = bytearray(path.read_bytes())
    data[-30] ^= 1  # in the footer, beside the rows
    path.write_bytes(bytes(data))
    result = run("validate", root, "--deep")
    assert result.exit_code == 1
    assert "episodes.parquet: " in result.stdout


def test_a_version_can_be_chosen(root):
    append(root, [smooth("later", seed=9)], Lineage(operation="more"))
    assert run("validate", root, "--version", "1").stdout.startswith("4 episodes")
    assert run("validate", root).stdout.startswith("5 episodes")


def test_wrong_arguments_are_errors_that_say_what_is_known(root, tmp_path):
    assert isinstance(run("validate", tmp_path / "none").exception, UsageError)
    assert isinstance(run("validate", create_dataset(tmp_path / "empty")).exception, DataError)
    assert isinstance(run("validate", root, "--rule", "tim").exception, UnknownNameError)
    assert "did you mean 'warning'" in str(run("validate", root, "--fail-on", "warnings").exception)
    assert isinstance(run("validate", root, "--scene", "no_such").exception, UnknownNameError | SceneError)


def test_a_scene_of_other_joints_is_unknown_not_wrong(root):
    result = run("validate", root, "--scene", "xhand_tabletop", "--rule", "joint_limits", "--rule", "penetration")
    assert result.exit_code == 0
    assert "the joints are none of the scene's: joint_limits" in result.stdout


def test_the_page_is_written_whole_and_asks_for_nothing(bad, tmp_path):
    page = tmp_path / "out" / "page.html"
    result = run("validate", bad, "--html", page)
    text = page.read_text("utf-8")
    assert result.exit_code == 1
    assert "Errors found" in text
    assert "4 of 5 episodes" in text
    assert "normalise them at the source" in text
    assert "http" not in text.replace("http-equiv", "")
    assert sorted(p.name for p in page.parent.iterdir()) == ["page.html"]


def test_a_page_without_errors_frightens_nobody(root, tmp_path):
    page = tmp_path / "page.html"
    assert run("validate", root, "--html", page).exit_code == 0
    text = page.read_text("utf-8")
    assert ">No errors found<" in text
    assert "Do not use these episodes" not in text
    assert "Each rule that was applied is kept." in text
    assert "not checked:" not in text, "the heading says it"


def test_names_in_the_data_cannot_break_the_page(tmp_path):
    name = "<script>alert(1)</script>"
    raws = defects.inject([smooth(name)], "quaternion_not_unit", np.random.default_rng(0))
    page = tmp_path / "page.html"
    run("validate", defects.write(tmp_path / "bad", raws), "--html", page)
    assert "<script>alert" not in page.read_text("utf-8")
    assert "&lt;script&gt;alert" in page.read_text("utf-8")


def test_a_page_that_cannot_be_written_is_an_error(root, tmp_path):
    (tmp_path / "file").write_text("x")
    assert isinstance(run("validate", root, "--html", tmp_path / "file" / "page.html").exception, SetupError)
    assert isinstance(run("validate", root, "--html", tmp_path).exception, UsageError)
