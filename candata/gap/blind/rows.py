"""Rows of the table of a run: shares, quantiles and means of cases, and of random small scenes by trait."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from candata.gap.blind.outcomes import Outcome
from candata.schema.bench import BenchRow


def percent(measure: str, hits: Iterable[bool], low: float | None = None, high: float | None = None) -> BenchRow:
    """Return a row that counts, in percent."""
    counted = list(hits)
    value = 100 * float(np.mean(counted)) if counted else None
    return BenchRow(measure=measure, value=value, n=len(counted), low=low, high=high)


def quantile(
    measure: str, values: Sequence[float], q: float, low: float | None = None, high: float | None = None
) -> BenchRow:
    """Return a row that is a quantile of shares, in percent."""
    value = 100 * float(np.quantile(values, q)) if len(values) else None
    return BenchRow(measure=measure, value=value, n=len(values), low=low, high=high)


def mean(measure: str, values: Sequence[float], unit: Literal["%", ""] = "") -> BenchRow:
    """Return a row that is a mean of values in a unit."""
    return BenchRow(measure=measure, value=float(np.mean(values)) if len(values) else None, n=len(values), unit=unit)


#: Targets [%], chosen: a user who has no gap is told so, and is never told a cause.
NO_GAP_LOW, NAMED_HIGH, UNKNOWN_HIGH = 97.0, 0.0, 1.0


def trait_rows(outcomes: Sequence[Outcome]) -> list[BenchRow]:
    """Return the measures of cases in random small scenes; none without such cases."""
    small = [o for o in outcomes if o.label.trait is not None]
    nulls, ones = ([o for o in small if o.kind == kind] for kind in ("null", "one"))
    return [
        percent("small scenes, null: no_gap", (o.verdict == "no_gap" for o in nulls), low=NO_GAP_LOW),
        percent("small scenes, null: an effect named", (bool(o.named) for o in nulls), high=NAMED_HIGH),
        percent(
            "small scenes, null: unknown_effect", (o.verdict == "unknown_effect" for o in nulls), high=UNKNOWN_HIGH
        ),
        *(
            percent(f"small scenes, null, {trait}: no_gap", (o.verdict == "no_gap" for o in group))
            for trait, group in by_trait(nulls).items()
        ),
        percent("small scenes, one effect: first, nothing wrong beside", (o.first and not o.wrong_names for o in ones)),
        percent("small scenes, one effect: ambiguous, the effect in the class", (in_class(o) for o in ones)),
        percent("small scenes, one effect: a wrong name", (bool(o.wrong_names) for o in ones)),
        *(
            percent(f"small scenes, one effect, {trait}: first", (o.first for o in group))
            for trait, group in by_trait(ones).items()
            if len(by_trait(ones)) > 1
        ),
    ]


def by_trait(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Return the outcomes of each trait, by name."""
    found: dict[str, list[Outcome]] = {}
    for o in sorted(outcomes, key=lambda o: o.label.trait or ""):
        found.setdefault(o.label.trait or "", []).append(o)
    return found


def in_class(o: Outcome) -> bool:
    """Tell whether an ambiguous verdict's class holds the largest true contributor."""
    report = o.result.report
    return report is not None and o.largest in report.ambiguous_class
