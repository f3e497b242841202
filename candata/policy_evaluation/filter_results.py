"""Records of what a filter chose and gained, and the table that a terminal shows."""

from __future__ import annotations

from candata.policy_evaluation.results import Interval
from candata.schema.record import Record


class StartResult(Record):
    """What was chosen at the start of an episode.

    `candidate` is the name of the chunk, null where the filter abstained for `reason` (`outside`: no candidate lies
    within what the model has seen and within reach of the command before; `unsure`: forecasts disagree by more than the
    choice gains). `gain` and `spread` are
    costs in goals. `forecast_before` and `forecast_after` are the shares of forecasts that reach the goal: of all
    candidates, and of the chosen one.
    """

    id: str
    candidate: str | None
    reason: str | None
    gain: float
    spread: float
    forecast_before: float
    forecast_after: float | None


class ChooserResult(Record):
    """What a chooser's chunks came to in the withheld world.

    `after` is where it chose, `before` random choice at the same starts, `lift` the difference with a 95 % interval by
    bootstrap over starts; all null where it chose nowhere. `abstained` is the share of starts.
    """

    abstained: Interval
    after: Interval | None = None
    before: Interval | None = None
    lift: Interval | None = None


class Withheld(Record):
    """Success in a withheld world: of random choice, of the planned chunks, and of each chooser.

    `planned` is null where the candidates are motions of a file; `success` is by start, null where nothing was chosen.
    """

    random: Interval
    planned: Interval | None = None
    choosers: dict[str, ChooserResult]
    success: dict[str, tuple[bool | None, ...]]


class FilterResult(Record):
    """What `candata policy filter --json` prints; `judge` is who chose, `goal` what was meant."""

    format: str = "candata-policy-filter-1"
    dataset: str
    judge: str
    goal: str
    candidates: int
    chunk_s: float
    seed: int
    starts: tuple[StartResult, ...]
    withheld: Withheld | None = None


def filter_text(result: FilterResult) -> str:
    """Return the result for a terminal: what was chosen, and the table of the withheld world where there is one."""
    chosen = [start for start in result.starts if start.candidate is not None]
    reasons = {reason: sum(start.reason == reason for start in result.starts) for reason in ("outside", "unsure")}
    lines = [
        f"{result.judge} chose one of {result.candidates} chunks of {result.chunk_s:g} s at {len(chosen)} of "
        f"{len(result.starts)} starts and abstained at {len(result.starts) - len(chosen)} "
        f"({reasons['outside']} outside what it has seen, {reasons['unsure']} unsure)"
    ]
    if chosen:
        before = sum(start.forecast_before for start in chosen) / len(chosen)
        after = sum(start.forecast_after or 0.0 for start in chosen) / len(chosen)
        lines.append(f"its forecast of {result.goal} where it chose: {before:.0%} before, {after:.0%} after")
    if result.withheld is not None:
        lines += ["", *_withheld_lines(result.withheld)]
    return "\n".join(lines)


def _withheld_lines(withheld: Withheld) -> list[str]:
    """Return the table of the withheld world, one row a chooser."""
    width = max(len("in the withheld world, by"), *(len(name) for name in withheld.choosers))
    heads = f"{'in the withheld world, by':{width}}  {'before':>18}  {'after':>18}  {'gain':>24}  abstained"
    lines = [heads, f"{'random choice':{width}}  {interval_text(withheld.random)}"]
    if withheld.planned is not None:
        lines.append(f"{'no choice, as planned':{width}}  {interval_text(withheld.planned)}")
    for name, each in withheld.choosers.items():
        lines.append(
            f"{name:{width}}  {interval_text(each.before)}  {interval_text(each.after)}  "
            f"{lift_text(each.lift)}  {each.abstained.value:.0%}"
        )
    return lines


def interval_text(share: Interval | None) -> str:
    """Return `40 % (27 to 55 %)`, at least 18 characters wide; a dash for None."""
    text = "-" if share is None else f"{100 * share.value:.0f} % ({100 * share.low:.0f} to {100 * share.high:.0f} %)"
    return f"{text:>18}"


def lift_text(lift: Interval | None) -> str:
    """Return `+20 (+5 to +34) points`, at least 24 characters wide; a dash for None."""
    if lift is None:
        return f"{'-':>24}"
    return f"{f'{100 * lift.value:+.0f} ({100 * lift.low:+.0f} to {100 * lift.high:+.0f}) points':>24}"
