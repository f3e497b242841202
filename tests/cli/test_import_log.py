"""`import log`: what was sent comes back, and `validate`, `inspect`, `diagnose` take it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml

from candata.datasets import get_cloud, open_dataset
from candata.record.calibration import calibrate
from candata.record.devices import Commands, States, device
from candata.record.logs import LogWriter, meta_of
from candata.scenes import load_scene
from candata.scenes.clouds import surface_cloud
from candata.schema.contact import fingertip_contact
from candata.schema.episode import Episode
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.cli.command import exit_code

SCENE = "xhand_tabletop"
RATE = 80.0
#: Rows at rest before the episode: what calibration takes, and a little.
STILL, WINDOW_S = 260, 3.0
WALL_NS = 1_760_000_000_000_000_000
WRIST = 3
#: What the fingertips read at rest [counts].
BIAS = (2, -3, 1)
POSE = ["px", "py", "pz", "qw", "qx", "qy", "qz"]


@dataclass(frozen=True)
class Sent:
    """What a hand was told and said, and where it was written."""

    episode: Episode
    log: Path
    table: Path
    state_time_ns: np.ndarray
    force: np.ndarray
    counts: np.ndarray
    taxels: np.ndarray


@pytest.fixture(scope="session")
def played() -> Episode:
    """Five seconds of a squeeze, with contact."""
    (found,) = make_episodes(load_scene(SCENE), [EpisodeJob("e", 0, "squeeze", 3)], duration_s=5.0)
    assert found["contact"].any()
    return found


def send(folder: Path, episode: Episode, bias=BIAS, lost=(), jitter_ns=300_000, log_name="run.mcap") -> Sent:
    """Write a log as a listener would, and the table of what the wire does not carry; bias in counts."""
    rng = np.random.default_rng(5)
    hand = device("xhand")
    row = np.concatenate([np.zeros(STILL, int), np.arange(len(episode))])
    n = len(row)
    command_ns = 1_000_000_000 + np.round(np.arange(n) * 1e9 / RATE).astype(int) + rng.integers(0, jitter_ns, n)
    state_ns = command_ns + 1_100_000  # the reply follows the request on the wire
    force = episode["fingertip_force"][row].astype(float)
    force[:STILL] = 0
    whole = np.rint(force / hand.newton_per_count) + np.array(bias)
    counts = np.clip(whole, hand.count_low, hand.count_high).astype(np.int16)
    taxels = np.clip(rng.poisson(1.0, (n, 5, hand.taxels, 3)), hand.count_low, hand.count_high).astype(np.int16)
    position = episode["joint_position"][row][:, WRIST:]
    states = States(position, np.zeros_like(position), np.zeros_like(position), counts, taxels)
    meta = meta_of(hand, "xhand", wall_offset_ns=WALL_NS)
    kept = [k for k in range(n) if k not in lost]
    path = folder / log_name
    writer = LogWriter(path, meta)
    still = States(*(getattr(states, name)[: int(WINDOW_S * RATE)] for name in States.__dataclass_fields__))
    names = {"joint_names": hand.joint_names, "fingertip_names": hand.fingertip_names}
    found = calibrate(still, WINDOW_S, **names, newton_per_count=hand.newton_per_count, rate_hz=RATE)
    writer.calibration(found)
    writer.states(state_ns[kept], States(*(getattr(states, f)[kept] for f in States.__dataclass_fields__)))
    writer.commands(command_ns[kept], Commands(episode["action"][row][kept][:, WRIST:]))
    for k in range(1, 9):
        clock = {"monotonic_ns": k * 1_000_000_000, "wall_ns": k * 1_000_000_000 + WALL_NS}
        writer.statistics(k * 1_000_000_000, {"clock": clock})
    writer.close()
    return Sent(episode, path, _table(folder, episode, row, state_ns), state_ns + WALL_NS, force, counts, taxels)


def _table(folder: Path, episode: Episode, row: np.ndarray, state_ns: np.ndarray) -> Path:
    """Write object pose and wrist with unix seconds, and the map beside."""
    columns = {"t": (state_ns + WALL_NS) * 1e-9}
    columns |= {name: episode["object_pose"][row][:, k] for k, name in enumerate(POSE)}
    wrist = episode.meta.joint_names[:WRIST]
    columns |= {f"q_{name}": episode["joint_position"][row][:, k] for k, name in enumerate(wrist)}
    columns |= {f"a_{name}": episode["action"][row][:, k] for k, name in enumerate(wrist)}
    pa.parquet.write_table(pa.table(columns), folder / "unwired.parquet")
    channels = {
        "object_pose": POSE,
        "joint_position": [f"q_{name}" for name in wrist],
        "action": [f"a_{name}" for name in wrist],
    }
    mapping = {"file": "unwired.parquet", "time_s": "t", "rate_hz": RATE, "channels": channels, "task": "squeeze"}
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping))
    return folder / "map.yaml"


@pytest.fixture(scope="session")
def sent(tmp_path_factory, played) -> Sent:
    return send(tmp_path_factory.mktemp("sent"), played)


@pytest.fixture(scope="session")
def imported(tmp_path_factory, sent) -> Path:
    out = tmp_path_factory.mktemp("imported") / "ds"
    assert exit_code("import", "log", sent.log, "--with", sent.table, "--scene", SCENE, "--out", out) == 0
    return out


def rows_sent(sent: Sent, episode: Episode) -> np.ndarray:
    """Return, for each row of the import, the row that was sent next to it."""
    return np.searchsorted(sent.state_time_ns, episode["time_ns"] - round(0.5e9 / RATE))


def outside_one_period(values, sent_values, rows) -> np.ndarray:
    """Return each column's largest distance from the range of what was sent within one period of each row."""
    near = np.stack([sent_values[np.clip(rows + k, 0, len(sent_values) - 1)] for k in (-1, 0, 1)])
    return np.maximum(near.min(0) - values, values - near.max(0)).max(0)


def test_what_was_sent_comes_back(sent, imported):
    (episode,) = open_dataset(imported)
    rows = rows_sent(sent, episode)
    source = np.concatenate([np.zeros(STILL, int), np.arange(len(sent.episode))])
    scene = load_scene(SCENE)
    assert episode.meta.joint_names == scene.file.joints
    assert episode.meta.actuator_names == scene.file.actuator_names
    assert episode.meta.fingertip_names == scene.file.fingertips
    assert (episode.meta.rate_hz, episode.meta.source, episode.meta.task) == (80.0, "real", "squeeze")
    assert len(episode) > len(sent.episode)  # all of it, and what was still after the calibration
    assert (episode["time_ns"][0] - sent.state_time_ns[0]) * 1e-9 >= WINDOW_S
    assert not episode.meta.invalid_counts
    for channel in ("joint_position", "action", "object_pose"):
        # float32, stored and sent; a quaternion's arc leaves the range of its ends by less than their distance
        tolerance = np.where(np.arange(episode[channel].shape[1]) < 3, 1e-6, 1e-3 if channel == "object_pose" else 1e-6)
        assert (outside_one_period(episode[channel], sent.episode[channel][source], rows) < tolerance).all(), channel
    # Each row of commands is one that was sent, and rows do not slip: the host ran at the grid's rate.
    assert np.abs(episode["action"] - sent.episode["action"][source][rows]).max() < 1e-6
    assert np.array_equal(episode["taxels"], sent.taxels[rows])


def test_the_shape_of_the_scenes_object_comes_along(sent, imported):
    """A model that was trained on simulations of the scene can be fine-tuned on what was recorded."""
    meta = open_dataset(imported).episode("run").meta
    assert np.array_equal(get_cloud(imported, meta.point_cloud), surface_cloud(load_scene(SCENE)))


def test_forces_are_what_was_sent_within_half_a_count(sent, imported):
    (episode,) = open_dataset(imported)
    hand = device("xhand")
    rows = rows_sent(sent, episode)
    whole = np.rint(sent.force[rows] / hand.newton_per_count) + BIAS
    fits = (whole >= hand.count_low) & (whole <= hand.count_high)
    assert fits.mean() > 0.9
    error = np.abs(episode["fingertip_force"] - sent.force[rows])
    assert error[fits].max() <= 0.05 + 1e-5  # half a count of 0.1 N, and float32
    assert np.array_equal(episode["fingertip_contact"], fingertip_contact(episode["fingertip_force"], 0.3))
    assert episode["contact"].any()
    rule = episode.meta.contact_rule
    assert (rule.threshold_n, rule.newton_per_count, episode.meta.newton_per_count) == (0.3, 0.1, 0.1)


def test_the_lineage_tells_how(sent, imported, capsys):
    dataset = open_dataset(imported)
    (lineage,) = dataset.lineage
    (details,) = lineage.details["logs"]
    assert lineage.operation == "import log"
    assert len(lineage.config_digest) == 64
    assert details["log"] == "run.mcap"
    assert len(details["log_sha256"]) == 64
    assert details["calibration"]["force_bias_counts"] == [list(BIAS)] * 5
    assert details["recipe"]["threshold_n"] == 0.3
    assert [c["file"] for c in details["with"]] == ["map.yaml"]
    shares = details["contact_share_by_newton_per_count"]
    assert list(shares) == ["0.05", "0.1", "0.2"]
    assert shares["0.05"] <= shares["0.1"] <= shares["0.2"]
    (episode,) = dataset
    first = int(np.searchsorted(sent.state_time_ns, episode["time_ns"][0]))
    at_end = (sent.counts >= [127, 127, 255]) | (sent.counts <= [-128, -128, -1])
    wanted = at_end[first : first + len(episode) - 1].any(-1).sum(0)
    assert list(details["saturated"]["force"].values()) == wanted.tolist()
    assert "/" not in json.dumps(details["recipe"]), "a path of the machine"
    assert episode.meta.alignment.offset_s == 0
    assert exit_code("inspect", imported, "--json") == 0
    assert json.loads(capsys.readouterr().out)["lineage"][0]["details"]["logs"] == [details]


def test_validate_and_inspect_run_on_it(imported, capsys):
    assert exit_code("validate", imported) == 0
    assert capsys.readouterr().out.startswith("1 episode, no findings\n")
    assert exit_code("inspect", imported) == 0
    printed = capsys.readouterr().out
    assert "taxels count (T, 5, 120, 3) 0 " in " ".join(printed.split())
    assert "lineage: import log" in printed


def test_diagnose_takes_it(imported, tmp_path, capsys):
    assert exit_code("diagnose", imported, "--scene", SCENE, "--out", tmp_path / "d", "--jobs", "1", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == "too_little_data"  # one episode; joints, rate and commands were accepted
    assert report["data"]["episodes"]["total"] == 1


def test_lost_frames_are_marked_on_the_way(tmp_path, played, capsys):
    lost = range(STILL + 100, STILL + 120)
    sent = send(tmp_path, played, lost=lost)
    out = tmp_path / "ds"
    assert exit_code("import", "log", sent.log, "--with", sent.table, "--scene", SCENE, "--out", out) == 0
    assert "rows marked invalid by gaps: joint_position 21, action 21, " in capsys.readouterr().err
    (episode,) = open_dataset(out)
    assert episode.meta.invalid_counts["fingertip_force"] in (20, 21)
    assert "object_pose" not in episode.meta.invalid_counts
    assert exit_code("validate", out) == 0


def test_the_same_log_twice_adds_nothing(sent, tmp_path, capsys):
    out = tmp_path / "ds"
    command = ("import", "log", sent.log, "--with", sent.table, "--scene", SCENE, "--out", out)
    assert exit_code(*command) == 0
    before = open_dataset(out).file
    assert exit_code(*command) == 2
    assert "the output exists already" in capsys.readouterr().err
    assert exit_code(*command, "--append") == 0
    assert capsys.readouterr().out.endswith("0 episodes added, 1 in version 1\n")
    assert open_dataset(out).file == before
    assert exit_code(*command, "--append", "--threshold", "0.5") == 2
    assert "another content" in capsys.readouterr().err
    assert exit_code(*command, "--append", "--threshold", "0.5", "--episode", "strict", "--object", "can") == 0
    assert open_dataset(out).episode("strict").meta.object == "can"


def test_what_else_is_known_of_an_episode_is_kept(sent, tmp_path):
    words = ("--outcome", "success", "--label", "start=0007", "--label", "mass_kg=0.25", "--label", "side=nan")
    assert exit_code("import", "log", sent.log, "--episode", "told", *words, "--out", tmp_path / "ds") == 0
    meta = open_dataset(tmp_path / "ds").episode("told").meta
    assert meta.outcome == "success"
    assert meta.labels == {"start": "0007", "mass_kg": 0.25, "side": "nan"}


def test_several_logs_are_one_version(tmp_path, played, capsys):
    logs = [send(tmp_path, played, log_name=f"run{i}.mcap", bias=(i, i, i)).log for i in range(2)]
    assert exit_code("import", "log", *logs, "--rate", "40", "--out", tmp_path / "ds") == 0
    assert capsys.readouterr().out.endswith("2 episodes added, 2 in version 1\n")
    dataset = open_dataset(tmp_path / "ds")
    assert dataset.ids == ("run0", "run1")
    assert [d["log"] for d in dataset.lineage[0].details["logs"]] == ["run0.mcap", "run1.mcap"]
    episode = dataset.episode("run0")
    assert (episode.meta.rate_hz, episode.meta.joint_names) == (40, device("xhand").joint_names)
    assert len(dataset.file.parts) == 2  # one log a part: only one is held


def shifted(folder: Path) -> Path:
    """A table whose stamps are those of another clock."""
    columns = {"t": np.arange(500) / 80.0} | {name: np.full(500, float(name == "qw")) for name in POSE}
    pa.parquet.write_table(pa.table(columns), folder / "t.parquet")
    mapping = {"file": "t.parquet", "time_s": "t", "rate_hz": 80, "channels": {"object_pose": POSE}}
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping))
    return folder / "t.parquet"


def empty(folder: Path) -> Path:
    (folder / "empty.mcap").write_bytes(b"")
    return folder / "empty.mcap"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda sent, folder: [empty(folder)], "the log is empty"),
        (lambda sent, folder: [folder / "absent.mcap"], "no such log"),
        (lambda sent, folder: [sent.table], "the file is no log"),
        (lambda sent, folder: [sent.log, empty(folder)], "the log is empty"),
        (lambda sent, folder: [sent.log, "--with", shifted(folder)], "was not recorded while the log was"),
        (lambda sent, folder: [sent.log, "--with", folder / "absent.parquet"], "the table has no map"),
        (lambda sent, folder: [sent.log, "--scene", SCENE], "joint_position lacks joints of the scene"),
        (lambda sent, folder: [sent.log, "--scene", "xhand_tabletopp"], "unknown scene"),
        (lambda sent, folder: [sent.log, "--rate", "0"], "rate_hz"),
        (lambda sent, folder: [sent.log, "--newton-per-count", "-1"], "newton_per_count"),
        (lambda sent, folder: [sent.log, "--allow-gaps"], "`import log` takes no --allow-gaps"),
        (lambda sent, folder: [sent.log, sent.log, "--episode", "x"], "--episode names one episode"),
        (lambda sent, folder: [sent.log, "--outcome", "sucess"], "success"),
        (lambda sent, folder: [sent.log, "--label", "start"], "--label is no new name with its value"),
        (lambda sent, folder: [sent.log, "--label", "a=1", "--label", "a=2"], "--label is no new name with its value"),
    ],
)
@pytest.mark.parametrize("standing", [False, True])
def test_bad_input_is_one_message_and_nothing_written(sent, tmp_path, capsys, arguments, words, standing):
    out = tmp_path / "made" / "ds"
    if standing:
        exit_code("import", "log", sent.log, "--episode", "first", "--out", out)
        before = open_dataset(out).file
    capsys.readouterr()
    assert exit_code("import", "log", *arguments(sent, tmp_path), "--out", out, "--append") == 2
    printed = capsys.readouterr()
    assert words in printed.err
    assert "Traceback" not in printed.err
    assert printed.out == ""
    if standing:
        assert open_dataset(out).file == before
    else:
        assert not out.parent.exists() or list(out.parent.iterdir()) == []


def test_what_belongs_to_logs_is_refused_elsewhere(sent, out_of_table, capsys):
    source, out = out_of_table
    for option in (("--with", sent.table), ("--scene", SCENE), ("--threshold", "1"), ("--uncalibrated",)):
        assert exit_code("import", "table", source, *option, "--out", out) == 2
        why = (
            "`import table` reads it from its map and takes no" if option[0] == "--scene" else "only `import log` takes"
        )
        assert capsys.readouterr().err.startswith(f"{why} {option[0]}")
    assert exit_code("import", "table", source, source, "--out", out) == 2
    assert "takes one source" in capsys.readouterr().err
    assert exit_code("import", "logs", source, "--out", out) == 2
    assert "did you mean 'log'?" in capsys.readouterr().err


@pytest.fixture
def out_of_table(tmp_path) -> tuple[Path, Path]:
    return shifted(tmp_path).with_name("map.yaml"), tmp_path / "ds"
