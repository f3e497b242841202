"""A session from its log to a dataset: an episode for each mark, and another recipe as a new version."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.record.calibration import calibrate
from candata.record.devices import States, hand
from candata.record.import_recipe import ImportRecipe
from candata.record.import_session import cut_episodes
from candata.record.importing import import_log
from candata.record.logs import LogWriter, meta_of, read_log
from candata.record.session import Session
from candata.record.session_run import LOG_NAME
from tests.cli.command import run

HAND = hand("xhand")
WALL_NS = 1_760_000_000_000_000_000
RATE_HZ, CALIBRATE_ROWS = 83.0, 83
#: Seconds of each key: a success, a discarded one, one that drops.
KEYS = ((1.5, " "), (2.0, "s"), (2.5, " "), (2.8, " "), (2.9, "x"), (3.0, " "), (3.2, " "), (3.9, " "), (3.95, "d"))


@pytest.fixture
def session(tmp_path):
    """Four seconds of a hand whose thumb is pressed at two levels from 1.6 s to 2.4 s."""
    n = round(4.0 * RATE_HZ)
    stamps_ns = np.round(np.arange(n) * 1e9 / RATE_HZ).astype(np.int64) + 10**9
    counts = np.zeros((n, len(HAND.fingertip_names), 3), np.int16)
    counts[round(1.6 * RATE_HZ) : round(2.0 * RATE_HZ), 0, 2] = 5
    counts[round(2.0 * RATE_HZ) : round(2.4 * RATE_HZ), 0, 2] = 3
    still = np.zeros((n, len(HAND.joint_names)))
    taxels = np.zeros((n, len(HAND.fingertip_names), HAND.taxels, 3), np.int16)
    states = States(still, still, still, counts, taxels)
    folder = tmp_path / "monday"
    writer = LogWriter(folder / LOG_NAME, meta_of(HAND, "xhand", wall_offset_ns=WALL_NS, session="monday"))
    resting = States(*(getattr(states, name)[:CALIBRATE_ROWS] for name in States.__dataclass_fields__))
    names = {"joint_names": HAND.joint_names, "fingertip_names": HAND.fingertip_names}
    writer.calibration(calibrate(resting, 1.0, **names, newton_per_count=HAND.newton_per_count, rate_hz=RATE_HZ))
    writer.states(stamps_ns.tolist(), states)
    marks = Session()
    for second, key in KEYS:
        stamp_ns = 10**9 + round(second * 1e9)
        kept = marks.mark(marks.typed(key, stamp_ns), stamp_ns, "key", key)
        writer.event(kept.time_ns, {"event": "mark", **kept.model_dump(mode="json", exclude={"time_ns"})})
    writer.close()
    return folder


def test_each_mark_is_an_episode_and_another_recipe_a_new_version(session, tmp_path):
    out = tmp_path / "set"
    first = run("import", "log", session, "--threshold", 0.4, "--out", out)
    assert first.code == 0, first.err
    assert "discarded episodes left out: 2" in first.err
    data = open_dataset(out)
    assert {e.meta.id: e.meta.outcome for e in data} == {"monday-0001": "success", "monday-0003": "drop"}
    lineage = json.dumps([item.model_dump(mode="json") for item in data.file.lineage])
    assert '"session": "monday"' in lineage
    again = run("import", "log", session, "--threshold", 0.4, "--append", "--out", out)
    assert "0 episodes added, 2 in version 1" in again.out

    words = ("import", "log", session, "--threshold", 0.4, "--release", 0.2, "--append", "--out", out)
    assert "another content" in run(*words).err
    replaced = run(*words, "--replace")
    assert "0 episodes added, 2 replaced, 2 in version 2" in replaced.out
    shares = [
        next(e["contact"].mean() for e in open_dataset(out, version) if e.meta.id == "monday-0001")
        for version in (1, 2)
    ]
    # 0.4 s of a second are above the threshold, and as long again above the release.
    assert shares == pytest.approx([0.4, 0.8], abs=0.03)
    rules = [next(iter(open_dataset(out, version))).meta.contact_rule.release_n for version in (1, 2)]
    assert rules == [None, 0.2]


def test_marks_that_are_lost_with_a_damaged_chunk_rename_no_episode(session):
    log = read_log(session / LOG_NAME)
    whole = import_log(session / LOG_NAME, log, ImportRecipe(episode="monday"))
    marks = [event["mark"] for _, event in log.events]
    for lost in (marks.index("begin"), marks.index("end")):
        damaged = replace(log, events=log.events[:lost] + log.events[lost + 1 :])
        cut = cut_episodes(whole, damaged)
        assert [(e.meta.id, e.meta.outcome) for e in cut.episodes] == [("monday-0003", "drop")]
        assert any("lacks their begin or end: episodes 1" in note for note in cut.notes)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--out", "a", "--session", "b"), "give --out LOG, or --session DIR"),
        ((), "give --out LOG, or --session DIR"),
        (("--out", "a", "--episodes", 2), "only a session takes --episodes"),
        (("--session", "b", "--episodes", 2), "--episodes needs the length of an episode"),
        (("--session", "b", "--start-on-contact", "--no-calibrate"), "no episode can begin by contact"),
        (("--out", "a", "--silence", 5), "only a session takes --silence"),
        (("--session", "b", "--gap", 2), "--gap does nothing in a session by keys"),
        (("--session", "b", "--threshold", 0.2, "--release", 0.3), "do not make a rule of contact"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, problem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("record-real", "--port", "nowhere", *words)
    assert done.code == 2
    assert problem in done.err
    assert not list(tmp_path.iterdir())


def test_an_import_that_cannot_be_is_refused(session, tmp_path):
    out = tmp_path / "set"
    high = run("import", "log", session, "--release", 0.5, "--out", out)
    assert "contact would end above the force at which it begins" in high.err
    assert "--replace changes a dataset that stands" in run("import", "log", session, "--replace", "--out", out).err
    assert not out.exists()
