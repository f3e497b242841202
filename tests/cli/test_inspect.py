from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from candata.datasets import append, create_dataset
from candata.errors import DataError, SetupError, UnknownNameError, UsageError
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata_cli.inspect_command import register

app = typer.Typer(callback=lambda: None)
register(app)


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    episodes = [episode(f"e{i}", seed=i, rows=40, object="cup") for i in range(3)]
    append(root, [*episodes, episode("r", source="real", contact=False)], Lineage(operation="test"))
    return root


def damage(root):
    path = max(root.glob("parts/*/steps.parquet"), key=lambda p: p.stat().st_size)
    data = path.read_bytes()
    path.write_bytes(data[:1000] + bytes([data[1000] ^ 0xFF]) + data[1001:])


def test_inspect_json_says_what_is_in_it(root):
    found = json.loads(run("inspect", root, "--json").stdout)
    assert (found["name"], found["version"], found["versions"]) == ("ds", 1, 1)
    assert (found["episodes"], found["rows"]) == (4, 140)
    assert found["duration_s"] == pytest.approx(3 * 39 / 80 + 19 / 80)
    assert (found["sources"], found["objects"]) == ({"sim": 3, "real": 1}, {"cup": 3})
    assert [(c["name"], c["unit"], c["episodes"]) for c in found["channels"]] == [
        ("time_ns", "ns", 4),
        ("object_pose", "m", 4),
        ("joint_position", "joint", 4),
        ("fingertip_force", "N", 4),
        ("contact", "1", 3),
    ]
    assert found["contact_share"] == 0.5
    assert found["phases"] == {"free": 0.5, "onset": 0.2, "sustained": 0.3, "release": 0.0}
    assert found["lineage"][0]["operation"] == "test"


def test_inspect_for_people(root):
    result = run("inspect", root)
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[1] == "4 episodes, 140 rows, 1.7 s"
    assert lines[2:6] == ["sources: real 1, sim 3", "scenes: s 4", "objects: cup 3", "tasks: not stated"]
    assert lines[-3:] == [
        "contact: any 50.0%",
        "phases: free 50.0%, onset 20.0%, sustained 30.0%, release 0.0%",
        "lineage: test",
    ]
    assert "(T, 2, 3)" in result.stdout


def test_inspect_leaves_out_what_is_invalid_and_knows_fingertips(tmp_path, episode):
    base = episode("a", fingertip_names=("thumb", "index"))
    valid = np.arange(len(base)) < 15
    arrays = dict(base.arrays) | {
        "joint_position": np.where(valid[:, None], np.ones(2), np.nan),
        "joint_position_valid": valid,
        "fingertip_contact": np.tile([True, False], (len(base), 1)),
    }
    del arrays["contact"]
    root = create_dataset(tmp_path / "ds")
    append(root, [Episode(base.meta, arrays)], Lineage(operation="test"))
    found = json.loads(run("inspect", root, "--json").stdout)
    joint = next(c for c in found["channels"] if c["name"] == "joint_position")
    assert (joint["low"], joint["high"], joint["invalid_share"]) == (1.0, 1.0, 0.25)
    assert found["fingertip_contact_shares"] == {"thumb": 1.0, "index": 0.0}
    assert found["contact_share"] == 1.0


def test_inspect_without_contact_says_so(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a", contact=False)], Lineage(operation="test"))
    assert "contact: not known\n" in run("inspect", root).stdout


def test_inspect_of_a_damaged_dataset_is_an_error(root):
    damage(root)
    assert isinstance(run("inspect", root).exception, DataError)


def test_no_dataset_and_an_empty_one_are_errors(tmp_path):
    assert isinstance(run("inspect", tmp_path / "none").exception, UsageError)
    assert isinstance(run("inspect", create_dataset(tmp_path / "ds")).exception, DataError)


def test_inspect_of_one_episode(root):
    found = json.loads(run("inspect", root, "--episode", "e1", "--json").stdout)
    assert (found["episode"]["id"], found["episodes"], found["rows"]) == ("e1", 1, 40)
    lines = run("inspect", root, "--episode", "r").stdout.splitlines()
    assert lines[1:3] == ["episode r: real, s, 80 Hz", "1 episodes, 20 rows, 0.2 s"]


def test_an_unknown_episode_names_the_nearest(root, tmp_path):
    error = run("inspect", root, "--episode", "e11", "--html", tmp_path / "p.html").exception
    assert isinstance(error, UnknownNameError)
    assert "one of e0, e1, e2, r" in str(error)
    assert "did you mean 'e1'?" in str(error)
    assert not (tmp_path / "p.html").exists()


def test_of_many_episodes_only_the_nearest_are_named():
    error = UnknownNameError("episode", "e77x", [f"e{i}" for i in range(1000)])
    assert "1,000, the nearest e77" in str(error)
    assert len(str(error)) < 300


def test_inspect_writes_a_page_beside_what_it_prints(root, tmp_path):
    result = run("inspect", root, "--html", tmp_path / "new" / "p.html")
    assert result.stdout == run("inspect", root).stdout
    assert "p.html" in result.stderr
    assert (tmp_path / "new" / "p.html").read_text("utf-8").startswith("<!DOCTYPE html>")
    run("inspect", root, "--episode", "e1", "--html", tmp_path / "one.html")
    assert "One episode of" in (tmp_path / "one.html").read_text("utf-8")


def test_two_datasets_side_by_side(root, tmp_path, episode):
    other = create_dataset(tmp_path / "other")
    append(other, [episode(f"o{i}", seed=10 + i, rows=40) for i in range(4)], Lineage(operation="test"))
    result = run("inspect", root, "--against", other, "--html", tmp_path / "p.html")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].startswith("ds@")
    assert lines[1].startswith("other@")
    assert lines[2].startswith("No statistic differs")
    assert lines[3].split()[:5] == ["statistic", "of", "unit", "ds", "other"]
    assert "ds <small>beside</small> other" in (tmp_path / "p.html").read_text("utf-8")
    record = json.loads(run("inspect", root, "--against", other, "--json").stdout)
    assert {row["differs"] for row in record["rows"]} == {False}
    assert record["this"]["compared"] == 4


def test_an_episode_and_another_dataset_do_not_go_together(root):
    assert isinstance(run("inspect", root, "--against", root, "--episode", "e1").exception, UsageError)


def test_a_page_where_none_can_be_is_one_error(root, tmp_path):
    (tmp_path / "file").write_text("x")
    error = run("inspect", root, "--html", tmp_path / "file" / "p.html").exception
    assert (type(error), error.exit_code) == (SetupError, 3)


def test_two_labels_of_contact_are_compared(tmp_path, episode):
    plain = episode("e", rows=4, fingertip_names=("a", "b"))
    contact, collision = np.zeros((4, 2), bool), np.array([[0, 1], [0, 1], [0, 0], [0, 0]], bool)
    arrays = {**plain.arrays, "fingertip_contact": contact, "fingertip_collision": collision}
    root = create_dataset(tmp_path / "labels")
    append(root, [Episode(plain.meta, arrays)], Lineage(operation="test"))
    lines = run("inspect", root).stdout.splitlines()
    assert "collision: a 0.0%, b 50.0%" in lines
    assert "collision differs from contact: a 0.0%, b 50.0%" in lines
    assert json.loads(run("inspect", root, "--json").stdout)["label_disagreements"] == {"a": 0.0, "b": 0.5}


def test_a_scene_is_for_the_page_and_must_fit(root, tmp_path):
    assert isinstance(run("inspect", root, "--scene", "gripper_tabletop").exception, UsageError)
    error = run("inspect", root, "--scene", "gripper_tabletop", "--html", tmp_path / "p.html").exception
    assert "the episode's joints are not those of the scene" in str(error)
    assert not (tmp_path / "p.html").exists()
