"""Sessions on a pseudo-terminal: marks stand in the log and beside it, whatever happens to the hand."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from candata import plugins
from candata.errors import DataError, SetupError, UsageError
from candata.record.import_recipe import ImportRecipe
from candata.record.import_session import cut_episodes
from candata.record.importing import import_log
from candata.record.logs import read_log
from candata.record.recorder import record
from candata.record.recorder_values import RecorderSettings
from candata.record.recover import recover
from candata.record.session import SessionPlan
from candata.record.session_run import FILE_NAME, LOG_NAME, RunningSession, session_of
from candata.schema.episode import ContactRule
from candata.schema.session import SessionFile
from tests.record.conftest import frames_of

DEVICE = plugins.load("candata.record.devices", "DEVICE", "xhand")
CALIBRATE_S, BETWEEN_KEYS_NS = 0.4, 220_000_000
#: What the keys of the first test make.
MARKS = ["success", "begin", "success", "end", "begin", "discard", "end", "begin", "end"]


def run(port, folder, plan=None, keys=(), at=None, rule=None, show=None, device=DEVICE, **settings):
    """Record a session; each of `keys` is typed once so many states were shown, and `at[states]` is done then.

    `keys` may be what reads them; then `show` is given what is shown.
    """
    notes, states, last_ns, actions = [], [0], [0], dict(at or {})
    typed = [] if callable(keys) else list(keys)

    def read_keys():
        pressed = [key for count, key in typed if count <= states[0]]
        typed[:] = [(count, key) for count, key in typed if count > states[0]]
        # On a busy machine many states are shown at once; a person takes longer than that between two keys.
        first_ns = max(time.monotonic_ns(), last_ns[0] + BETWEEN_KEYS_NS)
        stamped = [(first_ns + k * BETWEEN_KEYS_NS, key) for k, key in enumerate(pressed)]
        last_ns[0] = stamped[-1][0] if stamped else last_ns[0]
        return stamped

    def look(view):
        states[0] = view.frames["state"]
        for count in [count for count in actions if count <= states[0]]:
            actions.pop(count)()

    session = RunningSession(plan or SessionPlan(), keys if callable(keys) else read_keys, notes.append)
    report = record(
        device,
        port,
        folder / LOG_NAME,
        name="xhand",
        settings=RecorderSettings(
            **{"calibrate_s": CALIBRATE_S, "reserve_bytes": 0, "contact": rule or ContactRule(), **settings}
        ),
        overrides={"session": folder.name},
        session=session,
        show=show or look,
        say=notes.append,
    )
    return report, notes


def episodes_of(folder, **recipe):
    log = read_log(folder / LOG_NAME)
    whole = import_log(folder / LOG_NAME, log, ImportRecipe(episode=log.meta.session, **recipe))
    return cut_episodes(whole, log)


def test_keys_make_episodes_with_outcomes_and_an_unplugged_hand_loses_no_mark(hand, tmp_path):
    one, folder = hand(), tmp_path / "monday"

    def replug():
        one.unplug()
        time.sleep(0.3)
        one.plug()

    keys = [(36, "s"), (37, " "), (90, "s"), (91, " "), (131, " "), (132, "x"), (172, " "), (212, " "), (213, "q")]
    report, notes = run(one.port, folder, keys=keys, at={70: replug}, duration_s=3.2)
    assert report.failure is None
    assert report.facts["drift"]["beyond_noise"] == []
    assert len(report.facts["unplugs"]) == 1
    log = read_log(folder / LOG_NAME)
    session, drift = session_of(log)
    assert [mark.mark for mark in session.marks] == MARKS
    assert drift is not None
    file = SessionFile.model_validate_json((folder / FILE_NAME).read_text())
    assert (list(file.marks), list(file.episodes), file.drift) == (session.marks, session.episodes, drift)
    assert any("no episode has begun: this success is kept" in note for note in notes)

    found = episodes_of(folder)
    assert [(e.meta.id, e.meta.outcome) for e in found.episodes] == [("monday-0001", "success"), ("monday-0003", None)]
    first = found.episodes[0]
    marked = session.episodes[0]
    assert marked.begin_ns <= first["time_ns"][0] <= first["time_ns"][-1] <= marked.end_ns
    assert first.meta.invalid_counts["joint_position"] > 0.3 * 83 / 2  # unplugged within it: marked, not bridged
    text = " ".join(found.notes)
    for words in ("discarded episodes left out: 2", "fits no episode", "no drift beyond"):
        assert words in text


def test_episodes_begin_by_contact_and_drift_is_said_when_beyond_the_noise(hand, tmp_path):
    force = np.zeros((200, 5, 3), int)
    force[:, 1, 0] = 2  # 0.2 N at rest, taken off
    force[60:80, 1, 2] = 9
    force[80:90, 1, 2] = 2  # below the threshold, above the release
    force[90:, 0, 2] = 4
    frames = frames_of(position=np.zeros((200, 12)), force=force)
    rest = frames_of(position=np.zeros((1, 12)), force=force[-1:])
    one, folder = hand(frames=[*frames, *(rest * 400)]), tmp_path / "touch"
    rule = ContactRule(threshold_n=0.5, release_n=0.15)
    report, notes = run(one.port, folder, SessionPlan(1, None, 0.1, True), rule=rule)
    (episode,) = report.facts["episodes"]
    assert report.facts["ended"] == "episodes"
    # 30 rows of 83 Hz in contact, then 0.1 s without; the reader wakes every 50 ms.
    assert (episode["end_ns"] - episode["begin_ns"]) * 1e-9 == pytest.approx(30 / 83 + 0.1, abs=0.06)
    assert report.facts["drift"]["beyond_noise"] == ["thumb_rota2"]
    assert report.facts["drift"]["change_N"]["thumb_rota2"] == pytest.approx(0.4)
    assert any("the forces drifted at thumb_rota2" in note for note in notes)
    (found,) = episodes_of(folder, threshold_n=0.5, release_n=0.15).episodes
    assert found.meta.contact_rule.release_n == 0.15
    # Between release and threshold contact goes on; a busy machine leaves some rows out, after which it does not.
    between = np.isclose(found["fingertip_force"][:, 1, 2], 0.2, atol=1e-3)
    assert (found["contact"] & between).any()
    assert found["contact"].mean() < (30 + 2) / 38


def test_the_last_episode_ends_with_the_recording_and_is_judged_while_the_drift_is_checked(hand, tmp_path):
    folder = tmp_path / "last"
    # The session is over after about 83 states; the drift check shows states after that.
    report, _ = run(hand().port, folder, keys=[(60, " "), (95, "d"), (96, " ")], duration_s=0.6)
    (marked,) = report.facts["episodes"]
    assert marked["outcome"] == "drop"
    log = read_log(folder / LOG_NAME)
    assert log.state_time_ns[-1] - marked["end_ns"] > 0.5e9 * CALIBRATE_S
    (episode,) = episodes_of(folder).episodes
    assert episode["time_ns"][-1] <= marked["end_ns"]


def test_a_torn_session_keeps_the_marks_that_were_made(hand, tmp_path):
    folder = tmp_path / "torn"
    run(hand().port, folder, SessionPlan(2, 0.3, 0.1))
    whole = session_of(read_log(folder / LOG_NAME))[0]
    data = (folder / LOG_NAME).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(0.75 * len(data))])
    saved = recover(tmp_path / "cut.mcap")
    marks = session_of(read_log(saved.out))[0].marks
    assert 1 <= len(marks) <= 4
    assert marks == whole.marks[: len(marks)]


def test_a_session_of_discarded_episodes_is_refused(hand, tmp_path):
    folder = tmp_path / "none"
    run(hand().port, folder, keys=[(40, " "), (50, "x"), (51, " ")], duration_s=0.5)
    with pytest.raises(DataError, match="no episode is left of the session"):
        episodes_of(folder)


def test_the_space_bar_in_the_moment_of_a_begin_by_contact_ends_no_episode(hand, tmp_path):
    force = np.zeros((400, 5, 3), int)
    force[60:, 1, 2] = 9
    typed, begun = [], []

    def keys():
        pressed, typed[:] = list(typed), []
        return pressed

    def note_begin(view):
        if view.session.episodes and not begun:
            begun.append(view.session.episodes[0].begin_ns)
            typed.append((begun[0] - 20_000_000, " "))  # just before the fingertip touched
            typed.append((begun[0] + 150_000_000, " "))
            typed.append((begun[0] + 500_000_000, " "))

    one = hand(position=np.zeros((400, 12)), force=force)
    report, notes = run(one.port, tmp_path / "touch", SessionPlan(1, None, 0.1, True), keys, show=note_begin)
    (episode,) = report.facts["episodes"]
    assert episode["end_ns"] - episode["begin_ns"] == 500_000_000
    assert sum("under way: this begin is kept" in note for note in notes) == 2


def test_contact_begins_no_episode_of_a_hand_without_fingertips_or_calibration(tmp_path):
    # The port is not there: nothing opens it.
    for words, settings in (("without fingertips", {}), ("not calibrated", {"calibrate_s": 0.0})):
        device = DEVICE if settings else replace(DEVICE, fingertip_names=())
        with pytest.raises(UsageError, match=words):
            run(str(tmp_path / "nowhere"), tmp_path / "touch", SessionPlan(on_contact=True), device=device, **settings)


@pytest.mark.parametrize(("hush_at", "problem"), [(70, "the hand fell silent"), (0, "the port gave no byte")])
def test_a_session_whose_hand_is_silent_ends_with_what_it_has(hush_at, problem, hand, tmp_path):
    one, folder = hand(silent=not hush_at), tmp_path / "silent"
    plan = SessionPlan(2, None, 0.1, True)
    report, notes = run(one.port, folder, plan, [(45, " ")], {hush_at: one.hush}, silence_s=0.5, patience_s=0.4)
    assert isinstance(report.failure, SetupError)
    assert problem in report.failure.problem
    assert sum("no bytes for" in note for note in notes) == 1
    assert len(report.facts["episodes"]) == (1 if hush_at else 0)
    if hush_at:
        assert len(episodes_of(folder).episodes) == 1
