"""The page: whole, well-formed, self-contained, and it says what the record says."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import get_args

import numpy as np
import pytest

from candata import reports
from candata.gap.verdict.exhibits import POINTS
from candata.gap.verdict.figures import Elements, Evidence
from candata.reports import figures, outcome, words
from candata.reports.heat import heat_map
from candata.schema.record import Record
from candata.schema.report import Report, Verdict

VOID = {"meta", "link", "img", "br", "hr", "input"}
YAML = "scene: s\neffects:\n- name: a<b & c\n"
#: Pictures and episodes included; what mail still takes. 18 pictures of full size are some 450 kB of it.
LARGEST_PAGE, PICTURES = 1_500_000, 450_000


#: What stands on a page only with a part of the evidence.
SIGNS = {
    "heat": 'class="heat"><thead>',
    "example": 'class="traces"',
    "losses": "mismatch of each held-out episode",
    "elements": 'class="panel"',
    "collinearity": "Which candidates look alike",
}


class Page(HTMLParser):
    """Checks nesting and keeps addresses, ids and the texts of script elements."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.open, self.addresses, self.ids, self.scripts = [], [], [], {}
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for name, value in attrs if name in ("src", "href", "srcset", "action", "data")]
        self.ids += [value for name, value in attrs if name == "id"]
        self.script = dict(attrs).get("id") if tag == "script" else None
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script" and self.script:
            self.scripts[self.script] = data


def visible_text(text: str) -> str:
    """The page's text as a reader sees it, scripts left out."""
    body = re.sub(r"<(script|style).*?</\1>", "", text, flags=re.S)
    lines = html.unescape(re.sub(r"<[^>]+>", "", body)).replace("\N{NO-BREAK SPACE}", " ").splitlines()
    return "\n".join(filter(None, map(str.strip, lines)))


@pytest.mark.parametrize("verdict", get_args(Verdict))
def test_every_verdict_is_written_with_its_sentences(tmp_path, make_report, full_evidence, verdict):
    report = make_report(verdict)
    path = reports.write_report(report, full_evidence, None, tmp_path / "new", YAML)
    assert path == tmp_path / "new" / "report.html"
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    text = visible_text(path.read_text(encoding="utf-8"))
    for sentence in (words.where_sentence, words.cause_sentence, words.closure_sentence, words.unknowns_sentence):
        assert sentence(report) in text
    assert reports.explain(verdict) in text
    assert text.index(outcome.outcome(report)) < text.index("Where is the gap?")
    assert (outcome.FLOOR in text) is (report.gap is not None)


def test_the_page_is_well_formed_and_asks_for_nothing(
    tmp_path, make_report, full_evidence, hand, no_gl, small_pictures
):
    path = reports.write_report(make_report(), full_evidence, hand, tmp_path, YAML)
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert page.addresses
    assert all(address.startswith("data:") for address in page.addresses)
    assert len(page.ids) == len(set(page.ids))
    assert not re.search(r"url\(|@import", text[: text.index("<body")])
    assert path.stat().st_size < LARGEST_PAGE - PICTURES


def test_every_element_of_the_heat_map_has_its_episodes(tmp_path, make_report, full_evidence):
    text = reports.write_report(make_report(), full_evidence, None, tmp_path, YAML).read_text("utf-8")
    panels = re.findall(r'data-element="([^"]*)"( hidden)?', text)
    assert [label for label, _ in panels] == list(full_evidence.heat.rows)
    assert re.findall(r'data-shows="([^"]*)"', text) == list(full_evidence.heat.rows)
    assert [label for label, is_hidden in panels if not is_hidden] == ["joint_position index2"], "the first symptom"


def test_the_yaml_is_shown_escaped(tmp_path, make_report):
    text = reports.write_report(make_report(), Evidence(), None, tmp_path, YAML).read_text("utf-8")
    assert "a&lt;b &amp; c" in text


def test_hostile_names_stay_text(tmp_path, make_report, full_evidence):
    hostile = "</script><script>alert(1)</script>"
    trace = replace(full_evidence.example.traces[0], element=hostile)
    example = replace(full_evidence.example, traces=(trace,), episode=hostile)
    evidence = replace(full_evidence, example=example, heat=replace(full_evidence.heat, phases=(hostile,) * 5))
    page = reports.write_report(make_report(provenance={"x": hostile}), evidence, None, tmp_path, hostile)
    assert hostile not in page.read_text("utf-8")


@pytest.mark.parametrize("part", list(SIGNS))
def test_a_missing_part_of_the_evidence_is_left_out(tmp_path, make_report, full_evidence, part):
    text = reports.write_report(make_report(), replace(full_evidence, **{part: None}), None, tmp_path, YAML).read_text(
        "utf-8"
    )
    assert SIGNS[part] not in text
    whole_page = reports.write_report(make_report(), full_evidence, None, tmp_path, YAML).read_text("utf-8")
    assert SIGNS[part] in whole_page


def test_nothing_repaired(tmp_path, make_report, make_unrepaired, full_evidence, hand, no_gl, small_pictures):
    evidence = make_unrepaired(full_evidence)
    text = reports.write_report(make_report("no_gap"), evidence, hand, tmp_path, "").read_text("utf-8")
    assert text.count("<img ") == 12
    assert "keep the simulator as it is" in text
    assert 'id="effects-file"' not in text
    assert ">best candidate<" not in text
    assert ">repaired<" not in text


def test_unknown_and_measures_are_tabled(tmp_path, make_report):
    measures = {"position_percent_of_width": {"before": 23.1, "after": 13.4}, "rotation_deg": {"after": 18.6}}
    report = make_report("partly_explained", measures=measures)
    rest = report.unknown.model_copy(update={"closable": 0.1241})
    report = report.model_copy(update={"unknown": rest})
    text = visible_text(reports.write_report(report, Evidence(), None, tmp_path, "").read_text("utf-8"))
    assert "position percent of width" in text
    assert "What stays unexplained" in text
    assert "0.4 N" in text
    assert "closable by a fitted force" in text
    assert "12 %" in text
    assert "0.1241" not in text.split("What stays unexplained")[1].split("<h2>")[0]


def cells(text: str, row: str) -> list[tuple[str, str, str]]:
    """(class, text when pointed at, number) of each cell of a row of the heat map."""
    inner = re.search(rf'data-shows="{row}".*?</tr>', text, re.S).group()
    return re.findall(r'<td class="([\w ]+)" title="([^"]*)">([^<]*)</td>', inner)


def test_the_heat_map_shows_numbers_only_where_significant(make_heat):
    markup = heat_map(make_heat(), frozenset(make_heat().rows))
    index2 = cells(markup, "joint_position index2")
    assert [number for *_, number in index2] == ["3.1", "4.6", "2.2", "2.8", "17"]
    assert index2[4][0] == "h8", "the largest takes the strongest colour"
    assert "17.3 times the floor, p = 0.001" in index2[4][1]
    thumb = cells(markup, "fingertip_force thumb_tip")
    assert thumb[0] == ("hole", "free: no data", "")
    assert {number for *_, number in thumb} == {""}
    assert all(css_class.endswith(" chance") for css_class, *_ in thumb[1:]), "chance is not ruled out"
    assert not any("chance" in css_class for css_class, *_ in index2)


def test_a_heat_map_of_nothing_but_gaps(make_heat):
    heat = make_heat(3)
    markup = heat_map(replace(heat, ratio=np.full((3, 5), np.nan), p=np.full((3, 5), np.nan)), frozenset())
    assert markup.count('<td class="hole"') == 15


def test_the_ranking_shows_a_named_effect_wherever_it_ranks(make_report):
    report = make_report()
    late_effect = report.effects[0].model_copy(update={"name": "tactile_bias", "element": None})
    candidates = figures.drawn_candidates(report.model_copy(update={"effects": (late_effect,)}))
    assert len(candidates) == figures.MOST_RANKED + 1
    assert candidates[-1].name == "tactile_bias"


def test_the_ranking_is_not_filled_with_one_effect(make_report):
    report = make_report()
    local = tuple(report.ranking[1].model_copy(update={"element": f"joint{k}"}) for k in range(20))
    candidates = figures.drawn_candidates(report.model_copy(update={"ranking": (*local, *report.ranking)}))
    assert [c.name for c in candidates].count("joint_damping") == figures.MOST_VARIANTS
    assert len({c.name for c in candidates}) > 8


def test_losses_that_are_not_finite_are_left_out(full_evidence):
    values = replace(full_evidence.losses, after=np.full(24, np.nan))
    markup = figures.losses(values)
    assert "nan" not in markup
    assert markup.count("nominal:") == 24
    assert "repaired:" not in markup


def test_the_page_says_what_to_change(tmp_path, make_report, full_evidence):
    text = visible_text(reports.write_report(make_report(), full_evidence, None, tmp_path, YAML).read_text("utf-8"))
    assert "Add joint dry friction of 0.0412 N m (0.0373 to 0.0458) to joint index2." in text
    assert "In MJCF: add 0.0412 to frictionloss of the <joint>" in text
    assert "To simulate with it, in the folder of this page: candata generate-sim --effects effects.yaml " in text
    assert "0 to 0.3 N m" in text, "the range that was searched"


def test_the_lines_of_the_mjcf_stand_in_the_place_of_a_hint(tmp_path, make_report):
    context = reports.ReportContext(tmp_path, mjcf_lines=('<joint name="index2" frictionloss="0.0412"/>',))
    text = visible_text(reports.write_report(make_report(), Evidence(), None, tmp_path, "", context).read_text("utf-8"))
    assert '<joint name="index2" frictionloss="0.0412"/>' in text
    assert "In MJCF:" not in text
    assert "candata scene export --effects effects.yaml " in text


def test_a_range_of_one_end_is_said_so_and_drawn_to_the_end_of_what_was_searched(tmp_path, make_report, full_evidence):
    effect = make_report().effects[0].model_dump()
    effect["parameters"]["frictionloss_Nm"] |= {"high": None, "bounded": "low"}
    text = reports.write_report(make_report(effects=[effect]), full_evidence, None, tmp_path, YAML).read_text("utf-8")
    assert '<td class="n">at least 0.0373</td>' in text
    assert "Add joint dry friction of 0.0412 N m (at least 0.0373; more explains as well)" in visible_text(text)
    # Searched was 0 to 0.3.
    assert f'<path class="span named" d="M{round(1000 * 0.0373 / 0.3)} 500H1000"/>' in text


def test_a_value_at_its_bound_is_marked(tmp_path, make_report, full_evidence):
    report = make_report()
    bound_effect = report.effects[0].model_copy(update={"at_bound": True})
    mark = ">at bound<"
    assert mark not in reports.write_report(report, full_evidence, None, tmp_path, YAML).read_text("utf-8")
    report = report.model_copy(update={"effects": (bound_effect,)})
    assert mark in reports.write_report(report, full_evidence, None, tmp_path, YAML).read_text("utf-8")


def test_ambiguous_says_what_to_record_and_changes_nothing(tmp_path, make_report, make_unrepaired, full_evidence):
    evidence = make_unrepaired(full_evidence)
    text = visible_text(reports.write_report(make_report("ambiguous"), evidence, None, tmp_path, "").read_text("utf-8"))
    assert "Nothing yet" in text
    assert "command filemotion.parquet\nseparatesjoint damping from joint dry friction" in text


def test_fields_that_newer_records_add_are_shown(tmp_path, make_report, full_evidence):
    class Edit(Record):
        kept: float
        about: str

    class NewerReport(Report):
        later: Edit | None = None

    newer_report = NewerReport.model_validate(
        {**make_report().model_dump(), "later": {"kept": 0.9, "about": "another object"}}
    )
    text = visible_text(reports.write_report(newer_report, full_evidence, None, tmp_path, YAML).read_text("utf-8"))
    assert "kept 0.9, about another object" in text


def test_many_elements_and_episodes_stay_small(tmp_path, make_report, full_evidence):
    element = full_evidence.elements.of[5]
    time = np.linspace(0, 4, POINTS)
    wave = np.sin(7 * time)
    courses = tuple(replace(c, time_s=time, real=wave, before=wave + 0.1, after=wave + 0.01) for c in element.courses)
    ids = tuple(f"episode-{k:06d}" for k in range(2000))
    size = np.linspace(1e-3, 1e-2, 2000)
    of = tuple(
        replace(element, element=f"j{k}", before=size, after=size / 2, null=size / 3, courses=courses)
        for k in range(60)
    )
    evidence = replace(full_evidence, elements=Elements(ids, of))
    path = reports.write_report(make_report(), evidence, None, tmp_path, YAML)
    assert path.stat().st_size < LARGEST_PAGE - PICTURES
    assert "40 of 2000 drawn" in path.read_text("utf-8")
