"""The page and the summary of an experiment, from results made by hand."""

from __future__ import annotations

from candata.experiment.results import ColumnFacts, ExperimentTable, PaperFigures, RepairFacts, Row, Value
from candata.reports.experiment import page, summary, write_experiment


def scored(label: str, auc: float, closed: float | None = None, **more: object) -> Row:
    """A row with an AUC and its interval."""
    value = Value(value=auc, low=auc - 0.01, high=auc + 0.01)
    return Row(column="single", label=label, adds_auc=value, closed=Value(value=closed), **more)


def make_table(**changes: object) -> ExperimentTable:
    """A table of four answers at two numbers of real episodes."""
    rows = (
        scored("simulator", 0.9, 0.0, real_count=0, answer="nothing"),
        scored("repaired simulator", 0.96, 0.6, real_count=10, answer="repair"),
        scored("net, sim", 0.91, 0.1, model="net", regime="sim", origin="nominal", real_count=0, answer="model"),
        scored(
            "net, real-finetune",
            0.94,
            0.4,
            model="net",
            regime="real-finetune",
            origin="nominal",
            real_count=10,
            answer="model",
            paper=PaperFigures(adds_auc=0.8823, success=0.737),
        ),
        Row(column="single", label="bad, sim", real_count=0, failed="training <has> diverged\n  found: 3"),
    )
    fields = {
        "title": "a table",
        "headline": "the repair closes 60 %, the model 40 % of the gap",
        "scale": 0.05,
        "columns": {
            "single": ColumnFacts(
                real="a world", test_episodes=40, floor="the truth", floor_auc=0.99, opened=("object_mass 1.5",)
            )
        },
        "rows": rows,
        "repairs": (
            RepairFacts(name="diagnosis/world", real_count=10, verdict="explained", effects=("m",), closed=0.9),
        ),
        "failed": {"train/bad": "training <has> diverged"},
        "revision": "0",
    }
    return ExperimentTable.model_validate(fields | changes)


def test_the_page_has_each_row_with_intervals_the_papers_figures_and_what_failed():
    text = page(make_table())
    for words in (
        "the repair closes 60 %, the model 40 % of the gap",
        "at 5 % of its episodes and steps",
        "94.0 % (93.0 to 95.0)",
        "88.2 %",
        "40 test episodes of a world. The floor is the truth: ADD-S AUC 99.0 %.",
        "held object_mass 1.5",
        "bad, sim: failed, training &lt;has&gt; diverged",
    ):
        assert words in text, words
    assert "<has>" not in text


def test_the_four_answers_stand_by_numbers_of_real_episodes():
    text = page(make_table())
    part = text[text.index("single: by real episodes") :]
    rows = [row for row in part[: part.index("</table>")].split("<tr>") if "<td>" in row]
    cells = [[cell.partition("</td>")[0].strip() for cell in row.split("<td>")[1:]] for row in rows]
    assert [row[1].split(";")[0][:6] for row in cells] == ["90.0 %", "90.0 %", "91.0 %", "91.0 %"]
    assert [row[2].split(";")[0][:6] for row in cells[:3]] == ["90.0 %", "96.0 %", "94.0 %"]
    assert cells[3][2] == "\N{EN DASH}"


def test_the_summary_begins_with_what_came_out_and_the_page_is_a_file(tmp_path):
    lines = summary(make_table()).splitlines()
    assert lines[0] == "the repair closes 60 %, the model 40 % of the gap"
    assert any(line.split()[:2] == ["repaired", "simulator"] and "60 %" in line for line in lines)
    assert write_experiment(make_table(), tmp_path / "out").read_text().startswith("<!DOCTYPE html>")
