"""Two runs compared: paired case by case, by kind and noise, with what each costs and how honest it is."""

from __future__ import annotations

import pytest

from candata.errors import UsageError
from candata.gap.blind.comparison import compare_runs, mcnemar
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.scores import score_run
from candata.schema.bench import CaseResult, FreshGap
from candata.schema.report import Gap
from tests.gap.outcomes import MASS, SLIDE, case, say


def scored(folder, outcomes):
    """Write the results and the score of a run."""
    folder.mkdir(parents=True)
    numbered = []
    for k, o in enumerate(outcomes):
        name = {"case": f"c{k}"}
        result = o.result.model_copy(update={**name, "sealed": f"seal{k}"})
        numbered.append(Outcome(o.label.model_copy(update=name), result, fresh=o.fresh))
    (folder / "results.jsonl").write_text("".join(o.result.model_dump_json() + "\n" for o in numbered))
    score = score_run(numbered, scene="s", cases=len(numbered))
    (folder / "bench.json").write_text(score.model_dump_json())
    return folder


def nulls(*said, cpu_s=(1.0, 2.0, 3.0, 4.0, 5.0)):
    """Nulls that came out as said: True is right."""
    return [case("null", named=() if right else (say(MASS),), cpu_s=s) for right, s in zip(said, cpu_s, strict=False)]


def with_more(o, **changes):
    """An outcome with another label, result or fresh gap."""
    label = o.label.model_copy(update=changes.get("label", {}))
    result: CaseResult = o.result.model_copy(update=changes.get("result", {}))
    return Outcome(label, result, fresh=changes.get("fresh"))


def test_two_runs_are_paired_case_by_case(tmp_path):
    first = scored(tmp_path / "a", nulls(True, True, False, False, False))
    second = scored(tmp_path / "b", nulls(True, False, True, True, False))
    found = compare_runs(first, second)
    assert (found.both_right, found.first_only, found.second_only, found.neither) == (1, 1, 2, 1)
    assert found.p == 1.0
    assert (found.first_cpu_s, found.second_cpu_s) == (3.0, 3.0)
    assert [c.case for c in found.changed] == ["c1", "c2", "c3"]
    assert (found.changed[0].first, found.changed[0].second) == ("no_gap (right)", "explained object_mass")
    assert (found.changed[0].first_right, found.changed[0].second_right) == (True, False)


def test_the_first_line_says_who_is_right_more_often_and_what_it_costs(tmp_path):
    a = scored(tmp_path / "a", nulls(True, False, False, False, False, cpu_s=[10.0] * 5))
    b = scored(tmp_path / "b", nulls(True, True, True, True, False, cpu_s=[8.0] * 5))
    assert compare_runs(a, b).summary == "B is right in 3 more of 5 cases (p = 0.25), costs 0.8 times the CPU"
    assert compare_runs(b, a).summary == "B is right in 3 fewer of 5 cases (p = 0.25), costs 1.2 times the CPU"
    assert compare_runs(a, a).summary == "B is right in as many of 5 cases as A (p = 1), costs 1 times the CPU"


def test_each_kind_of_case_and_of_noise_has_its_own_counts(tmp_path):
    def run(one, null):
        mass = case("one", (MASS,), (say(MASS if one else SLIDE),))
        return [mass, with_more(*nulls(null), label={"noise": "undeclared"}), *nulls(True)]

    found = compare_runs(scored(tmp_path / "a", run(True, False)), scored(tmp_path / "b", run(False, True)))
    kinds = {k.kind: k for k in found.kinds}
    assert list(kinds) == ["one", "null", "noise declared", "noise undeclared"]
    assert [(k.cases, k.first_only, k.second_only) for k in kinds.values()] == [
        (1, 1, 0),
        (2, 0, 1),
        (2, 1, 0),
        (1, 0, 1),
    ]
    declared = compare_runs(scored(tmp_path / "c", nulls(True)), scored(tmp_path / "d", nulls(True)))
    assert [k.kind for k in declared.kinds] == ["null"]


def measures(tmp_path, first, second):
    found = compare_runs(scored(tmp_path / "a", first), scored(tmp_path / "b", second))
    return {m.measure: m for m in found.measures}


def test_cost_is_a_ratio_case_by_case_and_of_cases_that_began_alike(tmp_path):
    """One case that takes a hundred times as long decides nothing."""

    def run(factor, cold):
        costs = [1.0, 2.0, 3.0, 400.0]
        some = [case("null", cpu_s=factor * s, cold=cold and s == 3.0) for s in costs]
        return [with_more(o, result={"replays": 10 * o.result.cpu_s}) for o in some]

    found = measures(tmp_path, run(1.0, True), run(0.5, False))
    cpu = found["CPU s a case"]
    assert (cpu.cases, cpu.first, cpu.second, cpu.change, cpu.low, cpu.high) == (3, 2.0, 1.0, 0.5, 0.5, 0.5)
    assert found["replays a case"].change == 0.5


def test_beliefs_are_compared_by_their_mean_change_with_an_interval_over_cases(tmp_path):
    def run(*supports):
        return [case("one", (MASS,), (say(MASS, s),)) for s in supports]

    sure, unsure = run(0.9, 0.9, 0.9, 0.9), run(0.9, 0.9, 0.9, 0.5)
    brier = measures(tmp_path, unsure, sure)["Brier score of support"]
    assert brier.change == pytest.approx(-(0.25 - 0.01) / 4)
    # Of four cases one changed: resamples hold it none to three times.
    assert brier.low < brier.change < brier.high <= 0
    assert brier.high == pytest.approx(0)


def test_what_a_run_has_not_measured_is_not_compared(tmp_path):
    named = case("one", (MASS,), (say(MASS),), closed=0.9)
    fresh = FreshGap(case="c", sealed="", episodes=2, gap=Gap(before=3.0, after=1.2, closed=0.8))
    found = measures(tmp_path, [with_more(named, fresh=fresh)], [with_more(named, fresh=fresh)])
    assert found["closed: claimed minus fresh"].first == pytest.approx(0.1)
    assert "replays a case" not in found
    assert "closed: claimed minus fresh" not in measures(tmp_path / "x", [with_more(named, fresh=fresh)], [named])


def test_mcnemars_p_is_that_of_a_fair_coin():
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(0, 5) == mcnemar(5, 0) == 2 / 32
    assert mcnemar(1, 9) == pytest.approx(2 * 11 / 1024)


def test_runs_that_cannot_be_paired_are_refused(tmp_path):
    first = scored(tmp_path / "a", nulls(True))
    with pytest.raises(UsageError, match=r"no results\.jsonl"):
        compare_runs(first, tmp_path)
    other = scored(tmp_path / "b", nulls(True))
    for name in ("results.jsonl", "bench.json"):
        (other / name).write_text((other / name).read_text().replace("seal0", "seal9"))
    with pytest.raises(UsageError, match="share no case"):
        compare_runs(first, other)
    text = (other / "results.jsonl").read_text()
    (other / "results.jsonl").write_text(text + text.replace("seal9", "seal1"))
    with pytest.raises(UsageError, match="not the score of all results"):
        compare_runs(first, other)
