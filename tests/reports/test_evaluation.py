"""The evaluation's page: its words, its figures, and that it asks for nothing."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from candata.errors import SetupError
from candata.reports import evaluation as report
from candata.reports.courses import course
from candata.training.results import (
    ClosedLoopScores,
    Contact,
    EpisodeScores,
    Evaluation,
    Gain,
    Scores,
    Success,
    Track,
    WindowScores,
)

NAMES = ("contact_diffusion", "stays", "keeps_velocity")
#: Many episodes included.
LARGEST_PAGE = 400_000


def scores(summary: str, size: float, adds: bool = True, contact: bool = True) -> Scores:
    """Errors that grow with the horizon in proportion to `size`."""
    errors_m = tuple(0.002 + size * k for k in range(1, 17))
    contact_scores = Contact(precision=0.9, recall=0.8, f1=0.847) if contact else None
    windows = WindowScores(
        position_error_m=errors_m,
        rotation_error_rad=tuple(5 * v for v in errors_m),
        position_mse_m2=tuple(v**2 for v in errors_m),
        rotation_mse_rad2=tuple(25 * v**2 for v in errors_m),
        position_energy_m=tuple(0.8 * v for v in errors_m),
        adds_m=tuple(v / 2 if adds else None for v in errors_m),
        adds_auc=1 - 40 * size if adds else None,
        contact=contact_scores,
    )
    success = Success(count=14, total=19, share=14 / 19, low=0.512, high=0.882)
    closed_loop = ClosedLoopScores(
        adds_auc=1 - 50 * size if adds else None,
        adds_m=size * 8 if adds else None,
        position_error_m=size * 12,
        rotation_error_rad=size * 50,
        final_position_error_m=size * 16,
        success=success,
        contact=contact_scores,
    )
    return Scores(summary=summary, windows=windows, closed_loop=closed_loop)


def make_evaluation(adds: bool = True, contact: bool = True, **changes: object) -> Evaluation:
    summaries = (
        "the model (contact_diffusion, mean of 16 samples)",
        "the object stays",
        "the object keeps its velocity",
    )
    forecasters = {
        name: scores(text, size, adds, contact or number > 0)
        for number, (name, text, size) in enumerate(zip(NAMES, summaries, (0.0005, 0.0016, 0.005), strict=True))
    }
    auc = {"contact_diffusion": 0.94, "stays": 0.88, "keeps_velocity": 0.7} if adds else {}
    fields = {
        "run": "first",
        "checkpoint": "best.safetensors",
        "step": 4000,
        "model": NAMES[0],
        "trained_on": "sim@0123456789ab",
        "dataset": "sim@0123456789ab",
        "split": "default",
        "group": "test",
        "seen_episodes": 0,
        "episodes": 2,
        "windows": 620,
        "rows": 480,
        "rate_hz": 10.0,
        "history": 8,
        "horizon": 16,
        "samples": 16,
        "sampling_steps": 10,
        "execute": 8,
        "seed": 0,
        "contact_from": "predicted",
        "forecasters": forecasters,
        "gain": {name: Gain(value=0.05, low=0.03, high=0.08) for name in NAMES[1:]} if adds else {},
        "by_episode": [
            EpisodeScores(id=f"ep-{k}", moved_m=0.03 * k, adds_auc=auc, final_position_error_m={NAMES[0]: 0.01})
            for k in range(2)
        ],
        "revision": "0.1.0",
    }
    return Evaluation.model_validate(fields | changes)


def make_track(number: int = 0, contact: bool = True) -> Track:
    """A lift, which the model follows half way."""
    time_s = 0.7 + np.arange(26) / 10
    truth = np.tile([0.1, 0.05, 0.06, 1.0, 0, 0, 0], (26, 1))
    truth[:, 2] += 0.08 * np.clip(time_s - 1, 0, 1)
    half_lift = truth.copy()
    half_lift[:, 2] = (truth[:, 2] + 0.06) / 2
    drifting = truth.copy()
    drifting[:, 0] += 0.1 * (time_s - 0.7)
    poses = {"contact_diffusion": half_lift, "stays": np.tile(truth[0], (26, 1)), "keeps_velocity": drifting}
    forecast = np.concatenate([[np.nan], np.linspace(0, 1, 25)])
    return Track(f"ep-{number}", time_s, truth, poses, time_s > 1 if contact else None, forecast if contact else None)


TRACKS = (make_track(0), make_track(1))


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
        "Better than every baseline",
        "joints and actions are replayed",
        "14 of 19",
        "51 to 88 %",
        "97.5 %",
        "92.0 %",
        "+5.0 (+3.0 to +8.0)",
        "10 mm",
        "the model's own forecast",
        "no servo is modelled",
    ):
        assert words in text, words


def test_paths_tell_whose_they_are_when_and_where():
    tooltips = Page(report.page(make_evaluation(), TRACKS)).tooltips
    assert "recorded, 0.70 s: 10, 5, 6 cm" in tooltips
    assert "contact_diffusion, 3.20 s: 10, 5, 10 cm" in tooltips
    assert "the loop begins here" in tooltips
    assert {name for name in ("recorded", *NAMES) if name in tooltips} == {"recorded", *NAMES}


def test_each_step_of_the_horizon_tells_all_forecasters():
    tooltips = Page(report.page(make_evaluation(), TRACKS)).tooltips
    (last_step,) = [text for text in tooltips if text.startswith("1.6 s ahead") and "energy" in text]
    assert last_step.splitlines()[1:] == [
        "the model (contact_diffusion, mean of 16 samples): 10 mm",
        "energy score of its samples: 8 mm",
        "the object stays: 27.6 mm",
        "the object keeps its velocity: 82 mm",
    ]


def test_paths_that_fly_off_stand_or_are_not_finite_are_drawn():
    flying_track, standing_track = make_track(), make_track()
    flying_track.poses["stays"][5:, 0] = 1e6
    flying_track.poses["contact_diffusion"][9:] = np.nan
    standing_track.truth[:] = standing_track.truth[0]
    standing_track.poses["contact_diffusion"][:] = standing_track.truth[0]
    for track in (flying_track, standing_track):
        markup = course(track)
        assert "nan" not in markup
        assert max(abs(int(number)) for number in re.findall(r"-?\d+", markup)) < 10_000


@pytest.mark.parametrize(
    ("gains", "headline"),
    [
        ({"a": (0.1, 0.02, 0.2), "b": (0.3, 0.1, 0.4)}, "Better than every baseline"),
        ({"a": (0.1, -0.02, 0.2), "b": (0.3, 0.1, 0.4)}, "Ahead of every baseline, but not surely"),
        ({"a": (0.1, None, None), "b": (0.3, None, None)}, "Ahead of every baseline, but not surely"),
        ({"a": (-0.1, -0.2, 0.1), "b": (0.3, 0.1, 0.4)}, "No better than a baseline"),
    ],
)
def test_the_headline_follows_the_gains(gains, headline):
    gain = {name: Gain(value=v, low=low, high=high) for name, (v, low, high) in gains.items()}
    assert report.verdict(make_evaluation(gain=gain))[1] == headline


def test_without_clouds_and_contact_their_parts_are_left_out():
    tracks = [make_track(0, contact=False)]
    text = report.page(make_evaluation(adds=False, contact=False, contact_from="not read"), tracks)
    assert Page(text).drawings == [
        "position error against the horizon",
        "rotation error against the horizon",
        "paths of the object in space",
    ]
    assert "No ADD-S: not every object has a point cloud" in text
    assert "The model does not forecast contact." in text


def test_episodes_that_were_trained_on_are_said():
    text = report.page(make_evaluation(seen_episodes=2), TRACKS)
    assert "2 of them were trained on." in text
    assert "No verdict: trained on 2 of these 2 episodes" in text
    assert "on all episodes of" in report.page(make_evaluation(group="all"), TRACKS)
    assert "2 of the episodes were trained on" in report.summary(make_evaluation(seen_episodes=2))


def test_what_is_not_known_or_replayed_is_said():
    evaluation = make_evaluation(seen_episodes=None, contact_from="predicted, fingertips recorded")
    text = visible_text(report.page(evaluation, TRACKS))
    assert "not known: the run's split is not beside the checkpoint" in text
    assert "each fingertip's replayed from the recording" in text


def test_hostile_names_stay_text():
    hostile = "</script><script>alert(1)</script>"
    episode = EpisodeScores(id=hostile, moved_m=0.1, adds_auc={NAMES[0]: 0.9}, final_position_error_m={NAMES[0]: 0.1})
    text = report.page(make_evaluation(dataset=hostile, by_episode=[episode]), [replace(make_track(), id=hostile)])
    assert hostile not in text


def test_the_summary_is_a_row_each():
    lines = report.summary(make_evaluation()).splitlines()
    assert lines[0] == "Better than every baseline: contact_diffusion, step 4,000"
    assert [line.split()[0] for line in lines[3:6]] == list(NAMES)
    assert lines[3].split()[1:4] == ["97.5", "%", "14/19"]


#: Turns the first path by a drag, and tells what is drawn.
DRAG = """() => {
  const svg = document.querySelector("svg.space"), path = svg.querySelector(".loop");
  const before = path.getAttribute("d");
  const at = (name, x, y) => svg.dispatchEvent(new PointerEvent(name, { clientX: x, clientY: y, pointerId: 1 }));
  svg.setPointerCapture = () => {};
  at("pointerdown", 50, 50); at("pointermove", 90, 60); at("pointerup", 90, 60);
  const height = element => element.getBoundingClientRect().height;
  const drawings = [...document.querySelectorAll("[role=img]")];
  return { turned: before !== path.getAttribute("d"), drawn: drawings.filter(d => height(d) > 50).length };
}"""


@pytest.mark.parametrize("width", [1280, 380])
def test_every_figure_is_drawn_and_a_path_turns(browse, width):
    assert browse(report.page(make_evaluation(), TRACKS), DRAG, width) == {"turned": True, "drawn": 8}
