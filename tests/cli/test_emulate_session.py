"""Command emulate session: the line that it prints, what it counts and writes, what it refuses."""

from __future__ import annotations

import json

import numpy as np

from tests.cli.command import exit_code


def test_the_command_prints_the_line_and_what_was_sent(tmp_path, capsys):
    words = ("--no-wait", "--duration-s", "0.2", "--still", "0", "--json", "--streams", "arm,pose")
    truth_file = tmp_path / "truth.npz"
    code = exit_code("emulate", "session", "--link", str(tmp_path / "ports"), *words, "--truth", str(truth_file))
    assert code == 0
    head, report = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert set(head["streams"]) == {"arm", "pose"}
    assert f"--arm {head['streams']['arm']} --pose udp://" in head["record"]
    assert report["streams"]["arm"]["frames"] > 30
    assert report["streams"]["arm"]["whole"] == 0  # nobody listened
    with np.load(truth_file) as truth:
        assert truth["arm_joint_position"].shape == (report["streams"]["arm"]["frames"], 7)
        assert truth["joint_position"].shape[1] == 12


def test_options_that_mean_nothing_are_refused(tmp_path, capsys):
    taken, folder = tmp_path / "file", str(tmp_path / "ports")
    taken.touch()
    for words, said in [
        (("session",), "--link DIR"),
        (("session", "--link", str(taken)), "a folder"),
        (("session", "--link", folder, "--hold"), "--loop 0"),
        (("session", "--link", folder, "--ports", "80"), "1024"),
        (("xhand", "--streams", "arm"), "session"),
        (("xarm",), "emulate session --link DIR"),
    ]:
        assert exit_code("emulate", *words) == 2
        assert said in capsys.readouterr().err
