"""From the evaluations of an experiment to its table: rows, shares of the gap, and what came out in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from candata import __version__
from candata.experiment.cells import EVALUATION
from candata.experiment.config import ExperimentFile
from candata.experiment.paper import paper_figures
from candata.experiment.plan import Entry, Plan
from candata.experiment.results import Answer, ColumnFacts, ExperimentTable, RepairFacts, Row, Value
from candata.experiment.scores import Resampling, RowScores, excess, row_scores
from candata.gap.verdict.verdict import EXPLAINED
from candata.schema.json_text import read_json
from candata.training.pairs import LEAST_TRAJECTORIES
from candata.training.results import REPAIRED, SIMULATOR, Evaluation

#: What a reader must know of what models are shown and simulators are not.
REPLAYED = "in closed loop models are fed the recorded joints, where they read joints; simulators move their own"


@dataclass(frozen=True)
class Outcome:
    """What became of the cells: folders of those that stand, reasons of those that do not.

    `floors` are folders of the evaluations of the simulator with what each column's seal held, `opened` that in words.
    """

    folders: Mapping[str, Path]
    failed: Mapping[str, str]
    repairs: tuple[RepairFacts, ...] = ()
    floors: Mapping[str, Path] = field(default_factory=dict)
    opened: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Scored:
    """A row with the scores behind it; None where there are none."""

    row: Row
    scores: RowScores | None


def make_table(plan: Plan, outcome: Outcome, scale: float) -> ExperimentTable:
    """Return the table of an experiment.

    Parameters
    ----------
    plan : Plan
        Cells and entries.
    outcome : Outcome
        What became of the cells.
    scale : float
        Share of the file's episodes and steps that was used.
    """
    file, columns, rows, findings = plan.file, {}, [], []
    for title in dict.fromkeys(entry.column for entry in plan.entries):
        entries = [entry for entry in plan.entries if entry.column == title]
        scored = _scored_rows(title, entries, outcome, file.rows)
        floor = _floor_scores(outcome, title)
        episodes = max((s.scores.adds_auc.shape[1] for s in scored if s.scores), default=0)
        draws = Resampling(episodes) if episodes else None
        complete = [_complete(each, scored, floor, draws) for each in scored]
        rows += complete
        columns[title] = _facts(file, title, episodes, floor, outcome)
        if draws is not None:
            findings += _findings(file, title, complete, scored, draws)
    return ExperimentTable(
        title=file.title,
        headline=findings[0] if findings else "no row has scores yet",
        scale=scale,
        findings=tuple(findings[1:]),
        notes=(*file.notes, *_notes(columns), *((REPLAYED,) if any(row.model for row in rows) else ())),
        columns=columns,
        rows=tuple(rows),
        repairs=outcome.repairs,
        failed=dict(outcome.failed),
        revision=__version__,
    )


def _scored_rows(title: str, entries: list[Entry], outcome: Outcome, rows: Sequence[str]) -> list[_Scored]:
    """Return the rows of a column: those without training first, then models, their seeds together."""
    scored: list[_Scored] = []
    for entry in entries:
        if entry.model is None:
            known_labels = {each.row.label for each in scored} - {REPAIRED}
            scored += [each for each in _untrained_rows(entry, outcome, rows) if each.row.label not in known_labels]
    keys = dict.fromkeys((e.model, e.regime, e.origin, e.count) for e in entries if e.model is not None)
    for model, regime, origin, count in keys:
        group = [e for e in entries if (e.model, e.regime, e.origin, e.count) == (model, regime, origin, count)]
        row = Row(
            column=title,
            label=f"{model}, {regime}" + (", repaired simulation" if origin == "repaired" else ""),
            model=model,
            regime=regime,
            origin=origin,
            real_count=count,
            answer="both" if origin == "repaired" else "model",
            seeds=len(group),
            paper=paper_figures(title, model, regime),
        )
        scored.append(_with_scores(row, group, outcome))
    return scored


def _untrained_rows(entry: Entry, outcome: Outcome, rows: Sequence[str]) -> list[_Scored]:
    """Return the rows of simulators and baselines that are asked for."""
    if entry.cell not in outcome.folders:
        label = REPAIRED if entry.cell.startswith(f"evaluation/{entry.column}/{REPAIRED}/") else "what is not trained"
        row = Row(column=entry.column, label=label, real_count=entry.count)
        return [_Scored(row.model_copy(update={"failed": outcome.failed.get(entry.cell, "not made yet")}), None)]
    evaluation = read_evaluation(outcome.folders[entry.cell])
    answers: dict[str, Answer] = {SIMULATOR: "nothing", REPAIRED: "repair"}
    return [
        _Scored(
            Row(
                column=entry.column,
                label=name,
                real_count=entry.count if name == REPAIRED else 0,
                answer=answers.get(name),
            ),
            row_scores([evaluation], [name]),
        )
        for name in evaluation.forecasters
        if name in rows
    ]


def _with_scores(row: Row, group: list[Entry], outcome: Outcome) -> _Scored:
    """Return a model's row with its scores, or with the reason that there are none."""
    reasons = [outcome.failed[entry.cell] for entry in group if entry.cell in outcome.failed]
    standing = [entry for entry in group if entry.cell in outcome.folders]
    if not standing:
        return _Scored(row.model_copy(update={"failed": reasons[0] if reasons else "not made yet"}), None)
    evaluations = [read_evaluation(outcome.folders[entry.cell]) for entry in standing]
    names = [next(iter(evaluation.models)) for evaluation in evaluations]
    failed = f"{len(reasons)} of {len(group)} seeds: {reasons[0]}" if reasons else None
    row = row.model_copy(update={"seeds": len(standing), "failed": failed})
    return _Scored(row, row_scores(evaluations, names))


def read_evaluation(folder: Path) -> Evaluation:
    """Return the evaluation that a cell's folder holds."""
    path = folder / EVALUATION
    return Evaluation.parse(read_json(path), path)


def _floor_scores(outcome: Outcome, title: str) -> RowScores | None:
    """Return the scores of the simulator with what the seal held; None where that is not known."""
    if title not in outcome.floors:
        return None
    evaluation = read_evaluation(outcome.floors[title])
    return row_scores([evaluation], [REPAIRED]) if REPAIRED in evaluation.forecasters else None


def _complete(each: _Scored, scored: list[_Scored], floor: RowScores | None, draws: Resampling | None) -> Row:
    """Return a row with values, intervals and shares of the gap."""
    scores = each.scores
    if scores is None or draws is None:
        return each.row
    nominal = next((s.scores for s in scored if s.row.label == SIMULATOR and s.scores), None)
    closed = Value(value=None)
    if nominal is not None and each.row.answer is not None:
        closed = draws.closed(scores.adds_auc, nominal.adds_auc, None if floor is None else floor.adds_auc)
    return each.row.model_copy(
        update={
            "adds_auc": draws.value(scores.adds_auc),
            "success": draws.value(scores.success),
            "mse": draws.value(scores.mse),
            "closed": closed,
            "excess": excess(scores, floor),
        }
    )


def _facts(file: ExperimentFile, title: str, episodes: int, floor: RowScores | None, outcome: Outcome) -> ColumnFacts:
    """Return what a column was tested on."""
    source = file.data[file.columns[title].real]
    if source.sealed is None:
        real, floor_words = f"the recordings {Path(str(source.path)).name}", "no error at all"
    else:
        world = source.sealed
        what = (
            f"the cause {world.outside}" if world.outside else "all about 5 % wrong" if world.all_wrong else "effects"
        )
        real = f"a sealed simulated world ({what} hidden) in place of a real one"
        floor_words = "no error at all" if floor is None else "the simulator with what the seal held"
    floor_auc = None if not episodes else 1.0 if floor is None else float(floor.adds_auc.mean())
    return ColumnFacts(
        real=real, test_episodes=episodes, floor=floor_words, floor_auc=floor_auc, opened=outcome.opened.get(title, ())
    )


def _notes(columns: Mapping[str, ColumnFacts]) -> list[str]:
    """Return what a reader must know of intervals."""
    few = [title for title, facts in columns.items() if facts.test_episodes < LEAST_TRAJECTORIES]
    if not few:
        return []
    return [f"fewer than {LEAST_TRAJECTORIES} test episodes, so no intervals: {', '.join(few)}"]


def _findings(file: ExperimentFile, title: str, rows: list[Row], scored: list[_Scored], draws: Resampling) -> list[str]:
    """Return what came out of a column in plain words, the most important first."""
    chosen = _answers(file, rows)
    clauses = [
        f"{words}{_whose(file, chosen[answer])} {_percent(chosen[answer].closed)}"
        for answer, words in (("repair", "the repair closes"), ("model", "the model"), ("both", "both"))
        if answer in chosen and chosen[answer].closed.value is not None
    ]
    head = f"{title}: " if len(file.columns) > 1 else ""
    if clauses:
        line = f"{head}{', '.join(clauses)} of the gap"
    else:
        best = max(rows, key=lambda row: row.adds_auc.value if row.adds_auc.value is not None else -1.0)
        line = f"{head}no gap is known to close; the best row is {best.label}, ADD-S AUC {_percent(best.adds_auc)}"
    contact = _without_contact(file, chosen, scored, draws)
    return [f"{line}; {contact}" if contact else line, *_enough(head, chosen), *_saved(head, file, rows)]


def _answers(file: ExperimentFile, rows: list[Row]) -> dict[Answer, Row]:
    """Return the row of each answer that the first line speaks of: the most real episodes, the main model."""
    chosen: dict[Answer, Row] = {}
    for row in sorted(rows, key=lambda row: _rank(file, row)):
        if row.answer is not None and row.adds_auc.value is not None:
            chosen.setdefault(row.answer, row)
    return chosen


def _whose(file: ExperimentFile, row: Row) -> str:
    """Return the name of a row's model where it is not the one that the first line speaks of."""
    return "" if row.model in (None, file.main_model) else f" ({row.model})"


def _rank(file: ExperimentFile, row: Row) -> tuple[bool, int, float]:
    """Return how near a row is to what the first line speaks of, the nearest first."""
    return row.model not in (None, file.main_model), row.regime_rank, -_count(row)


def _count(row: Row) -> float:
    """Return the real episodes of a row as a number."""
    return float("inf") if row.real_count is None else row.real_count


def _without_contact(
    file: ExperimentFile, chosen: Mapping[Answer, Row], scored: list[_Scored], draws: Resampling
) -> str | None:
    """Return by how much the main model leads the one without contact, in words."""
    if file.without_contact is None or "model" not in chosen:
        return None
    row = chosen["model"]
    twin = {"regime": row.regime, "origin": row.origin, "real_count": row.real_count}
    scores = _find(scored, model=row.model, **twin)
    reference = _find(scored, model=file.without_contact, **twin)
    if scores is None or reference is None:
        return None
    gain = draws.difference(scores.adds_auc, reference.adds_auc)
    if gain.value is None:
        return None
    points = 100 * gain.value
    word = "less" if points >= 0 else "more"
    sign = 1 if points >= 0 else -1
    ends = sorted((sign * 100 * (gain.low or 0.0), sign * 100 * (gain.high or 0.0)))
    interval = "" if gain.low is None else f" ({ends[0]:.1f} to {ends[1]:.1f})"
    return f"without contact it is {abs(points):.1f} points of AUC {word}{interval}"


def _find(scored: list[_Scored], **fields: object) -> RowScores | None:
    """Return the scores of the row with these fields."""
    for each in scored:
        if all(getattr(each.row, name) == value for name, value in fields.items()):
            return each.scores
    return None


def _enough(head: str, chosen: Mapping[Answer, Row]) -> list[str]:
    """Return which answers close the gap as far as a diagnosis asks of `explained`, and whether both pays."""
    known = {answer: row.closed.value for answer, row in chosen.items() if row.closed.value is not None}
    names = {"repair": "the repair alone", "model": "the model alone", "both": "both together"}
    enough = [words for answer, words in names.items() if known.get(answer, 0.0) >= EXPLAINED]  # type: ignore[call-overload]
    lines = (
        [f"{head}{', '.join(enough) or 'nothing'} closes {100 * EXPLAINED:.0f} % of the gap or more"] if known else []
    )
    if {"repair", "model", "both"} <= known.keys():
        lead = known["both"] - max(known["repair"], known["model"])
        better = "the repair" if known["repair"] >= known["model"] else "the model"
        lines.append(f"{head}both close {100 * lead:+.0f} points of the gap beside {better} alone")
    return lines


def _saved(head: str, file: ExperimentFile, rows: list[Row]) -> list[str]:
    """Return how many real episodes the model alone needs for what both reach with fewer."""
    counts = sorted(file.real_counts)
    by_answer = {
        answer: {row.real_count: row.adds_auc.value for row in reversed(_of_main(file, rows)) if row.answer == answer}
        for answer in ("model", "both")
    }
    lines = []
    for count in counts:
        reached = by_answer["both"].get(count)
        if reached is None:
            continue
        enough = [n for n in counts if (by_answer["model"].get(n) or -1.0) >= reached]
        need = f"{enough[0]}" if enough else f"more than {counts[-1]}"
        lines.append(f"{head}what both reach with {count} real episodes, the model alone reaches with {need}")
    return lines


def _of_main(file: ExperimentFile, rows: list[Row]) -> list[Row]:
    """Return the rows of the main model, its preferred regimes first."""
    return sorted((row for row in rows if row.model == file.main_model), key=lambda row: _rank(file, row))


def _percent(value: Value) -> str:
    """Return a share in per cent, with its interval."""
    text = f"{100 * (value.value or 0.0):.0f} %"
    return (
        text if value.low is None or value.high is None else f"{text} ({100 * value.low:.0f} to {100 * value.high:.0f})"
    )
