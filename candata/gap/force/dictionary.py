"""Sparse regression of a residual force on a dictionary: held-out episodes decide how many terms it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import rho, weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Most terms in a description: what a person can still read.
MOST_TERMS = 3
#: Share of the first term's gain that a further term must add.
ADDS = 0.05
#: Rounds of reweighting; the weights hardly change after three.
ROUNDS = 3


@dataclass(frozen=True)
class Sample:
    """A residual force and its dictionary on one element, as block means.

    Attributes
    ----------
    force : (E, B, A) float64
        Along A axes [N or N m]; NaN where not known.
    terms : (E, B, A, K) float64
        Values of the dictionary.
    groups : sequence of tuples of int
        Terms that come and go together.
    sigma : (A,) float64
        Spread of the force in null replays.
    """

    force: Array
    terms: Array
    groups: Sequence[tuple[int, ...]]
    sigma: Array


@dataclass(frozen=True)
class Description:
    """A few terms that make up a residual force.

    Attributes
    ----------
    terms : tuple of int
        Chosen terms, the most telling first.
    coefficients : (k, A) float64
        Fitted on all episodes.
    gain : (E,) float64
        Held-out gain of each episode: Student-t loss without minus with the terms, summed over its blocks.
    """

    terms: tuple[int, ...]
    coefficients: Array
    gain: Array


def describe_force(sample: Sample, parts: Sequence[Index]) -> Description:
    """Return the few terms that describe a force best on held-out episodes; none where none helps.

    Forward selection by held-out gain; a term is added while it gains more than one standard error over episodes and
    `ADDS` of what the first gained. Where the first group, the plainest, gains as much as the best within one standard
    error, it begins (Breiman et al. 1984, section 3.4.3; Pati, Rezaiifar & Krishnaprasad 1993).
    """
    chosen: tuple[int, ...] = ()
    gain = np.zeros(len(sample.force))
    left = list(sample.groups)
    while left and len(chosen) < MOST_TERMS:
        found = [held_out_gain(sample, parts, (*chosen, *group)) for group in left]
        best = int(np.argmax([g.sum() for g in found]))
        if not chosen and (found[best] - found[0]).sum() <= _error(found[best] - found[0]):
            best = 0
        more = found[best] - gain
        if more.sum() <= max(_error(more), ADDS * gain.sum(), 0.0):
            break
        chosen, gain = (*chosen, *left.pop(best)), found[best]
    return Description(chosen, fitted(sample, chosen), gain)


def alternatives(sample: Sample, parts: Sequence[Index], chosen: tuple[int, ...]) -> list[Description]:
    """Return descriptions by one group that gain as much as the best such within one standard error, the best first.

    The description by the `chosen` terms is none of them, but what it begins with alone may be.
    """
    found = sorted(
        (Description(group, fitted(sample, group), held_out_gain(sample, parts, group)) for group in sample.groups),
        key=lambda d: -float(d.gain.sum()),
    )
    behind = [found[0].gain - d.gain for d in found]
    near = [d for d, less in zip(found, behind, strict=True) if less.sum() <= _error(less) and d.gain.sum() > 0]
    return [d for d in near if d.terms != chosen]


def _error(more: Array) -> float:
    """Return the standard error of a sum over episodes."""
    return float(more.std(ddof=1) * np.sqrt(len(more))) if len(more) > 1 else 0.0


def held_out_gain(sample: Sample, parts: Sequence[Index], chosen: tuple[int, ...]) -> Array:
    """Return `(E,)` the loss that terms remove from episodes that took no part in their fit."""
    out = np.zeros(len(sample.force))
    everything = np.arange(len(out))
    for test in parts:
        coefficients = fitted(sample, chosen, np.setdiff1d(everything, test))
        out[test] = _loss(sample, test, None, ()) - _loss(sample, test, coefficients, chosen)
    return out


def _loss(sample: Sample, index: Index, coefficients: Array | None, chosen: tuple[int, ...]) -> Array:
    """Return `(e,)` Student-t losses summed over blocks and axes."""
    error = sample.force[index]
    if coefficients is not None:
        error = error - np.einsum("ebak,ka->eba", sample.terms[index][..., list(chosen)], coefficients)
    z = (error / sample.sigma).astype(np.float32)
    return np.asarray(np.nansum(rho(z), axis=(1, 2), dtype=np.float64))


def fitted(sample: Sample, chosen: tuple[int, ...], index: Index | None = None) -> Array:
    """Return coefficients `(k, A)` of terms by reweighted least squares on some episodes, all by default."""
    some = slice(None) if index is None else index
    axes = sample.force.shape[2]
    out = np.zeros((len(chosen), axes))
    for a in range(axes if chosen else 0):
        y = sample.force[some][:, :, a].ravel()
        x = sample.terms[some][:, :, a][..., list(chosen)].reshape(len(y), -1)
        seen = np.isfinite(y) & np.isfinite(x).all(1)
        out[:, a] = _robust(x[seen], y[seen], float(sample.sigma[a]))
    return out


def _robust(x: Array, y: Array, sigma: float) -> Array:
    """Return coefficients by reweighted least squares; a little ridge keeps terms that never act at zero."""
    scale = np.maximum(np.sqrt((x**2).mean(0)), 1e-12) if len(x) else np.ones(x.shape[1])
    design, weight = x / scale, np.ones(len(y))
    out = np.zeros(x.shape[1])
    for _ in range(ROUNDS):
        square = design.T @ (weight[:, None] * design) + 1e-3 * np.eye(len(out)) * max(len(y), 1) ** 0.5
        out = np.linalg.solve(square, design.T @ (weight * y))
        weight = weights(((y - design @ out) / sigma).astype(np.float32)).astype(float)
    return out / scale
