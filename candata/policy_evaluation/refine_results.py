"""Records of what refinement did, and its table."""

from __future__ import annotations

from candata.policy_evaluation.filter_results import interval_text, lift_text
from candata.policy_evaluation.results import Interval
from candata.schema.record import Record


class RefinedSuccess(Record):
    """Success in a withheld world before and after refinement; `lift` has a 95 % interval by bootstrap over starts."""

    changed: int
    before: Interval
    after: Interval
    lift: Interval


class RefineResult(Record):
    """What `candata policy refine --json` prints.

    `changed` counts the starts at which the refined chunk is surely better by the model's forecast and was kept;
    `forecast_before` and `forecast_after` are shares of forecasts that reach the goal. `withheld` is by who refined.
    """

    format: str = "candata-policy-refine-1"
    dataset: str
    model: str
    goal: str
    chunk_s: float
    starts: int
    changed: int
    forecast_before: float
    forecast_after: float
    withheld: dict[str, RefinedSuccess] | None = None


def refine_text(result: RefineResult) -> str:
    """Return the result for a terminal."""
    lines = [
        f"{result.model} refined the chunk of {result.chunk_s:g} s at {result.changed} of {result.starts} starts; "
        "elsewhere the planned one stays",
        f"its forecast of {result.goal}: {result.forecast_before:.0%} before, {result.forecast_after:.0%} after",
    ]
    if result.withheld:
        width = max(len("in the withheld world, by"), *(len(name) for name in result.withheld))
        heads = f"{'in the withheld world, by':{width}}  {'before':>18}  {'after':>18}  {'gain':>24}  refined"
        lines += ["", heads]
        lines += [
            f"{name:{width}}  {interval_text(each.before)}  {interval_text(each.after)}  "
            f"{lift_text(each.lift)}  {each.changed} of {result.starts}"
            for name, each in result.withheld.items()
        ]
    return "\n".join(lines)
