"""Two runs on the same cases, paired case by case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError, Where
from candata.gap.blind.honesty import RESAMPLES
from candata.gap.blind.runs import RESULTS, standing_results
from candata.schema.bench import (
    BenchFile,
    CaseResult,
    CaseScore,
    ChangedCase,
    Kind,
    NoiseCase,
    PairedComparison,
    PairedKind,
    PairedMeasure,
)
from candata.schema.json_text import read_json
from candata.statistics import resamples

Array = NDArray[np.float64]
SCORE = "bench.json"
#: The measure that the summary names.
CPU = "CPU s a case"
#: Ends of a 90 % interval.
ENDS = (0.05, 0.95)


class ScoredResult(NamedTuple):
    """What a diagnosis said of a case, and how that was scored."""

    result: CaseResult
    score: CaseScore


Pair = tuple[ScoredResult, ScoredResult]


def compare_runs(first: Path, second: Path) -> PairedComparison:
    """Return how two folders of results differ on the cases that both have diagnosed, told apart by their seals.

    Parameters
    ----------
    first, second : Path
        Folders with `results.jsonl` and `bench.json`; a case is right where the latter counts no miss.

    Raises
    ------
    UsageError
        When a folder has no score, or the two share no case.
    """
    one, other = _opened(first), _opened(second)
    both = [seal for seal in one if seal in other]
    if not both:
        raise UsageError(
            "the two runs share no case",
            expected="results on the same cases",
            found=f"{len(one)} and {len(other)}",
            where=Where(path=str(second)),
            fix="score the same folder of cases with both versions",
        )
    pairs = [(one[seal], other[seal]) for seal in both]
    measures = _measures(pairs)
    whole = paired_kind("all", pairs)
    return PairedComparison(
        **whole.model_dump(),
        summary=summary(whole, next((m for m in measures if m.measure == CPU), None)),
        first_cpu_s=float(np.median([a.result.cpu_s for a, _ in pairs])),
        second_cpu_s=float(np.median([b.result.cpu_s for _, b in pairs])),
        kinds=_kinds(pairs),
        measures=measures,
        changed=tuple(_changed(a, b) for a, b in pairs if _said(a) != _said(b)),
    )


def mcnemar(first_only: int, second_only: int) -> float:
    """Return the exact two-sided p of McNemar's test.

    Source: McNemar 1947, "Note on the sampling error of the difference between correlated proportions"; exact: of the
    pairs that differ, either way is as likely.
    """
    n, least = first_only + second_only, min(first_only, second_only)
    return min(1.0, 2 * sum(comb(n, k) for k in range(least + 1)) / 2**n)


def summary(whole: PairedKind, cpu: PairedMeasure | None) -> str:
    """Return one sentence on who is right more often, A (the first) or B, and what B costs."""
    gain = whole.second_only - whole.first_only
    count = f"{abs(gain)} {'more' if gain > 0 else 'fewer'}" if gain else "as many"
    text = f"B is right in {count} of {whole.cases} cases{'' if gain else ' as A'} (p = {whole.p:.2g})"
    return text if cpu is None else f"{text}, costs {cpu.change:.2g} times the CPU"


def paired_kind(kind: str, pairs: Sequence[Pair]) -> PairedKind:
    """Return the paired counts of some cases."""
    right = [(a.score.right, b.score.right) for a, b in pairs]
    first_only, second_only = right.count((True, False)), right.count((False, True))
    return PairedKind(
        kind=kind,
        cases=len(pairs),
        both_right=right.count((True, True)),
        first_only=first_only,
        second_only=second_only,
        neither=right.count((False, False)),
        p=mcnemar(first_only, second_only),
    )


def _kinds(pairs: Sequence[Pair]) -> tuple[PairedKind, ...]:
    """Return the counts of each kind of case, then of each kind of noise where there are several."""
    kinds = {kind: [p for p in pairs if p[0].score.kind == kind] for kind in get_args(Kind)}
    noises = {f"noise {noise}": [p for p in pairs if p[0].score.noise == noise] for noise in get_args(NoiseCase)}
    has_noises = sum(bool(group) for group in noises.values()) > 1
    groups = {**kinds, **(noises if has_noises else {})}
    return tuple(paired_kind(name, group) for name, group in groups.items() if group)


def _measures(pairs: Sequence[Pair]) -> tuple[PairedMeasure, ...]:
    """Return cost and honesty of both runs, each on the cases in which both have it."""
    # A case that one run diagnosed with nothing kept, and the other not, says nothing of cost.
    alike = [(a, b) for a, b in pairs if a.result.cold == b.result.cold]
    found = [
        _cost(CPU, _values(alike, lambda r: r.result.cpu_s)),
        _cost("replays a case", _values(alike, lambda r: r.result.replays)),
        _belief("log score of support", _values(pairs, lambda r: r.score.log_score)),
        _belief("Brier score of support", _values(pairs, lambda r: r.score.brier_score)),
        _belief("closed: claimed minus fresh", _values(pairs, lambda r: r.score.overclaimed)),
    ]
    return tuple(measure for measure in found if measure is not None)


def _values(pairs: Sequence[Pair], value: Callable[[ScoredResult], float | None]) -> Array:
    """Return the values `(n, 2)` of the cases that have one in both runs."""
    both = [(value(a), value(b)) for a, b in pairs]
    return np.array([pair for pair in both if None not in pair], float).reshape(-1, 2)


def _cost(measure: str, values: Array) -> PairedMeasure | None:
    """Return medians, and the median over cases of the second cost over the first; None without values above zero."""
    values = values[(values > 0).all(1)]
    return _paired(measure, values, values[:, 1] / values[:, 0], is_ratio=True)


def _belief(measure: str, values: Array) -> PairedMeasure | None:
    """Return means, and the mean over cases of the second value less the first; None without values."""
    return _paired(measure, values, values[:, 1] - values[:, 0], is_ratio=False)


def _paired(measure: str, values: Array, changes: Array, is_ratio: bool) -> PairedMeasure | None:
    """Return the middles of values `(n, 2)` and of changes `(n,)`: medians of ratios, else means; None if n is 0."""
    if not len(values):
        return None
    middle = np.median if is_ratio else np.mean
    low, high = np.quantile(middle(_resampled(changes), axis=1), ENDS)
    first, second = middle(values, axis=0)
    return PairedMeasure(
        measure=measure,
        cases=len(values),
        statistic="median" if is_ratio else "mean",
        first=float(first),
        second=float(second),
        change=float(middle(changes)),
        is_ratio=is_ratio,
        low=float(low),
        high=float(high),
    )


def _resampled(values: Array) -> Array:
    """Return values `(n,)`, one a case, as `(RESAMPLES, n)` resamples of the cases."""
    picks: Array = values[resamples(np.random.default_rng(0), len(values), RESAMPLES)]
    return picks


def _opened(folder: Path) -> dict[str, ScoredResult]:
    """Return each result of a folder with its score, by the case's seal."""
    for name in (RESULTS, SCORE):
        if not (folder / name).is_file():
            raise UsageError(
                f"no {name} in {folder}",
                expected="a folder that `candata gap score --out` or `gap bench` wrote",
                where=Where(path=str(folder)),
                fix="score the cases first",
            )
    score = BenchFile.parse(read_json(folder / SCORE), folder / SCORE)
    results, scores = standing_results(folder), {one.sealed: one for one in score.scores}
    if set(scores) != set(results):
        raise UsageError(
            f"{SCORE} is not the score of all results",
            expected=f"{len(results)} cases",
            found=f"{len(set(scores) & set(results))}",
            where=Where(path=str(folder)),
            fix="run the score once more; --minutes 0 scores what is done",
        )
    return {seal: ScoredResult(result, scores[seal]) for seal, result in results.items()}


def _changed(a: ScoredResult, b: ScoredResult) -> ChangedCase:
    """Return a case that two runs take differently."""
    return ChangedCase(
        case=a.result.case,
        kind=a.score.kind,
        first=_said(a),
        second=_said(b),
        first_right=a.score.right,
        second_right=b.score.right,
    )


def _said(found: ScoredResult) -> str:
    """Return what a diagnosis said, and whether that is right."""
    report = found.result.report
    if report is None:
        return f"error: {found.result.error}"
    names = ", ".join(e.name if e.element is None else f"{e.name} {e.element}" for e in report.effects)
    return " ".join([report.verdict, *([names] if names else []), *(["(right)"] if found.score.right else [])])
