"""Pages in a browser: what a click and a drag do, nothing overlaps or scrolls sideways, and the console is silent."""

from __future__ import annotations

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.compare import compare
from candata.datasets.survey import survey
from candata.reports import comparison, inspection, page, validation
from candata.reports.playback import Playbacks
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

WIDTHS = pytest.mark.parametrize("width", [1280, 380])
#: Clicks what lies at the middle of a cell, as a mouse would, and tells what can be seen before and after.
CLICK = """() => {
  const seen = () => [...document.querySelectorAll(".panel")].filter(p => p.getBoundingClientRect().height > 0)
    .map(p => ({ element: p.dataset.element, dots: p.querySelectorAll(".dots.before path").length,
      courses: p.querySelectorAll(".course .line.recorded").length }));
  const before = seen();
  const row = document.querySelector('[data-shows="fingertip_force index_tip"]');
  row.scrollIntoView({ block: "center" });
  const box = row.querySelector("td:last-child").getBoundingClientRect();
  document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).click();
  return { before, after: seen(), pressed: row.querySelector("button").ariaPressed };
}"""
#: Turns the first path by a drag, and tells whether it turned, and whether charts overlap.
DRAG = """() => {
  const svg = document.querySelector("svg.space"), path = svg && svg.querySelector(".way, .loop");
  const before = path && path.getAttribute("d");
  const at = (name, x, y) => svg.dispatchEvent(new PointerEvent(name, { clientX: x, clientY: y, pointerId: 1 }));
  if (svg) {
    svg.setPointerCapture = () => {};
    at("pointerdown", 50, 50); at("pointermove", 90, 60); at("pointerup", 90, 60);
  }
  const boxes = [...document.querySelectorAll(".chart")].map(c => c.getBoundingClientRect());
  const apart = boxes.every((a, i) => boxes.slice(i + 1).every(b =>
    a.right <= b.left + 1 || b.right <= a.left + 1 || a.bottom <= b.top + 1 || b.bottom <= a.top + 1));
  return { turned: svg ? before !== path.getAttribute("d") : null, apart, charts: boxes.length };
}"""


@WIDTHS
def test_a_click_on_the_heat_map_shows_the_elements_episodes(
    browse, make_report, full_evidence, hand, no_gl, small_pictures, width
):
    observed = browse(page.page(make_report(), full_evidence, hand, "effects: []\n"), CLICK, width)
    assert observed["before"] == [{"element": "joint_position index2", "dots": 24, "courses": 3}]
    assert observed["after"] == [{"element": "fingertip_force index_tip", "dots": 24, "courses": 3}]
    assert observed["pressed"] == "true"


def make_dataset(path, seed):
    rng, episodes = np.random.default_rng(seed), []
    names = tuple(f"a_joint_with_quite_a_long_name_{i}" for i in range(5))
    for k in range(6):
        rows = 80 - k
        walk = np.cumsum(rng.normal(size=(rows, 3)), axis=0) * 0.01
        arrays = {
            "time_ns": np.arange(rows) * 12_500_000,
            "object_pose": np.c_[walk, np.tile([1, 0, 0, 0], (rows, 1))],
            "joint_position": np.cumsum(rng.normal(size=(rows, 5)), axis=0),
            "action": np.cumsum(rng.normal(size=(rows, 5)), axis=0),
            "fingertip_force": rng.normal(size=(rows, 5, 3)),
            "fingertip_contact": rng.random((rows, 5)) > 0.5,
        }
        meta = EpisodeMeta(id=f"e{k}", source="sim", rate_hz=80.0, joint_names=names, actuator_names=names)
        episodes.append(Episode(meta, arrays))
    append(create_dataset(path), episodes, Lineage(operation="test"))
    return open_dataset(path)


#: Searches, sorts, opens an episode, moves its time and turns the view, and tells what changed.
PLAY = """() => {
  const rows = () => [...document.querySelectorAll(".episodes tbody tr")]
    .filter(row => !row.hidden).map(row => row.cells[0].innerText);
  const ink = canvas => canvas.toDataURL().length > 3000 ? canvas.toDataURL() : "";
  const search = document.querySelector(".search"), stage = document.querySelector(".stage");
  const type = text => { search.value = text; search.dispatchEvent(new Event("input")); return rows(); };
  const found = type("E3"), all = type("");
  document.querySelectorAll(".episodes th button")[2].click();
  const sorted = rows();
  document.querySelector('[data-open="4"]').click();
  const name = document.querySelector(".player-name").textContent, start = ink(stage);
  const lane = document.querySelector(".lane canvas"), slider = document.querySelector(".scrub input");
  const before = ink(lane);
  slider.value = slider.max / 2;
  slider.dispatchEvent(new Event("input"));
  const later = ink(stage);
  const at = (name, x, y) => stage.dispatchEvent(new PointerEvent(name, { clientX: x, clientY: y, pointerId: 1 }));
  stage.setPointerCapture = () => {};
  at("pointerdown", 50, 50); at("pointermove", 90, 60); at("pointerup", 90, 60);
  return { found, all: all.length, sorted, name, clock: document.querySelector(".scrub output").textContent,
    drawn: start !== "" && before !== "", moved: start !== later && before !== ink(lane), turned: later !== ink(stage),
    lanes: document.querySelectorAll(".lane").length };
}"""


@WIDTHS
def test_the_page_of_a_dataset_searches_sorts_and_plays(browse, tmp_path, width):
    data = make_dataset(tmp_path / "one", 1)
    playbacks = Playbacks(data)
    observed = browse(inspection.page(survey(data, watch=playbacks.add), playbacks), PLAY, width)
    assert observed == {
        "found": ["e3"],
        "all": 6,
        "sorted": [f"e{k}" for k in (5, 4, 3, 2, 1, 0)],
        "name": "e4",
        "clock": "0.47 s",
        "drawn": True,
        "moved": True,
        "turned": True,
        "lanes": 5,
    }


@WIDTHS
def test_the_page_of_an_episode_fits_and_its_path_turns(browse, tmp_path, width):
    data = make_dataset(tmp_path / "one", 1)
    playbacks = Playbacks(data)
    found = survey(data, ids=["e0"], watch=playbacks.add)
    observed = browse(inspection.page(found, playbacks, data["e0"]), DRAG, width)
    assert observed.pop("charts") > 5
    assert observed == {"turned": True, "apart": True}


@WIDTHS
def test_the_page_of_two_datasets_fits(browse, tmp_path, width):
    pair = compare(make_dataset(tmp_path / "one", 1), make_dataset(tmp_path / "two", 2))
    observed = browse(comparison.page(pair), DRAG, width)
    assert observed.pop("charts") > 5
    assert observed == {"turned": None, "apart": True}


@WIDTHS
def test_the_page_of_a_validation_fits(browse, tmp_path, width):
    dataset = make_dataset(tmp_path / "one", 1)
    assert browse(validation.page(dataset, check(dataset)), DRAG, width)["charts"] == 0
