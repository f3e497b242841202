"""Measures that flatter nobody: beliefs scored properly, errors over what there was to find, all names counted."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.outcomes import Outcome, supports
from candata.gap.blind.rows import mean, percent, quantile
from candata.schema.bench import BenchRow
from candata.schema.effect import Value
from candata.schema.report import Estimate
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Least probability that counts as stated: silence on a cause that is there costs log(100). Chosen: no search is tuned
#: on more than some hundred cases, and none can know one in a thousand.
LEAST_SUPPORT = 0.01
#: Points by which a mean claim may be off what fresh episodes show [%]. Chosen: no reader of a report acts on less.
OVERCLAIMED = 2.0
#: Resamples of the cases for an interval.
RESAMPLES = 2000
#: Target of the coverage of 90 % intervals [%].
COVERAGE = (85.0, 95.0)
#: What these rows say, by a part of their names.
MEANINGS = {
    "error over the deviation": "|found - true| / |true - model's own|: 100 % for whoever leaves the model as it is",
    "wrong names too": "how often the truth lies inside; that of an effect that is not there is the model's own value",
    "closed as claimed minus on fresh": "the share of the gap that reports say is closed, less what effects close on "
    "episodes of the hidden worlds that no search has seen; 90 % interval over cases",
    "silence counted": "how far beliefs are from what is so, over all effects of the library, mean over cases: a name "
    "brings its support, each of an ambiguous class of n 1/n, silence 0; the best score is 0",
    "support, named effects": "the same of given names alone: whoever names little scores well",
}


def honest_rows(outcomes: Sequence[Outcome], one: Sequence[Outcome], quarter: Sequence[Outcome]) -> list[BenchRow]:
    """Return the rows of these measures.

    Parameters
    ----------
    outcomes : sequence of Outcome
        All cases.
    one, quarter : sequence of Outcome
        Those of one effect, and of a quarter of one.
    """
    errors = [e for o in one if o.first for e in deviation_errors(o)]
    weak = [e for o in quarter if o.first for e in deviation_errors(o)]
    scored = [o for o in outcomes if is_scored(o)]
    named = [pair for o in scored for pair in supports(o)]
    return [
        quantile("error over the deviation: median", errors, 0.5),
        quantile("error over the deviation: 90th percentile", errors, 0.9),
        quantile("error over the deviation, a quarter: median", weak, 0.5),
        percent(
            "coverage of 90 % intervals, wrong names too", (c for o in outcomes for c in all_covered(o)), *COVERAGE
        ),
        *_fresh_rows([o for o in outcomes if o.overclaimed is not None]),
        mean("Brier score of support, silence counted", [brier_score(o) for o in scored]),
        mean("log score of support, silence counted", [log_score(o) for o in scored]),
        mean("Brier score of support, named effects", [_squared(*pair) for pair in named]),
        mean("log score of support, named effects", [_surprise(*pair) for pair in named]),
    ]


def _fresh_rows(measured: Sequence[Outcome]) -> list[BenchRow]:
    """Return what reports claim to close against fresh episodes of the hidden worlds."""
    over = np.array([100 * (o.overclaimed or 0.0) for o in measured])
    return [
        BenchRow(
            measure="closed as claimed minus on fresh episodes: mean",
            value=float(over.mean()) if len(over) else None,
            n=len(over),
            low=-OVERCLAIMED,
            high=OVERCLAIMED,
            interval=mean_interval(over) if len(over) else None,
        ),
        mean("gap closed on fresh episodes: mean", [100 * (o.closed_fresh or 0.0) for o in measured], "%"),
    ]


def mean_interval(values: Array) -> tuple[float, float]:
    """Return the ends of a 90 % interval of the mean of values `(n,)`, one a case, by resampling cases."""
    picks = resamples(np.random.default_rng(0), len(values), RESAMPLES)
    low, high = np.quantile(values[picks].mean(1), (0.05, 0.95))
    return float(low), float(high)


def is_scored(o: Outcome) -> bool:
    """Tell whether a case's beliefs are scored.

    A background is left out: a little of everything is there, so that no name is plainly right or wrong.
    """
    return o.kind != "background"


def brier_score(o: Outcome) -> float:
    """Return the sum, over all effects of the library, of (support - 1 if it is there, else 0) squared; 0 is best.

    What a report does not mention has support 0; the members of an ambiguous class of n share one belief, 1/n each.

    Source: Brier 1950, "Verification of forecasts expressed in terms of probability", Monthly Weather Review 78.
    """
    return sum(_squared(*pair) for pair in _beliefs(o))


def log_score(o: Outcome) -> float:
    """Return the sum, over all effects of the library, of -log(probability of what is so) [nats]; 0 is best.

    Beliefs are those of `brier_score`; what is stated as impossible counts as `LEAST_SUPPORT`.

    Source: Good 1952, "Rational decisions", Journal of the Royal Statistical Society B 14.
    """
    return sum(_surprise(*pair) for pair in _beliefs(o))


def _beliefs(o: Outcome) -> list[tuple[float, bool]]:
    """Return the belief in each effect that is mentioned or there, and whether it is there; all others are at 0."""
    report = o.result.report
    tied = report.ambiguous_class if report else ()
    stated = dict.fromkeys(o.truth, 0.0) | dict.fromkeys(tied, 1 / max(len(tied), 1))
    for name, effect in zip(o.named, o.effects, strict=True):
        stated[name] = effect.support
    return [(support, name in o.truth) for name, support in stated.items()]


def _squared(support: float, there: bool) -> float:
    """Return the squared distance of a belief from what is so."""
    return (support - float(there)) ** 2


def _surprise(support: float, there: bool) -> float:
    """Return -log of the probability that was given to what is so [nats]."""
    return -log(max(support if there else 1 - support, LEAST_SUPPORT))


def deviation_errors(o: Outcome) -> list[float]:
    """Return |found - true| / |true - model's own| of each parameter of each rightly named effect.

    A vector counts once, by its length. A choice has no distance, and neither has what was left as the model has it.
    """
    truth = dict(zip(o.truth, o.label.effects, strict=True))
    errors = []
    for text, named in zip(o.named, o.effects, strict=True):
        for name, estimate in named.parameters.items() if text in truth else ():
            own, true = o.nominal.get(text, {}).get(name), truth[text].parameters.get(name)
            if own is None or isinstance(true, str) or isinstance(estimate.value, str) or true is None:
                continue
            at, found = _numbers(true), _numbers(estimate.value)
            there = float(np.linalg.norm(at - own))
            if there > 0 and at.shape == found.shape:
                errors.append(float(np.linalg.norm(found - at)) / there)
    return errors


def all_covered(o: Outcome) -> list[bool]:
    """Return for each number with an interval, of any named effect, whether the truth lies inside.

    The truth of an effect that is not there is the model's own value. An end that is not known excludes none.
    """
    truth = dict(zip(o.truth, o.label.effects, strict=True))
    inside = []
    for text, named in zip(o.named, o.effects, strict=True):
        for name, estimate in named.parameters.items():
            true = truth[text].parameters.get(name) if text in truth else o.nominal.get(text, {}).get(name)
            if true is not None and not isinstance(true, str) and estimate.bounded is not None:
                inside += _inside(true, estimate)
    return inside


def _inside(true: Value, estimate: Estimate) -> list[bool]:
    """Return for each number of an estimate whether it lies between the ends, which are known on one side at least."""
    count = len(_numbers(estimate.value))
    at = np.broadcast_to(_numbers(true), count)
    low = np.full(count, -np.inf) if estimate.low is None else _numbers(estimate.low)
    high = np.full(count, np.inf) if estimate.high is None else _numbers(estimate.high)
    return [bool(inside) for inside in (low <= at) & (at <= high)]


def _numbers(value: Value) -> Array:
    """Return the numbers `(n,)` of a value."""
    return np.atleast_1d(np.asarray(value, float))
