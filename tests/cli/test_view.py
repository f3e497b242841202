from __future__ import annotations

import importlib.util

import pytest
import typer
from typer.testing import CliRunner

from candata.datasets import append, create_dataset
from candata.errors import UnknownNameError, UsageError
from candata.schema.manifest import Lineage
from candata_cli.view_command import register

app = typer.Typer(callback=lambda: None)
register(app)
needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="no rerun-sdk (extra view)")


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("b"), episode("a")], Lineage(operation="test"))
    return root


@needs_rerun
def test_an_episode_becomes_a_file(root, tmp_path):
    result = run("view", root, "--episode", "b", "--out", tmp_path / "out" / "b.rrd")
    assert (result.exit_code, result.stdout) == (0, "")
    assert "no scene" in result.stderr
    assert (tmp_path / "out" / "b.rrd").stat().st_size > 1000


@needs_rerun
def test_the_first_episode_is_the_default(root, tmp_path):
    assert run("view", root, "--out", tmp_path / "a.rrd").stderr.splitlines()[-1].startswith("a: ")


@needs_rerun
def test_without_a_display_the_file_is_called_as_the_episode(tmp_path, episode, monkeypatch):
    root = create_dataset(tmp_path / "odd")
    append(root, [episode("../a b")], Lineage(operation="test"))
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    result = run("view", root)
    assert result.exit_code == 0
    assert "there is no display" in result.stderr
    assert (tmp_path / "_._a_b.rrd").is_file()


@needs_rerun
@pytest.mark.parametrize(
    ("options", "error"), [(["--episode", "c"], UnknownNameError), (["--scene", "no"], UsageError)]
)
def test_wrong_names_leave_nothing(root, tmp_path, options, error):
    result = run("view", root, *options, "--out", tmp_path / "x.rrd")
    assert isinstance(result.exception, error)
    assert not list(tmp_path.glob("*x.rrd*"))
