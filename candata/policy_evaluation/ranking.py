"""How well a world ranks policies: predicted success beside what was seen, from the same starts."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, rankdata

from candata.policy_evaluation.results import Interval, WorldRanking
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Bootstrap samples of the starts. Chosen: the ends of a 95 % interval move by less than its width over 20.
DRAWS = 1000
#: Confidence of all intervals.
CONFIDENCE = 0.95


def wilson(count: int, total: int) -> Interval:
    """Return a share with its Wilson interval; of no trials, an interval from 0 to 1 around NaN.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
    """
    if total == 0:
        return Interval(value=float("nan"), low=0.0, high=1.0)
    low, high = binomtest(count, total).proportion_ci(CONFIDENCE, "wilson")
    return Interval(value=count / total, low=float(low), high=float(high))


def spearman(predicted: Array, seen_success: Array) -> Array:
    """Return Spearman's rank correlation over the last axis `(..., P)`; NaN where either is constant.

    Equal values share their mean rank. Source: C. Spearman, "The proof and measurement of association between two
    things", American Journal of Psychology 15 (1904).
    """
    ranks = [rankdata(values, axis=-1) for values in (predicted, seen_success)]
    a, b = (rank - rank.mean(-1, keepdims=True) for rank in ranks)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(-1) / np.sqrt((a**2).sum(-1) * (b**2).sum(-1)))


def mean_rank_violation(predicted: Array, seen_success: Array) -> float:
    """Return the mean maximum rank violation (MMRV) of predicted success `(P,)`; 0 is best.

    For each policy, the largest difference in seen success to a policy that the prediction puts on the wrong side of
    it; then the mean. Source: X. Li et al., "Evaluating Real-World Robot Manipulation Policies in Simulation"
    (SIMPLER), CoRL 2024, equation 1.
    """
    is_wrong = (predicted[:, None] < predicted) != (seen_success[:, None] < seen_success)
    return float((np.abs(seen_success[:, None] - seen_success) * is_wrong).max(1).mean())


def rates(success: Array, index: NDArray[np.int64] | None = None) -> Array:
    """Return the success of each policy over the starts `(P, n)` that are not NaN; NaN without any.

    Parameters
    ----------
    success : (P, n) float64
        1, 0, or NaN where nothing is known.
    index : (draws, n) int64, optional
        Resampled starts: `(draws, P)` is returned then.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is NaN, as said
        if index is None:
            return np.asarray(np.nanmean(success, axis=-1))
        return np.asarray(np.nanmean(success[:, index], axis=-1).T)


def is_comparable(predicted: Array, seen_success: Array) -> bool:
    """Tell whether any start of any policy `(P, n)` was both predicted and seen."""
    return bool(np.isfinite(predicted + seen_success).any())


def world_ranking(world: str, predicted: Array, seen_success: Array, seed: int) -> tuple[WorldRanking, Array]:
    """Return how well a world predicts policies, and its resampled rank correlations `(DRAWS,)`.

    Predicted and seen rates are those over the starts of which both are known. Policies without one are left out.

    Parameters
    ----------
    world : str
        Its name.
    predicted, seen_success : (P, n) float64
        Success of each policy from each start, 1 or 0; NaN where a simulation became unstable, or nothing was seen. At
        least one is known of both.
    seed : int
        Of the bootstrap: worlds of one evaluation share their draws.
    """
    is_known = np.isfinite(predicted + seen_success)
    known_rows = is_known.any(1)
    paired_success, real = (np.where(is_known, success, np.nan)[known_rows] for success in (predicted, seen_success))
    rate, truth = rates(paired_success), rates(real)
    index = resamples(np.random.default_rng(seed), seen_success.shape[1], DRAWS)
    drawn_values = spearman(rates(paired_success, index), rates(real, index))
    counts = [(int(np.nansum(row)), int(np.isfinite(row).sum())) for row in paired_success]
    intervals = [wilson(*count) for count in counts]
    covered_flags = [entry.low <= value <= entry.high for entry, value in zip(intervals, truth, strict=True)]
    return WorldRanking(
        world=world,
        policies=int(known_rows.sum()),
        pairs=int(np.isfinite(paired_success).sum()),
        spearman=_interval(float(spearman(rate, truth)), drawn_values, 1.0),
        mmrv=mean_rank_violation(rate, truth),
        mean_error=float(np.abs(rate - truth).mean()),
        bias=float((rate - truth).mean()),
        covered=float(np.mean(covered_flags)),
        agreement=float(np.nanmean(np.where(np.isfinite(paired_success), paired_success == real, np.nan))),
    ), drawn_values


def _interval(value: float, drawn_values: Array, most: float) -> Interval:
    """Return a value with the central interval of its resamples; NaN ends where it has none.

    A resample in which all succeed alike has no order, and could be anything from `-most` to `most`: it counts as the
    one for the lower end and as the other for the upper.
    """
    if not np.isfinite(value):
        return Interval(value=value, low=float("nan"), high=float("nan"))
    tail, is_known = 100 * (1 - CONFIDENCE) / 2, np.isfinite(drawn_values)
    low = np.percentile(np.where(is_known, drawn_values, -most), tail)
    high = np.percentile(np.where(is_known, drawn_values, most), 100 - tail)
    return Interval(value=value, low=float(low), high=float(high))


def lead(best_draws: Array, other_draws: Array, value: float) -> Interval:
    """Return by how much a rank correlation is above another, with the interval of paired resamples."""
    return _interval(value, best_draws - other_draws, 2.0)


def best_ranking(rankings: tuple[WorldRanking, ...]) -> WorldRanking | None:
    """Return the world that predicts policies best: highest rank correlation, then least MMRV and mean error.

    None where no world has a rank correlation.
    """
    known_rows = [entry for entry in rankings if np.isfinite(entry.spearman.value)]
    if not known_rows:
        return None
    return max(known_rows, key=lambda entry: (entry.spearman.value, -entry.mmrv, -entry.mean_error))


def headline(
    top_ranking: WorldRanking | None, margin: Interval | None, seen_success: Array, worlds: Sequence[str]
) -> str:
    """Return the first line: which world predicts policies best, and by how much.

    Parameters
    ----------
    top_ranking : WorldRanking or None
        Of the best world; None where none has a rank correlation.
    margin : Interval or None
        How far it is ahead of the nominal simulator.
    seen_success : (P, n) float64
        What was seen of each policy from each start; NaN where nothing was.
    worlds : sequence of str
        Names of those that predict.
    """
    seen_rates = rates(seen_success)
    seen_rates = seen_rates[np.isfinite(seen_rates)]
    if not len(seen_rates):
        return f"No world can be judged: nothing was seen of these policies. Predicted in {', '.join(worlds)}"
    if len(seen_rates) == 1:
        return "No world can be ranked: one policy alone was seen"
    if top_ranking is None:
        where = "as they were seen" if np.ptp(seen_rates) == 0 else f"in {' and in '.join(worlds)}"
        return f"No world can be ranked: all policies succeed alike {where}"
    words = f"{top_ranking.world} predicts policies best: rank correlation {top_ranking.spearman.value:.2f}"
    if len(worlds) == 1:
        return f"{words}; no other world was compared"
    if margin is None:
        return f"{words}; no world is ahead of the nominal simulator"
    if not np.isfinite(margin.value):
        return f"{words}; the nominal simulator shows no order of the policies"
    return f"{words}, {margin.value:.2f} above the nominal simulator (95 %: {margin.low:.2f} to {margin.high:.2f})"
