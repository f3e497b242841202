"""The evaluation's page: its words, its figures, and that it asks for nothing."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup

from candata.errors import SetupError
from candata.reports import evaluation as report
from candata.reports.courses import COORDINATES, course
from candata.reports.standing import standing
from candata.training.results import EpisodeScores, Evaluation
from tests.reports.evaluations import (
    LARGEST_PAGE,
    NAMES,
    TRACKS,
    facts,
    make_evaluation,
    make_pairs,
    make_track,
)


class Page(HTMLParser):
    """Addresses of a page, the labels of its drawings, and the texts that show when something is pointed at."""

    def __init__(self, text: str):
        super().__init__()
        self.addresses, self.drawings, self.tooltips, self._tag = [], [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.addresses += [value for name, value in attributes if name in ("src", "href")]
        self.drawings += [values["aria-label"]] if values.get("role") == "img" else []
        self._tag = tag

    def handle_data(self, text):
        if self._tag == "title":
            self.tooltips.append(text)


def visible_text(text: str) -> str:
    """The page's text as a reader sees it."""
    return html.unescape(re.sub(r"<[^>]+>", " ", text))


def test_both_files_are_written(tmp_path):
    evaluation = make_evaluation()
    path = report.write_evaluation(evaluation, TRACKS, tmp_path / "new")
    assert sorted(p.name for p in path.parent.iterdir()) == ["evaluation.html", "evaluation.json"]
    assert Evaluation.model_validate_json((path.parent / "evaluation.json").read_text()) == evaluation
    assert path.stat().st_size < LARGEST_PAGE


def test_the_page_asks_for_nothing_and_has_every_figure(tmp_path):
    text = report.write_evaluation(make_evaluation(), TRACKS, tmp_path).read_text("utf-8")
    page = Page(text)
    assert all(address.startswith("data:") for address in page.addresses)
    assert not re.search(r"url\(|@import", text[: text.index("<body")])
    assert page.drawings == [
        "position error against the horizon",
        "rotation error against the horizon",
        "adds against the horizon",
        "paths of the object in space",
        "contact in ep-0",
        "paths of the object in space",
        "contact in ep-1",
        *(f"{name} of sampled loops in ep-0" for name in COORDINATES),
        "ADD-S AUC of every episode",
    ]


def test_a_page_that_cannot_be_written_says_so(tmp_path, monkeypatch):
    def raise_disk_full(path, *_arguments, **_options):
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", raise_disk_full)
    with pytest.raises(SetupError, match=r"the page cannot be written\n\s+found: No space left on device"):
        report.write_evaluation(make_evaluation(), TRACKS, tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_the_page_says_what_it_is():
    text = visible_text(report.page(make_evaluation(), TRACKS))
    for words in (
        "first is best at 97.5 % ADD-S AUC: 5.5 points above the nominal simulator and 22.5 points above",
        "first: +5.5 points over the nominal simulator (95 % +4.5 to +6.5)",
        "joints too",
        "28 of 40",
        "54.6 to 81.9 %",
        "87.5 to 92.5 %",
        "-2.5 (-3.5 to -1.5)",
        "2 s (38 episodes)",
        "90.0 %; 10 mm, 2.86°",
        "+0.10 s (-0.10 to +0.20)",
        "2 of 9, 1",
        "24 rows are marked as missing",
        "past actions only",
        "no servo is modelled",
        "run free from the row at which the loop begins, the scene of each episode",
        "past and planned actions; the simulator: the scene of each episode, effects: object_mass",
    ):
        assert words in text, words
    assert "By object" not in text  # there is one
    assert "5 s (" not in text  # no episode is so long


def test_a_film_stands_on_the_page():
    text = report.page(make_evaluation(), TRACKS, {"ep-0": Markup("<b>strip</b>")})
    assert "<b>strip</b>" in text
    assert "In pictures" not in report.page(make_evaluation(), TRACKS)


def test_paths_tell_whose_they_are_when_and_where():
    tooltips = Page(report.page(make_evaluation(), TRACKS)).tooltips
    assert "recorded, 0.70 s: 10, 5, 6 cm" in tooltips
    assert "first, 3.20 s: 10, 5, 10 cm" in tooltips
    assert "the loop begins here" in tooltips
    assert {name for name in ("recorded", *NAMES) if name in tooltips} == {"recorded", *NAMES}


def test_contact_is_drawn_of_those_who_forecast_it_and_not_of_baselines():
    tooltips = Page(report.page(make_evaluation(), TRACKS)).tooltips
    assert any(text.endswith("recorded: 1\nfirst: 1.00\nsimulator: 1.00") for text in tooltips)


def test_each_step_of_the_horizon_tells_those_who_look_so_far():
    tooltips = Page(report.page(make_evaluation(), TRACKS)).tooltips
    (last_step,) = [text for text in tooltips if text.startswith("1.6 s ahead") and "energy" in text]
    assert last_step.splitlines()[1:] == [
        "first (contact_diffusion, mean of 16 samples): 10 mm",
        "energy score of the samples of first: 8 mm",
        "the simulator: 27.6 mm",
        "the object stays: 82 mm",
    ]


def test_paths_that_fly_off_stand_or_are_not_finite_are_drawn():
    flying_track, standing_track = make_track(), make_track()
    flying_track.poses["stays"][5:, 0] = 1e6
    flying_track.poses["first"][9:] = np.nan
    standing_track.truth[:] = standing_track.truth[0]
    standing_track.poses["first"][:] = standing_track.truth[0]
    for track in (flying_track, standing_track):
        markup = course(track, "first")
        assert "nan" not in markup
        assert max(abs(int(number)) for number in re.findall(r"-?\d+", markup)) < 10_000


@pytest.mark.parametrize(
    ("changes", "tone"),
    [
        ({}, "good"),
        ({"pairs": make_pairs(0.1)}, "part"),
        ({"pairs": make_pairs(None)}, "part"),
        ({"episodes": 29}, "part"),
    ],
)
def test_the_colour_says_whether_the_lead_over_simulator_and_baselines_is_sure(changes, tone):
    assert standing(make_evaluation(**changes))[0] == tone


def test_a_simulator_that_is_best_is_named_and_the_best_model_beside_it():
    forecasters = make_evaluation().forecasters
    swapped = forecasters | {"simulator": forecasters["first"], "first": forecasters["simulator"]}
    evaluation = make_evaluation(forecasters=swapped)
    tone, headline = standing(evaluation)
    assert (tone, headline.split(":")[0]) == ("bad", "The nominal simulator is best at 97.5 % ADD-S AUC")
    assert "second: " in report.summary(evaluation)


def test_fewer_than_30_trajectories_have_a_table_without_intervals_that_says_so():
    text = visible_text(report.page(make_evaluation(episodes=29), TRACKS))
    assert "29 test trajectories are fewer than 30: the tables have no intervals" in text
    assert "28 of 40" in text
    for interval in ("54.6 to 81.9 %", "(-3.5 to -1.5)", "87.5 to 92.5 %"):
        assert interval not in text


def test_without_clouds_and_contact_their_parts_are_left_out():
    tracks = [make_track(0, contact=False)]
    tracks[0].sampled.clear()
    text = report.page(make_evaluation(adds=False, contact=False), tracks)
    assert Page(text).drawings == [
        "position error against the horizon",
        "rotation error against the horizon",
        "paths of the object in space",
    ]
    assert "first ends nearest, 8 mm off; no ADD-S: not every object has a point cloud" in text
    assert "It does not forecast contact." in text
    assert "Contact in closed loop" not in text


def test_episodes_that_were_trained_on_are_said():
    seen = {"first": facts("mlp", seen_episodes=2), "second": facts("mlp", seen_episodes=None)}
    text = visible_text(report.page(make_evaluation(models=seen), TRACKS))
    assert "No verdict: first was trained on 2 of these 40 episodes" in text
    assert "not known" in text
    assert "on all episodes of" in report.page(make_evaluation(group="all"), TRACKS)
    assert "first was trained on 2" in report.summary(make_evaluation(models=seen))


def test_joints_that_follow_a_servo_are_said():
    text = visible_text(report.page(make_evaluation(joints_from="servo"), TRACKS))
    assert "joints follow a servo lag fitted on training episodes (servo)" in text
    assert "each joint a first-order lag" in text


def test_hostile_names_stay_text():
    hostile = "</script><script>alert(1)</script>"
    episode = EpisodeScores(id=hostile, moved_m=0.1, adds_auc={NAMES[0]: 0.9}, final_position_error_m={NAMES[0]: 0.1})
    text = report.page(make_evaluation(dataset=hostile, by_episode=[episode]), [replace(make_track(), id=hostile)])
    assert hostile not in text


def test_the_summary_is_a_row_each():
    lines = report.summary(make_evaluation(notes=("no simulator",))).splitlines()
    assert lines[0].startswith("first is best at 97.5 % ADD-S AUC")
    assert [line.split()[0] for line in lines[3:7]] == list(NAMES)
    assert lines[3].split()[1:4] == ["97.5", "%", "28/40"]
    assert "at 1.2 s" in lines[4]
    assert lines[-1] == "no simulator"


#: Turns the first path by a drag, and tells what is drawn.
DRAG = """() => {
  const svg = document.querySelector("svg.space"), path = svg.querySelector(".loop"), before = path.getAttribute("d");
  const at = (name, x, y) => svg.dispatchEvent(new PointerEvent(name, { clientX: x, clientY: y, pointerId: 1 }));
  svg.setPointerCapture = () => {};
  for (const [name, x, y] of [["pointerdown", 50, 50], ["pointermove", 90, 60], ["pointerup", 90, 60]]) at(name, x, y);
  const height = element => element.getBoundingClientRect().height;
  const drawn = [...document.querySelectorAll("[role=img]")].filter(drawing => height(drawing) > 50).length;
  return { turned: before !== path.getAttribute("d"), drawn };
}"""


@pytest.mark.parametrize("width", [1280, 380])
def test_every_figure_is_drawn_and_a_path_turns(browse, width):
    assert browse(report.page(make_evaluation(), TRACKS), DRAG, width) == {"turned": True, "drawn": 12}
