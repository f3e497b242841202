"""The pages on datasets: everything in its place, nothing from outside, no name trusted, never large."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.compare import compare
from candata.datasets.survey import survey
from candata.datasets.writing import write_text
from candata.errors import SetupError
from candata.reports import comparison, inspection, playback
from candata.reports.joint_units import readable_unit
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

EVIL = "<script>alert(1)</script>&\"'"


class Tags(HTMLParser):
    """Balance of the tags, and how many scripts and marks of each class there are."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self, text):
        super().__init__()
        self.open, self.scripts, self.classes = [], 0, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.scripts += tag == "script" and "type" not in dict(attrs)
        self.classes += (dict(attrs).get("class") or "").split()
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.classes += (dict(attrs).get("class") or "").split()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def make_episode(name="e", rows=60, source="sim", **arrays):
    rng = np.random.default_rng(3)
    meta = {k: arrays.pop(k) for k in ("joint_names", "fingertip_names", "task", "scene") if k in arrays}
    if not arrays:
        arrays = {
            "object_pose": np.c_[
                np.cumsum(rng.normal(size=(rows, 3)), axis=0) * 0.01, np.tile([1, 0, 0, 0], (rows, 1))
            ],
            "joint_position": rng.normal(size=(rows, 2)),
            "action": rng.normal(size=(rows, 2)),
            "fingertip_force": rng.normal(size=(rows, 2, 3)),
            "fingertip_contact": rng.random((rows, 2)) > 0.5,
        }
    fields = {"id": name, "source": source, "rate_hz": 80.0} | meta
    return Episode(EpisodeMeta.model_validate(fields), {"time_ns": np.arange(rows) * 12_500_000} | arrays)


def page(data, episode=None, scene=None):
    """The page of a dataset, or of one of its episodes."""
    playbacks = playback.Playbacks(data, scene)
    found = survey(data, ids=None if episode is None else [episode], watch=playbacks.add)
    return inspection.page(found, playbacks, None if episode is None else data.episode(episode))


@pytest.fixture
def dataset(tmp_path):
    def make(*episodes, name="ds"):
        root = create_dataset(tmp_path / name)
        append(root, list(episodes), Lineage(operation="test", details={"from": EVIL}))
        return open_dataset(root)

    return make


def test_a_page_has_every_part_and_asks_for_nothing(dataset):
    data = dataset(make_episode("a"), make_episode("b", rows=90))
    whole, single = page(data), page(data, "b")
    for text, headings in (
        (whole, ("Episodes", "Channels", "Contact", "Distributions", "Where it comes from")),
        (single, ("Playback", "Figures", "Object in space", "Forces", "Joints and commands")),
    ):
        tags = Tags(text)
        assert tags.open == []
        for heading in headings:
            assert f">{heading}</h" in text, heading
        assert not re.search(r"(src|href)=\"(?!data:)", text)
        assert tags.classes.count("histo") == 7 - 4 + 2 + 2 + 6  # a quaternion that stands is said in words
    assert (Tags(whole).classes.count("space"), Tags(single).classes.count("space")) == (0, 1)


def test_all_episodes_are_listed_and_can_be_opened(dataset):
    text = page(dataset(*(make_episode(f"e{i}", rows=20 + i, task="lift") for i in range(5))))
    assert re.findall(r'data-open="(\d)">(e\d)<', text) == [(str(i), f"e{i}") for i in range(5)]
    assert re.findall(r'class="playback" data-number="(\d)"', text) == list("01234")
    assert text.count(">lift</td>") == 5
    assert ">outcome</button>" not in text, "a label that no episode has"


def test_a_full_page_lists_what_it_cannot_open(dataset, monkeypatch):
    data = dataset(*(make_episode(f"e{i}") for i in range(4)))
    alone = playback.Playbacks(data)
    alone.add(data[0])
    monkeypatch.setattr(playback, "PAGE_BYTES", len(alone.episodes["e0"]) * 3 // 2)
    text = page(data)
    opened = re.findall(r'data-open="\d', text)
    assert 0 < len(opened) < 4
    assert f"{4 - len(opened)} episodes cannot be opened here" in text
    assert ">e3</td>" in text


def test_names_are_text(dataset):
    names = {"joint_names": (EVIL, "b"), "fingertip_names": (EVIL, "t"), "task": EVIL, "scene": EVIL}
    data = dataset(make_episode(EVIL, **names))
    for text in (
        page(data),
        page(data, EVIL),
        comparison.page(compare(data, data)),
    ):
        assert "<script>alert" not in text
        assert Tags(text).scripts <= 1
        assert "&lt;script&gt;alert" in text


@pytest.mark.parametrize(
    ("arrays", "absent"),
    [
        ({"object_pose": np.tile([0, 0, 0, 1.0, 0, 0, 0], (60, 1))}, "no contact, no forces, no joints."),
        ({"joint_position": np.zeros((60, 2))}, "no valid pose of an object, no contact, no forces."),
        (
            {
                "object_pose": np.full((60, 7), np.nan),
                "object_pose_valid": np.zeros(60, bool),
                "joint_position": np.zeros((60, 1)),
                "contact": np.zeros(60, bool),
            },
            "no valid pose of an object, no forces.",
        ),
    ],
)
def test_what_an_episode_lacks_is_said(dataset, arrays, absent):
    text = page(dataset(make_episode(**arrays)), "e")
    assert f"This episode has {absent}" in text
    assert Tags(text).open == []


def test_one_row_is_drawn(dataset):
    episode = make_episode(rows=1)
    text = page(dataset(episode), "e")
    assert "1 row.<" in text.replace("</dd>", "<")
    assert not re.search(r"\bnan\b", re.sub(r"<script.*?</script>", "", text, flags=re.S).lower())


def test_a_long_episode_of_many_joints_stays_small(dataset):
    rng, rows = np.random.default_rng(0), 12_000
    episode = make_episode(
        rows=rows,
        joint_position=rng.normal(size=(rows, 80)),
        action=rng.normal(size=(rows, 80)),
        fingertip_force=rng.normal(size=(rows, 10, 3)),
        fingertip_contact=rng.random((rows, 10)) > 0.5,
    )
    text = page(dataset(episode), "e")
    assert len(text) < 2e6
    assert "40 more are not drawn" in text
    assert "16 more elements are not drawn" in text


def test_units_come_from_a_built_in_scene(dataset):
    names = ("wrist_x", "index1")
    text = page(dataset(make_episode(scene="xhand_tabletop", joint_names=names)), "e")
    assert readable_unit("joint/s", "index1", inspection.units_of(["xhand_tabletop"])) == "rad/s"
    assert '<p>wrist_x</p><div class="chart"' in text
    assert re.search(r'<p>wrist_x</p><div class="chart"[^>]*><span class="yl">m<', text)
    assert re.search(r'<p>index1</p><div class="chart"[^>]*><span class="yl">rad<', text)
    assert "rad or m" in page(dataset(make_episode(), name="other"), "e")


def test_two_datasets_on_one_page(dataset):
    pair = compare(dataset(make_episode("a"), name="one"), dataset(make_episode("b", source="real"), name="two"))
    text = comparison.page(pair)
    assert Tags(text).open == []
    assert "one <small>beside</small> two" in text
    assert "Too few episodes to tell a difference from luck (1 beside 1)" in text
    assert text.count("<tr") >= len(pair.comparison.rows)


def test_a_page_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "page.html").mkdir()
    with pytest.raises(SetupError, match="cannot be written"):
        write_text(tmp_path / "page.html", "x")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
