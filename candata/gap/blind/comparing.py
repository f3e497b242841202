"""Two runs on the same cases, paired case by case."""

from __future__ import annotations

from math import comb
from pathlib import Path

import numpy as np

from candata.errors import UsageError, Where
from candata.gap.blind.running import RESULTS, known
from candata.schema.bench import BenchFile, CaseResult, ChangedCase, PairedComparison
from candata.schema.json_text import read_json

SCORE = "bench.json"


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
    right = [(a[1], b[1]) for a, b in pairs]
    first_only, second_only = right.count((True, False)), right.count((False, True))
    return PairedComparison(
        cases=len(both),
        both_right=right.count((True, True)),
        first_only=first_only,
        second_only=second_only,
        neither=right.count((False, False)),
        p=mcnemar(first_only, second_only),
        first_cpu_s=float(np.median([a[0].cpu_s for a, _ in pairs])),
        second_cpu_s=float(np.median([b[0].cpu_s for _, b in pairs])),
        changed=tuple(
            ChangedCase(case=a[0].case, first=_said(*a), second=_said(*b)) for a, b in pairs if _said(*a) != _said(*b)
        ),
    )


def mcnemar(first_only: int, second_only: int) -> float:
    """Return the exact two-sided p of McNemar's test.

    Source: McNemar 1947, "Note on the sampling error of the difference between correlated proportions"; exact: of the
    pairs that differ, either way is as likely.
    """
    n, least = first_only + second_only, min(first_only, second_only)
    return min(1.0, 2 * sum(comb(n, k) for k in range(least + 1)) / 2**n)


def _opened(folder: Path) -> dict[str, tuple[CaseResult, bool]]:
    """Return each result of a folder and whether it is right, by the case's seal."""
    for name in (RESULTS, SCORE):
        if not (folder / name).is_file():
            raise UsageError(
                f"no {name} in {folder}",
                expected="a folder that `candata gap score --out` or `gap bench` wrote",
                where=Where(path=str(folder)),
                fix="score the cases first",
            )
    score = BenchFile.parse(read_json(folder / SCORE), folder / SCORE)
    missed = {miss.case for miss in score.misses}
    results = known(folder)
    if score.done != len(results):
        raise UsageError(
            f"{SCORE} is not the score of all results",
            expected=f"{len(results)} cases",
            found=str(score.done),
            where=Where(path=str(folder)),
            fix="run the score once more; --minutes 0 scores what is done",
        )
    return {seal: (result, result.case not in missed) for seal, result in results.items()}


def _said(result: CaseResult, right: bool) -> str:
    """Return what a diagnosis said, and whether that is right."""
    report = result.report
    if report is None:
        return f"error: {result.error}"
    names = ", ".join(e.name if e.element is None else f"{e.name} {e.element}" for e in report.effects)
    return " ".join([report.verdict, *([names] if names else []), *(["(right)"] if right else [])])
