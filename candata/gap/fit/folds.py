"""Cross-fitting: every episode is held out once, and nothing is decided on what was fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.response import Curve, NullQuadratic, Plane, null_quadratic
from candata.gap.measure.score import Score

Array = NDArray[np.float64]
Index = NDArray[np.int64]
FOLDS = 4
#: Simulated points among which a vector's fit takes the best over all episodes, held-out ones included: its luck is
#: the best of as many draws.
TRIALS = 8
#: Null replays of each episode that are read along every response.
NULLS_READ = 8
#: Null sets from which the threshold is taken, and its quantile.
NULL_SETS, NULL_QUANTILE = 240, 0.99


@dataclass(frozen=True)
class CrossFit:
    """Held-out evidence for one candidate.

    Attributes
    ----------
    gain : (E,) float64
        Loss without minus loss with the effect, in floors, each episode held out once.
    loss : (E,) float64
        Held-out loss with the effect, in floors.
    points : (FOLDS, d) float64
        Coordinates fitted without each fold.
    """

    gain: Array
    loss: Array
    points: Array


def folds(tasks: tuple[str, ...], rng: np.random.Generator, pieces: Index | None = None) -> list[Index]:
    """Return the episodes of each fold, every task spread evenly over the folds.

    Episodes of one independent piece of evidence `pieces (E,)` share a fold where there is a piece for each fold.
    """
    if pieces is not None and len(np.unique(pieces)) >= FOLDS and len(np.unique(pieces)) < len(pieces):
        order = rng.permutation(np.unique(pieces))
        return [np.flatnonzero(np.isin(pieces, order[f::FOLDS])) for f in range(FOLDS)]
    by_task = sorted(range(len(tasks)), key=lambda i: (tasks[i], rng.random()))
    return [np.array(sorted(by_task[f::FOLDS]), int) for f in range(FOLDS)]


def rest(parts: list[Index], fold: int) -> Index:
    """Return the training episodes of a fold."""
    return np.concatenate([p for f, p in enumerate(parts) if f != fold])


def cross_fit(response: Curve | Plane, score: Score, parts: list[Index], base: Array) -> CrossFit:
    """Return the held-out evidence of a response; `base (E,)` is the loss without it."""
    loss = np.zeros(len(base))
    points = []
    fit = response.fitter(score)
    for f, test in enumerate(parts):
        u = fit(rest(parts, f))
        points.append(u)
        loss[test] = score.take(test).loss(response.read(u)[test])
    return CrossFit(base - loss, loss, np.array(points))


def null_threshold(
    responses: list[Curve | Plane],
    score: Score,
    parts: list[Index],
    luck: Array,
    rng: np.random.Generator,
    tried: int | None = None,
) -> float:
    """Return the 99 % quantile of the best mean held-out gain over null sets.

    A null set takes one null replay of each episode at random; every candidate is fitted and scored on it exactly
    as on the recording, its response added to the null residual. Contact is chaotic: any change of the world deals
    an episode another outcome, so each candidate also draws, for each episode, the gain of a replay that differs
    in nothing but its start.

    Parameters
    ----------
    luck : (J, E) float64
        Gain of nominal replays from other starts over the typical one, in floors.
    tried : int, optional
        How many candidates the responses were chosen among: the share of nulls that may lie above falls accordingly
        (Bonferroni).
    """
    above = (1 - NULL_QUANTILE) * min(1.0, len(responses) / (tried or max(len(responses), 1)))
    score = replace(score, null=score.null[:NULLS_READ], null_loss=score.null_loss[:NULLS_READ])
    tables = [_null_tables(r, score) if isinstance(r, Curve) else null_quadratic(r, score) for r in responses]
    best = np.zeros(NULL_SETS)
    episodes = np.arange(score.null.shape[1])
    for i in range(NULL_SETS):
        chosen = rng.integers(len(score.null), size=len(episodes))
        draws = rng.integers(len(luck), size=(len(tables), TRIALS, len(episodes)))
        lucky = luck[draws, episodes].mean(2)
        lucky = np.where([isinstance(t, NullQuadratic) for t in tables], lucky.max(1), lucky[:, 0])
        best[i] = max((_null_gain(t, chosen, parts) + c for t, c in zip(tables, lucky, strict=True)), default=0.0)
    return float(np.quantile(best, 1 - above))


def _null_gain(table: Array | NullQuadratic, chosen: Index, parts: list[Index]) -> float:
    """Return the mean held-out gain of one candidate on one null set."""
    if isinstance(table, NullQuadratic):
        return _quadratic_gain(table, chosen, parts)
    return _table_gain(table, chosen, parts)


def _null_tables(curve: Curve, score: Score) -> Array:
    """Return `(R, G + 1, E)` losses of every null along the curve's grid, the unchanged null last."""
    rows = []
    for z in score.null:
        rows.append(np.concatenate([curve.table(score, z), score.loss(z)[None]]))
    return np.stack(rows)


def _table_gain(tables: Array, chosen: Index, parts: list[Index]) -> float:
    """Return the mean held-out gain of a curve on one null set."""
    table = tables[chosen, :, np.arange(len(chosen))]
    gain = np.zeros(len(chosen))
    for f, test in enumerate(parts):
        at = int(np.argmin(table[rest(parts, f), :-1].mean(0)))
        gain[test] = table[test, -1] - table[test, at]
    return float(gain.mean())


def _quadratic_gain(quadratic: NullQuadratic, chosen: Index, parts: list[Index]) -> float:
    """Return the mean held-out gain of a plane on one null set."""
    gain = np.zeros(len(chosen))
    for f, test in enumerate(parts):
        gain[test] = quadratic.gain(chosen, test, quadratic.step(chosen, rest(parts, f)))
    return float(gain.mean())


#: Fewest episodes on which anything is decided.
FEWEST = 8
