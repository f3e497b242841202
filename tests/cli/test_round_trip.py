"""An emulated hand, recorded over a pseudo-terminal and imported, is what was sent: the three programs as users run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest

from candata.align import MAX_GAP_PERIODS
from candata.datasets import open_dataset
from candata.record.devices import device
from candata.record.emulate_script import to_counts
from candata.record.import_streams import came_late
from candata.record.logs import Log, read_log
from candata.schema.contact import fingertip_contact
from candata.schema.episode import Episode

RATE, SCALE = 80.0, 0.02
PERIOD_NS = round(1e9 / RATE)
HAND = device("xhand")


@dataclass(frozen=True)
class Trip:
    """What was sent, logged and imported."""

    truth: dict[str, np.ndarray]
    sent: dict
    recorded: dict
    log: Log
    episode: Episode
    details: dict

    def heard(self, kind: str = "state") -> np.ndarray:
        """The rows sent whose frames the log holds: all that went out whole from the first heard to the last."""
        said = {"state": "joint_position", "command": "joint_target"}[kind]
        logged = getattr(self.log, said)
        whole = np.flatnonzero(self.truth[f"{kind}_whole"])
        rows = self.truth[said][whole].astype(np.float64)
        n = len(logged)
        places = [k for k in range(len(rows) - n + 1) if np.array_equal(rows[k : k + n], logged)]
        assert len(places) == 1, "the log holds other rows than were sent"
        return whole[places[0] : places[0] + n]


def start(folder, *arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "candata_cli.main", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )


def run(folder, *arguments: object) -> str:
    process = start(folder, *arguments)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out


@pytest.fixture(scope="module")
def trip(tmp_path_factory) -> Trip:
    """Five seconds of a grasp at a scale that clips what presses, listened to from the still stretch to the end."""
    folder = tmp_path_factory.mktemp("trip")
    hand = start(
        folder,
        "emulate",
        "xhand",
        "--link",
        "hand",
        "--with-table",
        "poses/poses.parquet",
        "--truth",
        "truth.npz",
        "--newton-per-count",
        SCALE,
        "--still",
        1.6,
        "--hold",
        "--json",
    )
    try:
        until = time.monotonic() + 60
        while not (folder / "hand").exists() and hand.poll() is None and time.monotonic() < until:
            time.sleep(0.05)
        recorded = run(
            folder,
            "record-real",
            "--port",
            "hand",
            "--out",
            "hand.mcap",
            "--calibrate-s",
            1,
            "--duration",
            4,
            "--newton-per-count",
            SCALE,
            "--reserve-mb",
            0,
            "--json",
        )
    finally:
        hand.send_signal(signal.SIGINT)
        out, err = hand.communicate(timeout=60)
    assert hand.returncode == 0, err
    run(folder, "import", "log", "hand.mcap", "--with", "poses/map.yaml", "--scene", "xhand_tabletop", "--out", "ds")
    with np.load(folder / "truth.npz") as file:
        truth = dict(file)
    dataset = open_dataset(folder / "ds")
    (details,) = dataset.lineage[-1].details["logs"]
    sent = json.loads(out.splitlines()[-1])
    return Trip(
        truth, sent, json.loads(recorded), read_log(folder / "hand.mcap"), dataset.episode(dataset.ids[0]), details
    )


def test_the_log_holds_what_was_sent_bit_for_bit(trip):
    rows = trip.heard()
    truth, log = trip.truth, trip.log
    assert np.array_equal(truth["force_counts"][rows], log.force_counts)
    assert np.array_equal(truth["taxel_counts"][rows], log.taxel_counts)
    # The recorder may begin or end between a request and its reply, and a busy machine may drop one of the two.
    assert abs(len(trip.heard("command")) - len(rows)) <= 2 + trip.sent["dropped_frames"]
    assert trip.sent["received_bytes"] == 0


def test_clipped_counts_are_reported_by_all_three(trip):
    rows, truth = trip.heard(), trip.truth
    _, clipped = to_counts(truth["force"], HAND, SCALE)
    assert trip.sent["clipped"]["force_counts"] == clipped.sum() > 0
    at_end = ((truth["force_counts"] >= HAND.count_high) | (truth["force_counts"] == [-128, -128, -1])).any(-1)
    assert trip.recorded["saturated"]["forces"] == at_end[rows].sum() > 0
    time_ns = trip.episode["time_ns"]
    inside = (trip.log.state_time_ns > time_ns[0]) & (trip.log.state_time_ns <= time_ns[-1])
    inside &= ~came_late(trip.log.state_time_ns, MAX_GAP_PERIODS)
    per_tip = at_end[rows][inside].sum(axis=0)
    assert trip.details["saturated"]["force"] == dict(zip(HAND.fingertip_names, per_tip.tolist(), strict=True))


def punctual(trip: Trip) -> np.ndarray:
    """Rows of the episode around which the recorder's stamps are those of the wire within half a period.

    On a busy machine the reader is woken late. There is no clock in the hand: such stamps are wrong, whoever reads.
    """
    rows, time_ns = trip.heard(), trip.episode["time_ns"]
    late = np.abs(trip.log.state_time_ns - trip.truth["state_time_ns"][rows]) > PERIOD_NS / 2
    near = np.searchsorted(trip.log.state_time_ns[late], [time_ns - 2 * PERIOD_NS, time_ns + 2 * PERIOD_NS])
    return near[0] == near[1]


def bounds(time_ns: np.ndarray, values: np.ndarray, at_ns: np.ndarray, held: bool) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest of what was sent, held or on a line between rows, within one period of each time."""
    ends = []
    for end_ns in (at_ns - PERIOD_NS, at_ns + PERIOD_NS):
        before = np.searchsorted(time_ns, end_ns, side="right") - 1
        assert before.min() >= 0
        share = (end_ns - time_ns[before]) / (time_ns[before + 1] - time_ns[before]) * (not held)
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        ends.append((1 - share) * values[before] + share * values[before + 1])
    least, most = np.minimum(*ends), np.maximum(*ends)
    first, stop = np.searchsorted(time_ns, [at_ns - PERIOD_NS, at_ns + PERIOD_NS])
    for k, (a, b) in enumerate(zip(first, stop, strict=True)):
        least[k] = np.minimum(least[k], values[a:b].min(axis=0, initial=np.inf))
        most[k] = np.maximum(most[k], values[a:b].max(axis=0, initial=-np.inf))
    return least, most


@pytest.mark.parametrize(
    ("channel", "columns", "stamps", "sent", "tolerance"),
    [
        # Sent as float32 and kept as such: nothing is added to the interval but its rounding.
        ("joint_position", slice(3, None), "state_time_ns", "joint_position", 1e-6),
        ("joint_position", slice(0, 3), "state_time_ns", "unwired_joint_position", 1e-6),
        ("action", slice(3, None), "command_time_ns", "joint_target", 1e-6),
        ("action", slice(0, 3), "state_time_ns", "unwired_action", 1e-6),
        ("object_pose", slice(0, 3), "state_time_ns", "unwired_object_pose", 1e-6),
        # Half a count is the quantisation of the device.
        ("fingertip_force", slice(None), "state_time_ns", "force", SCALE / 2 + 1e-6),
    ],
)
def test_what_is_valid_was_sent_within_one_period(trip, channel, columns, stamps, sent, tolerance):
    episode, truth = trip.episode, trip.truth
    good = episode.valid(channel) & punctual(trip)
    assert good.sum() > len(episode) / 4, "the machine was too busy to say anything"
    values = np.array(truth[sent], np.float64)
    if sent == "force":
        values = np.clip(values, np.array(HAND.count_low) * SCALE, np.array(HAND.count_high) * SCALE)
    if channel == "object_pose":
        values = values[:, :3]
    found = episode[channel][good][:, columns].astype(np.float64)
    least, most = bounds(truth[stamps], values, episode["time_ns"][good], channel == "action")
    assert np.ptp(found, axis=0).max() > 0.01, "nothing moved"
    # How far the worst value lies outside of what was sent; not above zero when all is well.
    assert np.maximum(least - found, found - most).max() <= tolerance


def test_contact_is_that_of_the_forces(trip):
    episode = trip.episode
    good = episode.valid("fingertip_force")
    flags = fingertip_contact(episode["fingertip_force"][good])
    assert np.array_equal(flags, episode["fingertip_contact"][good])
    assert 0 < flags.sum() < flags.size
