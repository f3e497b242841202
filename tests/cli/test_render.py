from __future__ import annotations

import struct

import pytest
import typer
from typer.testing import CliRunner

from candata.datasets import append, create_dataset
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.manifest import Lineage
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata_cli.render_command import register

app = typer.Typer(callback=lambda: None)
register(app)


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = create_dataset(tmp_path_factory.mktemp("render") / "ds")
    jobs = [EpisodeJob(id=name, index=0, policy="squeeze", seed=1) for name in ("b", "a")]
    append(root, make_episodes(load_scene("gripper_tabletop"), jobs, duration_s=0.5), Lineage(operation="test"))
    return root


@pytest.fixture(autouse=True)
def _without_gl(monkeypatch):
    monkeypatch.setenv("CANDATA_GL", "off")


def test_an_episode_becomes_a_filmstrip_with_a_ghost(root, tmp_path):
    out = tmp_path / "out" / "b.png"
    result = run("render", root, "--episode", "b", "--out", out, "--over", root, "--size", "32x24", "--frames", "2")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr.splitlines()[0] == "No GL library found: this is a drawn projection."
    assert result.stderr.splitlines()[-1].startswith(f"b: {out}, 2 pictures")
    assert struct.unpack(">II", out.read_bytes()[16:24]) == (2 * 32 + 4, 24)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--episode", "c"], UnknownNameError),
        (["--scene", "no"], UsageError),
        (["--size", "3x"], UsageError),
        (["--size", "9999x9"], UsageError),
        (["--over-episode", "a"], UsageError),
        (["--camera", "no"], UnknownNameError),
    ],
)
def test_wrong_options_leave_nothing(root, tmp_path, options, error):
    result = run("render", root, *options, "--out", tmp_path / "x.png")
    assert isinstance(result.exception, error)
    assert not list(tmp_path.iterdir())


def test_an_unknown_ending_is_told_before_anything_is_read(tmp_path):
    result = run("render", tmp_path / "no-dataset", "--out", tmp_path / "x.jpg")
    assert isinstance(result.exception, UsageError)
    assert "one of .gif, .mp4, .png" in str(result.exception)
