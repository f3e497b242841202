"""`candata gap real`: what it refuses before any work. What it scores is tested with its library."""

from __future__ import annotations

from tests.cli.command import run


def test_a_folder_without_labels_is_refused(tmp_path):
    done = run("gap", "real", tmp_path, "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert "labels.yaml in the folder" in done.err
    assert not (tmp_path / "out").exists()


def test_help_shows_what_a_folder_holds():
    done = run("gap", "real", "--help")
    assert done.code == 0
    assert "servo_gain, parameter: kp_scale" in done.out
