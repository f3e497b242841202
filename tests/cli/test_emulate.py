"""Command emulate: what it prints, what it writes, and how it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tty

import numpy as np
import pytest

from candata.datasets import append, create_dataset
from candata.record.devices import device
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from tests.cli.command import exit_code

XHAND = device("xhand")


def hand(name: str, rows: int = 10) -> Episode:
    """An episode of the hand alone, without wrist and object."""
    meta = EpisodeMeta(
        id=name,
        source="sim",
        rate_hz=100,
        task="wave",
        joint_names=XHAND.joint_names,
        actuator_names=XHAND.joint_names,
        fingertip_names=XHAND.fingertip_names,
    )
    arrays = {
        "time_ns": np.arange(rows) * 10_000_000,
        "joint_position": np.full((rows, 12), 0.25),
        "action": np.full((rows, 12), 0.5),
        "fingertip_force": np.full((rows, 5, 3), -1.0),
    }
    return Episode(meta, arrays)


@pytest.fixture
def dataset(tmp_path):
    """A dataset of one such episode."""
    root = create_dataset(tmp_path / "hand", name="hand")
    append(root, [hand("only")], Lineage(operation="made"))
    return root


def read(port: str) -> bytes:
    """All that a port gives until it goes away."""
    file, data = os.open(port, os.O_RDWR | os.O_NOCTTY), b""
    tty.setraw(file)
    try:
        while piece := os.read(file, 4096):
            data += piece
    except OSError:
        pass  # the port has gone
    os.close(file)
    return data


def listen(link) -> tuple[threading.Thread, list[bytes]]:
    """Read what comes once the link is there."""
    heard: list[bytes] = []

    def follow() -> None:
        until = time.monotonic() + 20
        while not link.is_symlink() and time.monotonic() < until:
            time.sleep(0.01)
        heard.append(read(str(link)))

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    return thread, heard


def test_an_episode_of_a_dataset_is_played_to_whom_opens_the_port(dataset, tmp_path, capsys):
    """At 25 Hz the port keeps a fifth of a second for a reader that a busy machine leaves waiting."""
    link, truth = tmp_path / "port", tmp_path / "truth.npz"
    thread, heard = listen(link)
    words = ("emulate", "xhand", "--dataset", dataset, "--still", 0.2, "--rate", 25, "--link", link, "--truth", truth)
    assert exit_code(*words) == 0
    thread.join(5)
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0].startswith("/dev/")
    assert re.fullmatch(r"15 rows in 0\.\d+ s: 15 requests and 15 replies whole", lines[1])
    assert lines[2] == "dropped   0 frames, 0 bytes not taken in time"
    assert re.fullmatch(r"clipped   50 force counts, \d+ taxel counts out of range", lines[3])
    assert lines[4:6] == ["faults    none", "received  0 bytes from the reader"]
    assert re.fullmatch(r"late      \d+\.\d ms at most", lines[6])
    assert printed.err == f"15 rows at 25 Hz; waiting for a program to open {link}\n"
    frames = XHAND.framer().feed(heard[0], 0)
    assert [frame.kind for frame in frames] == ["command", "state"] * 15
    assert (XHAND.decode_states([frames[1].data]).joint_position == 0.25).all()
    assert not link.is_symlink()
    with np.load(truth) as stored:
        assert stored["state_whole"].all()


def test_json_is_two_lines(dataset, capsys):
    words = ("emulate", "xhand", "--dataset", dataset, "--still", 0, "--no-wait", "--json", "--rate", 83)
    assert exit_code(*words, "--faults", "garbage:1") == 0
    port, report = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (port["link"], port["rate_hz"], port["rows"]) == (None, 83, 10)
    assert (report["rows"], report["whole_states"], report["dropped_frames"]) == (10, 0, 20)
    assert report["faults"] == {"garbage": 20}


def test_a_simulated_episode_leaves_a_table_that_imports(tmp_path, capsys):
    table = tmp_path / "poses" / "poses.parquet"
    words = ("emulate", "xhand", "--policy", "squeeze", "--duration-s", 0.2, "--still", 0.1, "--no-wait")
    assert exit_code(*words, "--with-table", table) == 0
    assert exit_code("import", "table", table.with_name("map.yaml"), "--out", tmp_path / "poses.ds") == 0
    assert exit_code("inspect", tmp_path / "poses.ds") == 0
    printed = capsys.readouterr().out
    assert "1 episodes, 24 rows" in printed
    assert "tasks: squeeze 1" in printed


def test_an_interrupt_ends_it_with_a_report(dataset):
    """A shell starts background jobs with SIGINT ignored; it is heard all the same."""
    words = ("emulate", "xhand", "--dataset", dataset, "--still", "0", "--no-wait", "--loop", "0", "--json")
    ignored = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from candata_cli.main import main; main()"
    process = subprocess.Popen([sys.executable, "-c", ignored, *map(str, words)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert "port" in json.loads(process.stdout.readline())
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    assert json.loads(rest)["rows"] > 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("xhanf",), "unknown device 'xhanf'\n  expected: one of "),
        (("xhand", "--faults", "flip:1"), "unknown fault 'flip'\n"),
        (("xhand", "--faults", "unplug:1@2"), "a port that comes back has another name\n"),
        (("xhand", "--episode", "only"), "--episode names an episode of a dataset\n"),
        (("xhand", "--loop", -1), "--loop and --seed count from 0\n"),
        (("xhand", "--scene", "cube_toss"), "the episode lacks joints of the device\n"),
        (("xhand", "--policy", "sqeeze"), "unknown policy 'sqeeze'\n"),
        (("xhand", "--dataset", "nowhere"), "not a dataset\n"),
        (("xhand", "--dataset", "DATASET", "--episode", "onyl"), "unknown episode 'onyl'\n"),
        (("xhand", "--dataset", "DATASET", "--rate", 150), "the wire cannot carry this rate\n  expected: above 0, at"),
        (("xhand", "--dataset", "DATASET", "--with-table", "p.csv"), "the table is a Parquet file\n"),
        (("xhand", "--dataset", "DATASET", "--with-table", "p.parquet"), "the wire carries all of this episode\n"),
        (("xhand", "--dataset", "DATASET", "--truth", "DATASET"), "the output exists already\n"),
    ],
)
def test_a_wrong_word_is_a_usage_error(dataset, capsys, words, text):
    assert exit_code("emulate", *(dataset if word == "DATASET" else word for word in words)) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(text)
    assert printed.out == ""


def test_one_of_several_episodes_must_be_named(dataset, capsys):
    append(dataset, [hand("second")], Lineage(operation="made"))
    assert exit_code("emulate", "xhand", "--dataset", dataset) == 2
    assert "2: only, second" in capsys.readouterr().err


def test_a_link_in_a_missing_folder_is_no_traceback(dataset, tmp_path, capsys):
    assert exit_code("emulate", "xhand", "--dataset", dataset, "--link", tmp_path / "no" / "hand") == 3
    assert capsys.readouterr().err.startswith("the link cannot be made\n  found: No such file or directory\n")
