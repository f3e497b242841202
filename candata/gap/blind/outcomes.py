"""What became of a case: the opened label beside the report."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.effects import effects_with
from candata.schema.bench import CaseResult, FreshGap, Kind, Label, Shares
from candata.schema.report import Estimate, NamedEffect

Array = NDArray[np.float64]
#: Worth of a cause [floors] below which it is said to be faint. Chosen.
FAINT = 0.1


@dataclass(frozen=True)
class Outcome:
    """One case, opened.

    Attributes
    ----------
    label : Label
        The truth.
    result : CaseResult
        What was said.
    shares : Shares or None
        What each true contributor is worth; None where there is none in the library.
    nominal : dict of str to dict of str to float
        The model's own value of each parameter of each effect that is hidden or named, by its text.
    fresh : FreshGap or None
        How far the named effects close the gap on fresh episodes; None where that was not measured.
    """

    label: Label
    result: CaseResult
    shares: Shares | None = None
    nominal: dict[str, dict[str, float]] = field(default_factory=dict)
    fresh: FreshGap | None = None

    @property
    def kind(self) -> Kind:
        """Kind of the case."""
        return self.label.kind

    @property
    def verdict(self) -> str:
        """The verdict, or `error`."""
        return self.result.report.verdict if self.result.report else "error"

    @property
    def abstains(self) -> bool:
        """Whether the cause was said not to be known, or not to be known yet."""
        return self.verdict in ("unknown_effect", "out_of_budget")

    @property
    def truth(self) -> tuple[str, ...]:
        """`name` or `name element` of each hidden effect."""
        return tuple(text_of(e.name, e.element) for e in self.label.effects)

    @property
    def named(self) -> tuple[str, ...]:
        """What the report names, the largest share first."""
        return tuple(text_of(e.name, e.element) for e in self.effects)

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """The named effects of the report."""
        return self.result.report.effects if self.result.report else ()

    @property
    def said(self) -> tuple[str, ...]:
        """What is named, then the class of an ambiguous verdict, then the ranking; nothing twice."""
        report = self.result.report
        if report is None:
            return ()
        ranked = [text_of(r.name, r.element) for r in report.ranking]
        return tuple(dict.fromkeys((*self.named, *report.ambiguous_class, *ranked)))

    @property
    def largest(self) -> str:
        """The true contributor that is worth most: by leave-one-out where known, else the main one."""
        if self.shares is not None and self.shares.rises:
            return max(self.shares.rises, key=lambda name: self.shares.rises[name] if self.shares else 0.0)
        return self.label.main or (self.truth[0] if self.truth else "")

    @property
    def first(self) -> bool:
        """Whether the largest true contributor is named first, on the right element."""
        return bool(self.truth) and self.named[:1] == (self.largest,)

    @property
    def plain(self) -> bool:
        """Whether each true cause is worth enough to be seen; true where that was not measured."""
        return self.shares is None or min(self.shares.rises.values(), default=0.0) >= FAINT

    @property
    def closed(self) -> float | None:
        """Share of the gap that was closed."""
        gap = self.result.report.gap if self.result.report else None
        return gap.closed if gap else None

    @property
    def closed_fresh(self) -> float | None:
        """Share of the gap that the named effects close on fresh episodes."""
        gap = self.fresh.gap if self.fresh else None
        return gap.closed if gap else None

    @property
    def overclaimed(self) -> float | None:
        """The closed share as the report says, less that on fresh episodes."""
        return None if self.closed is None or self.closed_fresh is None else self.closed - self.closed_fresh

    @property
    def wrong_names(self) -> tuple[str, ...]:
        """Named effects that are not there."""
        return tuple(n for n in self.named if n not in self.truth)

    @property
    def flagged(self) -> bool:
        """Whether a solver mismatch was named, put in a class, or something unknown was reported."""
        report = self.result.report
        if report is None:
            return False
        solver = set(self.truth) & set(effects_with("simulator"))
        return report.unknown is not None or bool(solver & {*self.named, *report.ambiguous_class})


def text_of(name: str, element: str | None) -> str:
    """Return `name` or `name element`."""
    return name if element is None else f"{name} {element}"


def pairs_of_numbers(outcome: Outcome) -> list[tuple[float, float, float | None, float | None]]:
    """Return (true, found, low, high) of each number of each rightly named effect; choices have none."""
    known = {text_of(e.name, e.element): e for e in outcome.label.effects}
    out: list[tuple[float, float, float | None, float | None]] = []
    for named in outcome.effects:
        true = known.get(text_of(named.name, named.element))
        for name, estimate in named.parameters.items() if true is not None else ():
            if name in true.parameters and not isinstance(estimate.value, str):  # type: ignore[union-attr]
                out += _numbers(true.parameters[name], estimate)  # type: ignore[union-attr]
    return out


def _numbers(true: object, estimate: Estimate) -> list[tuple[float, float, float | None, float | None]]:
    """Return (true, found, low, high) of one parameter's numbers."""
    at, seen = np.atleast_1d(np.asarray(true, float)), np.atleast_1d(np.asarray(estimate.value, float))
    ends = [[None] * len(at) if e is None else np.atleast_1d(e).tolist() for e in (estimate.low, estimate.high)]
    return list(zip(at.tolist(), seen.tolist(), *ends, strict=True)) if len(at) == len(seen) else []


def parameter_error(outcome: Outcome) -> float | None:
    """Return the distance of the found numbers from the true ones over the true ones' size; None without numbers."""
    rows = pairs_of_numbers(outcome)
    if not rows:
        return None
    true, found = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    size = float(np.linalg.norm(true))
    return float(np.linalg.norm(found - true)) / size if size > 0 else None


def covered(outcome: Outcome) -> list[bool]:
    """Return for each number with an interval whether the truth lies inside; an end that is not known excludes none."""
    rows = [row for row in pairs_of_numbers(outcome) if row[2] is not None or row[3] is not None]
    return [(low is None or low <= true) and (high is None or true <= high) for true, _, low, high in rows]


def supports(outcome: Outcome) -> list[tuple[float, bool]]:
    """Return the stated support of each named effect, and whether that effect is there."""
    truth = set(outcome.truth)
    return [(e.support, text_of(e.name, e.element) in truth) for e in outcome.effects]
