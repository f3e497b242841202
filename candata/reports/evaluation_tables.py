"""The tables of an evaluation: forecasters beside each other, in closed loop, ahead, by contact, time and group."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from candata.reports.numbers import digits
from candata.reports.standing import REFERENCES, has_intervals
from candata.training.results import (
    Contact,
    Evaluation,
    EventTiming,
    Group,
    GroupScores,
    ModelFacts,
    Pair,
    SimulatorFacts,
    Success,
)

DASH = "\N{EN DASH}"
#: What results are broken down by, as a title.
KINDS = {"object": "By object", "task": "By task", "outcome": "By outcome", "phase": "By phase of contact"}


@dataclass(frozen=True)
class Table:
    """A table with a title and a line on how to read it; the first column holds names."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def closed_loop_table(evaluation: Evaluation) -> Table:
    """Return the table over whole episodes."""
    shown = [name for name in REFERENCES if name in evaluation.forecasters and evaluation.pairs]
    with_intervals = has_intervals(evaluation)
    interval_head = ("95 % interval",) if with_intervals else ()
    head = (
        "",
        "ADD-S AUC",
        *interval_head,
        *(f"over {name}" for name in shown),
        "ADD-S",
        "final position error",
        "rotation error",
        "within 5 cm",
        *interval_head,
    )
    rows = []
    for name, scores in evaluation.forecasters.items():
        loop = scores.closed_loop
        auc_interval = (_interval(loop.adds_auc_interval),) if with_intervals else ()
        success_interval = (_interval((loop.success.low, loop.success.high)),) if with_intervals else ()
        rows.append(
            (
                scores.summary,
                share(loop.adds_auc),
                *auc_interval,
                *(_gain(evaluation.pair(name, reference), with_intervals) for reference in shown),
                mm(loop.adds_m),
                mm(loop.final_position_error_m),
                degrees(loop.rotation_error_rad),
                count_of(loop.success),
                *success_interval,
            )
        )
    note = "Gains in points of AUC." if shown else ""
    if with_intervals:
        note += " Intervals: 95 %, over resampled episodes, paired for gains; Wilson for episodes within 5 cm."
    return Table("Closed loop, whole episodes", head, rows, note.strip())


def pairs_table(evaluation: Evaluation) -> Table | None:
    """Return what each forecaster gains over each other one; None without ADD-S or for two forecasters."""
    names = list(evaluation.forecasters)
    if not evaluation.pairs or len(names) < 3:
        return None
    with_intervals = has_intervals(evaluation)
    rows = [(name, *(_gain(evaluation.pair(name, reference), with_intervals) for reference in names)) for name in names]
    return Table("Each against each", ("points of AUC over", *names), rows)


def forecast_table(evaluation: Evaluation) -> Table:
    """Return the table over single forecasts; each over its own horizon."""
    head = (
        "",
        "ahead",
        "ADD-S AUC",
        "position error",
        "energy score",
        "rotation error",
        "MSE [mm²]",
        "MSE [10⁻³ rad²]",
        "mixed MSE [10⁻⁶]",
    )
    rows = []
    for scores in evaluation.forecasters.values():
        windows = scores.windows
        rows.append(
            (
                scores.summary,
                lead_time(evaluation, len(windows.position_error_m)),
                share(windows.adds_auc),
                mm(windows.position_error_m[-1]),
                mm(windows.position_energy_m[-1]),
                degrees(windows.rotation_error_rad[-1]),
                _number(_mean(windows.position_mse_m2), 1e6),
                _number(_mean(windows.rotation_mse_rad2), 1e3),
                _number(windows.increment_mse, 1e6),
            )
        )
    return Table(
        "One forecast from each window",
        head,
        rows,
        "Errors at the last step of the forecast; MSE over all its steps, of the mean of the samples, position and "
        "rotation apart. The paper gives its MSE no unit: beside them stands the mean square of the six numbers of a "
        "step's pose increment, three in m and three in rad, mixed.",
    )


def contact_table(evaluation: Evaluation) -> Table | None:
    """Return how contact was forecast in closed loop; None where no forecaster says it."""
    head = (
        "",
        "precision",
        "recall",
        "F1",
        "AUROC",
        "begins late by",
        "missed, spurious",
        "ends late by",
        "missed, spurious",
    )
    rows = [
        (
            scores.summary,
            *(_number(value) for value in _contact_values(scores.closed_loop.contact)),
            *_timing_cells(scores.closed_loop.onset),
            *_timing_cells(scores.closed_loop.release),
        )
        for scores in evaluation.forecasters.values()
        if scores.closed_loop.contact is not None
    ]
    note = "Lateness: median, and the middle half in brackets; negative is early. Steps of " + _step(evaluation)
    return Table("Contact in closed loop", head, rows, note) if rows else None


def long_loop_table(evaluation: Evaluation) -> Table | None:
    """Return the errors some time after the loops began; None where no episode is so long."""
    first = next(iter(evaluation.forecasters.values())).closed_loop.long_loops
    shown = [k for k, loop in enumerate(first) if loop.episodes]
    if not shown:
        return None
    head = [""]
    for k in shown:
        head += [f"{first[k].time_s:g} s ({first[k].episodes} episodes)", "rotation", "AUC up to it"]
    rows = []
    for scores in evaluation.forecasters.values():
        loops = [scores.closed_loop.long_loops[k] for k in shown]
        cells = [(mm(loop.position_error_m), degrees(loop.rotation_error_rad), share(loop.adds_auc)) for loop in loops]
        rows.append((scores.summary, *(cell for group in cells for cell in group)))
    return Table("Long loops", head, rows, "Errors at a time after the loop began, over the episodes that are so long.")


def breakdown_tables(evaluation: Evaluation) -> list[Table]:
    """Return a table for each kind of group of which there are two or more."""
    shown = {kind: groups for kind, groups in evaluation.breakdown.items() if len(groups) > 1}
    return [_breakdown_table(KINDS[kind], groups, list(evaluation.forecasters)) for kind, groups in shown.items()]


def _breakdown_table(title: str, groups: dict[str, Group], names: list[str]) -> Table:
    """Return the table of the groups of a kind."""
    rows = [
        (label, str(group.episodes), f"{group.rows:,}", *(_group_cell(group.scores[name]) for name in names))
        for label, group in groups.items()
    ]
    return Table(title, ("", "episodes", "rows", *names), rows, "Closed loop: ADD-S AUC; mean position error, angle.")


def _group_cell(scores: GroupScores) -> str:
    """Return `94.1 %; 12 mm, 3.1°`."""
    errors = f"{mm(scores.position_error_m)}, {degrees(scores.rotation_error_rad)}"
    return errors if scores.adds_auc is None else f"{share(scores.adds_auc)}; {errors}"


def models_table(evaluation: Evaluation) -> Table | None:
    """Return what the models are; None without any."""
    head = ("", "model", "checkpoint", "trained on", "of these", "history, horizon", "executes", "knows", "contact fed")
    rows = [
        (
            name,
            facts.model + (f", preset {facts.preset}" if facts.preset else ""),
            f"{facts.run}/{facts.checkpoint}, step {facts.step:,}",
            facts.trained_on,
            "not known" if facts.seen_episodes is None else f"{facts.seen_episodes} episodes",
            f"{facts.history} rows, {facts.horizon} steps",
            f"{facts.execute} steps",
            _knows(facts),
            facts.contact_from,
        )
        for name, facts in evaluation.models.items()
    ]
    return Table("The models", head, rows) if rows else None


def simulator_words(facts: SimulatorFacts) -> str:
    """Return the scene and the effects of a simulator."""
    scene = facts.scene or "the scene of each episode"
    effects = ", ".join(effect.name + (f" ({effect.element})" if effect.element else "") for effect in facts.effects)
    return f"{scene}, effects: {effects or 'none'}"


def _knows(facts: ModelFacts) -> str:
    """Return what a model is told of what comes."""
    actions = {None: DASH, True: "past and planned actions", False: "past actions only"}[facts.planned_actions]
    return actions if facts.simulator is None else f"{actions}; the simulator: {simulator_words(facts.simulator)}"


def lead_time(evaluation: Evaluation, steps: int) -> str:
    """Return `1.6 s`."""
    return f"{steps / evaluation.rate_hz:.3g} s"


def share(value: float | None) -> str:
    """Return a share as a percentage with one decimal."""
    return DASH if value is None else f"{100 * value:.1f} %"


def mm(value: float | None) -> str:
    """Return a length in millimetres."""
    return DASH if value is None else f"{digits(1e3 * value)} mm"


def degrees(value: float | None) -> str:
    """Return an angle in degrees."""
    return DASH if value is None else f"{digits(math.degrees(value))}°"


def f1(contact: Contact | None) -> str:
    """Return the F1, or a dash."""
    return DASH if contact is None else _number(contact.f1)


def count_of(success: Success) -> str:
    """Return `14 of 19`."""
    return f"{success.count} of {success.total}"


def _number(value: float | None, factor: float = 1.0) -> str:
    """Return a plain number, or a dash."""
    return DASH if value is None else digits(factor * value)


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean over the steps that were scored."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _contact_values(contact: Contact | None) -> tuple[float | None, ...]:
    """Return precision, recall, F1 and AUROC."""
    return (None,) * 4 if contact is None else (contact.precision, contact.recall, contact.f1, contact.auroc)


def _timing_cells(timing: EventTiming | None) -> tuple[str, str]:
    """Return `+0.1 s (0 to 0.2)` and `3 of 20, 1`."""
    if timing is None:
        return DASH, DASH
    missed = f"{timing.recorded - timing.matched} of {timing.recorded}, {timing.spurious}"
    if timing.median_s is None or timing.q25_s is None or timing.q75_s is None:
        return DASH, missed
    return f"{timing.median_s:+.2f} s ({timing.q25_s:+.2f} to {timing.q75_s:+.2f})", missed


def _step(evaluation: Evaluation) -> str:
    """Return `0.1 s`."""
    return f"{1 / evaluation.rate_hz:.3g} s."


def _gain(pair: Pair | None, with_interval: bool) -> str:
    """Return `+2.1 (+0.3 to +4.0)`, in points."""
    if pair is None:
        return DASH
    interval = ""
    if with_interval and pair.low is not None and pair.high is not None:
        interval = f" ({100 * pair.low:+.1f} to {100 * pair.high:+.1f})"
    return f"{100 * pair.value:+.1f}{interval}"


def _interval(ends: tuple[float, float] | None) -> str:
    """Return `51 to 88 %`."""
    return DASH if ends is None else f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f} %"
