"""Figures hold what the values hold: lines, commands, bars, and no more."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest

from candata import plot
from candata.datasets import append, create_dataset, open_dataset
from candata.errors import MissingExtraError, UnknownNameError, UsageError
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage
from candata.schema.report import DiagnosisData, EpisodeCount, Gap, NamedEffect, RankedEffect, Report, Symptom


def titled(figure):
    return {axis.get_title(loc="left"): axis for axis in figure.axes}


@pytest.fixture
def recording():
    rows, names = 40, ("a", "b")
    rng = np.random.default_rng(0)
    angle = np.linspace(0, np.pi / 2, rows)
    valid = np.arange(rows) != 5
    arrays = {
        "time_ns": np.arange(rows) * 12_500_000,
        "object_pose": np.c_[np.zeros((rows, 3)), np.cos(angle / 2), np.zeros((rows, 2)), np.sin(angle / 2)],
        "joint_position": np.where(valid[:, None], rng.normal(size=(rows, 2)), np.nan),
        "joint_position_valid": valid,
        "action": rng.normal(size=(rows, 2)),
        "fingertip_force": np.tile([3.0, 0.0, 4.0], (rows, 1, 1)),
        "fingertip_contact": (np.arange(rows) // 10 % 2 == 1)[:, None],
    }
    meta = EpisodeMeta(
        id="e", source="real", rate_hz=80.0, joint_names=names, actuator_names=names, fingertip_names=("tip",)
    )
    return Episode(meta, arrays)


def test_an_episode_is_a_panel_a_channel(recording):
    axes = titled(plot.episode(recording))
    turn = axes["object's turn from its first pose"].lines[0].get_ydata()
    assert turn[-1] == pytest.approx(90, abs=0.01)
    assert axes["fingertip force"].lines[0].get_ydata() == pytest.approx(np.full(40, 5.0))
    joints = axes["joint position, command dashed"]
    position, command = joints.lines[0], joints.lines[1]
    assert np.isnan(position.get_ydata()[5]), "an invalid row is a break"
    np.testing.assert_array_equal(command.get_ydata(), recording["action"][:, 0])
    assert position.get_color() == command.get_color()
    (bars,) = axes["contact"].collections
    starts = [path.vertices[:, 0].min() for path in bars.get_paths()]
    assert starts == pytest.approx([10 / 80, 30 / 80])


def test_only_the_channels_that_are_named_are_drawn(recording):
    axes = titled(plot.episode(recording, ["action"]))
    assert [line.get_label() for line in axes["action"].lines] == ["a", "b"]
    assert len(axes) == 1
    with pytest.raises(UnknownNameError, match="unknown channel of the episode 'forces'"):
        plot.episode(recording, ["forces"])


def make_report():
    data = DiagnosisData(dataset="real@abc", episodes=EpisodeCount(total=24, folds=4, held_out=6))
    ranking = (
        RankedEffect(name="joint_damping", element="b", support=0.9, held_out_gain=2.0, gain_low=1.5, gain_high=2.5),
        RankedEffect(name="armature", support=0.1, held_out_gain=0.5, gain_low=0.2, gain_high=0.9),
        RankedEffect(name="backlash", support=0.0, held_out_gain=0.0),
    )
    return Report(
        verdict="explained",
        data=data,
        effects=(NamedEffect(name="joint_damping", element="b", share=1.0, support=0.9, parameters={}),),
        ranking=ranking,
        gap=Gap(before=3.0, after=1.1, closed=0.95),
        where=(Symptom(channel="joint_position", element="b", phase="free", ratio=4.0, p=0.001),),
    )


def test_a_gap_shows_where_which_and_how_far(tmp_path):
    figure = plot.gap(make_report())
    where, which, how_far = figure.axes
    assert [bar.get_width() for bar in where.patches] == [4.0]
    assert [bar.get_width() for bar in which.patches] == [2.0, 0.5], "what was not tried has no bar"
    assert which.patches[0].get_facecolor() != which.patches[1].get_facecolor(), "the named effect stands out"
    assert [bar.get_height() for bar in how_far.patches] == [3.0, 1.1]
    assert "95 % of the gap closed" in figure.get_suptitle()
    (tmp_path / "report.json").write_text(make_report().model_dump_json())
    assert plot.gap(tmp_path).get_suptitle() == figure.get_suptitle()


def test_what_is_no_report_is_refused(tmp_path):
    with pytest.raises(UsageError, match="this is no diagnosis"):
        plot.gap(5)
    with pytest.raises(UsageError, match=r"report\.json"):
        plot.gap(tmp_path)


def test_a_report_that_measured_nothing_is_read_again(tmp_path):
    report = make_report().model_copy(
        update={"measures": {"object_position_m": {"before": 0.1, "after": float("nan")}}}
    )
    (tmp_path / "report.json").write_text(report.model_dump_json())
    assert "Explained" in plot.gap(tmp_path / "report.json").get_suptitle()


def test_two_datasets_are_drawn_by_their_statistics(tmp_path, episode):
    roots = []
    for name, scale in (("one", 1.0), ("two", 5.0)):
        root = create_dataset(tmp_path / name)
        append(root, [episode(f"{name}{i}", seed=i, scale=scale) for i in range(5)], Lineage(operation="test"))
        roots.append(root)
    figure = plot.comparison(roots[0], open_dataset(roots[1]))
    assert "statistics differ" in figure.get_suptitle()
    starred = [title for title in titled(figure) if title.endswith("*")]
    assert any("joint" in title for title in starred)
    assert {text.get_text() for text in figure.axes[0].get_legend().get_texts()} == {"one", "two"}


def test_a_figure_shows_itself_in_a_notebook(recording):
    assert plot.episode(recording, ["action"])._repr_png_().startswith(b"\x89PNG")


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "candata.plot")
    with pytest.raises(MissingExtraError, match=r'pip install "candata\[plot\]"'):
        importlib.import_module("candata.plot")
