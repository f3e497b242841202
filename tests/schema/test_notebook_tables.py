"""Lines and tables of values: one line each, every text escaped."""

from __future__ import annotations

import numpy as np

from candata.schema.episode import Episode
from candata.schema.html_text import summary_table
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, Gap, NamedEffect, Report


def make_report(**fields):
    data = DiagnosisData(dataset="real", episodes=EpisodeCount(total=24, folds=4, held_out=6))
    return Report(data=data, **fields)


def test_an_episode_is_one_line(episode):
    assert repr(episode("grasp-3", rows=41)) == (
        "Episode('grasp-3', 41 rows in 0.5 s at 80 Hz, time_ns, object_pose, joint_position, fingertip_force, contact)"
    )


def test_an_episodes_table_counts_what_is_not_valid(episode):
    base = episode("<i>", object="cup")
    valid = np.arange(len(base)) >= 3
    html = Episode(base.meta, {**base.arrays, "joint_position_valid": valid})._repr_html_()
    row = next(row for row in html.split("<tr>") if ">joint_position<" in row)
    assert ">(20, 2)<" in row
    assert ">3<" in row
    assert "&lt;i&gt;" in html
    assert "joint_position_valid" not in html


def test_a_report_is_one_line_and_a_table():
    value = Estimate(value=0.0412, low=0.037, high=0.0461)
    effect = NamedEffect(
        name="joint_dry_friction", element="index2", share=0.81, support=0.9, parameters={"frictionloss_Nm": value}
    )
    report = make_report(verdict="explained", effects=(effect,), gap=Gap(before=3.1, after=1.04, closed=0.98))
    line = "Report(explained, joint_dry_friction on index2, gap 3.10 to 1.04 noise floors, real)"
    assert (repr(report), str(report)) == (line, line)
    html = report._repr_html_()
    for cell in ("index2", "frictionloss_Nm", "0.0412", "0.037 to 0.0461", "81%"):
        assert f">{cell}<" in html


def test_a_report_without_a_gap_shows_no_table():
    report = make_report(verdict="too_little_data")
    assert repr(report) == "Report(too_little_data, real)"
    assert "<table" not in report._repr_html_()


def test_vectors_and_one_sided_intervals_are_written_out():
    parameters = {"a": Estimate(value=(0.1, 0.25)), "b": Estimate(value=2.0, low=1.5), "c": Estimate(value="elliptic")}
    effect = NamedEffect(name="x", share=1.0, support=1.0, parameters=parameters)
    html = make_report(verdict="explained", effects=(effect,))._repr_html_()
    assert ">[0.1, 0.25]<" in html
    assert ">at least 1.5<" in html
    assert ">elliptic<" in html


def test_rows_beyond_the_limit_are_counted():
    html = summary_table("h", "f", ("n",), [(k,) for k in range(20)])
    assert html.count("<tr>") == 1 + 12
    assert "8 more rows" in html
