"""What a recording shows: the panel's words and lights, and the plain line."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from candata.record.panel import line, panel
from candata.record.recorder_values import RecorderView, StreamView
from candata.record.session_run import SessionView
from candata.schema.contact import fingertip_contact
from candata.schema.session import SessionEpisode

LOSSES = {"crc_failures": 0, "garbage_bytes": 0, "oversize": 0, "requests_without_reply": 0}


def view_of(**changes) -> RecorderView:
    fields = {
        "phase": "recording",
        "elapsed_s": 83.4,
        "rate_hz": 82.6,
        "nominal_hz": 83.0,
        "force_N": np.array([[0.1, 0.1, 0.1], [0.1, 0.1, 0.2], [0.0, -3.0, 14.0]]),
        "fingertip_names": ("thumb", "index", "mid"),
        "frames": {"state": 6921, "command": 6922, "other": 0},
        "losses": LOSSES,
        "saturated": {"forces": 0, "taxels": 0},
        "gaps": 0,
        "size_bytes": 36_900_000,
    }
    fields |= changes
    return RecorderView(**{"contact": fingertip_contact(fields["force_N"]), **fields})


def drawn(view: RecorderView, notes=()) -> str:
    console = Console(file=io.StringIO(), width=80)
    console.print(panel(view, "a title", notes))
    return console.file.getvalue()


def test_the_panel_shows_rate_forces_and_lights():
    text = drawn(view_of(), ["first", "second", "third", "fourth"])
    rows = {words[1]: words for words in map(str.split, text.splitlines()) if len(words) > 2}
    # Three tenths of a newton are no contact: the rule is "more than", and 0.1 + 0.1 + 0.1 > 0.3 in floats.
    assert rows["thumb"][2] == "○"
    assert rows["index"][2:4] == ["●", "touch"]
    assert rows["mid"][-5:-1] == ["17.0", "+0.0", "-3.0", "+14.0"]
    for words in ("a title", "recording", "83 Hz of 83", "0:01:23", "36.9 MB", "0 gaps", "0 no reply", "fourth"):
        assert words in text
    assert "first" not in text


def test_a_bar_is_full_at_ten_newton():
    rows = [row for row in drawn(view_of(force_N=np.diag([0.0, 5.0, 30.0]))).splitlines() if "·" in row or "█" in row]
    assert [row.count("█") for row in rows] == [0, 10, 20]


@pytest.mark.parametrize(
    ("phase", "words"), [("waiting", "waiting"), ("calibrating", "do not touch"), ("unplugged", "waiting for the port")]
)
def test_the_phase_is_said(phase, words):
    assert words in drawn(view_of(phase=phase))


def test_losses_are_counted_in_the_panel_and_the_line():
    view = view_of(losses=LOSSES | {"crc_failures": 3}, gaps=2)
    assert "3 crc failures" in drawn(view)
    assert line(view).startswith(
        "0:01:23 recording: 83 Hz, 6921 states, 2 gaps, 3 crc failures, 36.9 MB | N: thumb=0.3 "
    )
    assert "index=0.4* mid=17.0*" in line(view)
    assert "nothing lost" in line(view_of())


def test_streams_beside_the_hand_show_their_rate_and_their_silence():
    streams = (
        StreamView("arm", "recording", 199.8, 200.0, 16_000, 0, {"malformed": 0}, 0.0),
        StreamView("pose", "silent", 0.0, 15.0, 700, 3, {"malformed": 2}, 4.2),
    )
    view = view_of(streams=streams)
    text = drawn(view)
    assert "arm" in text
    assert "200" in text
    assert "silent for 4.2 s" in text
    assert line(view).endswith(
        "| arm: 200 Hz, 16000 frames, 0 gaps, nothing lost | pose: 0 Hz, 700 frames, 3 gaps, silent for 4.2 s"
    )


def test_a_session_shows_its_episodes_its_marks_and_the_keys():
    one = SessionEpisode(number=1, begin_ns=0, end_ns=1, outcome="slip")
    episodes = (one, one.model_copy(update={"number": 2, "discarded": True}), SessionEpisode(number=3, begin_ns=5))
    session = SessionView(episodes, ("begin (key space): episode 3",), 2.5, 20, "space begins/ends")
    view = view_of(session=session)
    text = drawn(view)
    for words in (
        "episode 3 of 20: 2.5 s",
        "1 slip",
        "1 not judged",
        "1 discarded",
        "begin (key space)",
        "space begins",
    ):
        assert words in text
    assert line(view).endswith("| episode 3 of 20: 2.5 s")
    assert "episode" not in line(view_of())
