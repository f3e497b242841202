"""Sets of effects whose signatures add up to the recording: where a search is begun that one effect cannot begin.

Growth takes first what makes up best for all causes at once, and must undo it later. To add signatures costs no
simulation: pairs of effects, and triples that contain a good pair, are fitted so on a few episodes, each number from
its neutral value. Where effects are far from adding up, the sum still tells the sets apart that share the gap;
simulation decides among the first of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.acceptance import LARGEST
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.fits import Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.measure.score import Compact
from candata.gap.screening.signature_screen import slope_of

Array = NDArray[np.float64]
Responses = Sequence[tuple[Candidate, Curve | Plane]]
Begin = Callable[[Problem, Curve], Array]
#: Sets that are grown by each other effect. Chosen: of ten pairs and triples, those whose effects each take a share of
#: the gap were always among the first two.
GROWN = 8
#: Most steps of a fit, the shares of a step that are tried, and the share of the loss below which it ends.
STEPS, SHARES, ENOUGH = 6, (1.0, 0.5, 0.25, 0.1), 0.01
#: Half widths over which a curve's slope is read, as shares of the range: wider than where a fit is sharpened. Chosen.
WITHIN = (0.02, 0.1)


@dataclass(frozen=True)
class Sum:
    """Effects whose signatures are added.

    Attributes
    ----------
    members : Members
        Where they leave least together.
    loss : float
        Mean loss there, in floors: too high where effects do more together than each alone.
    """

    members: Members
    loss: float


def sums(problem: Problem, responses: Responses) -> list[list[Sum]]:
    """Return the sets of two effects, and those of three, whose signatures leave least; of each size the best first.

    Parameters
    ----------
    problem : Problem
        The episodes that the responses are of.
    responses : sequence of (Candidate, Curve or Plane)
        Each effect alone, beside the nominal scene. No two of one name are taken together.
    """
    here = problem.nominal
    found: dict[tuple[int, ...], Sum] = {
        (i,): _added(problem, [one], here, _neutral) for i, one in enumerate(responses)
    }
    sizes = []
    for _ in range(1, LARGEST):
        best = sorted(found, key=lambda some: found[some].loss)[:GROWN]
        larger = sorted({tuple(sorted((*some, i))) for some in best for i in _others(responses, some)})
        found = {some: _added(problem, [responses[i] for i in some], here, _neutral) for some in larger}
        sizes.append(sorted(found.values(), key=lambda one: one.loss))
    return sizes


def beside(problem: Problem, here: Compact, held: Responses, responses: Responses) -> list[Sum]:
    """Return what is held with each other effect, its own numbers moved along; those that leave least first.

    A choice is there once with each of its values. A fit begins where the other effect leaves least alone: slopes at
    its neutral value lead nowhere where contact comes and goes.

    Parameters
    ----------
    problem : Problem
        The episodes that the responses are of.
    here : (E, K) float32
        Residuals where the effects held are.
    held, responses : sequences of (Candidate, Curve or Plane)
        Each as it changes those residuals.
    """
    found = [_added(problem, [*held, one], here, _alone) for response in responses for one in _values(response)]
    last = [one.members[-1] for one in found]
    acting = [one for one, (c, u) in zip(found, last, strict=True) if not c.is_neutral(u)]
    return sorted(acting, key=lambda one: one.loss)


def _values(response: tuple[Candidate, Curve | Plane]) -> Responses:
    """Return a choice's response at each of its values alone: any may be best once others move. Else itself."""
    c, curve = response
    if isinstance(curve, Plane) or not c.choices:
        return [response]
    neutral = [c.is_neutral(u) for u in curve.at[:, None]]
    pairs = [[i for i, own in enumerate(neutral) if own or i == j] for j, own in enumerate(neutral) if not own]
    return [(c, replace(curve, at=curve.at[i], z=curve.z[i], sure=curve.sure[i])) for i in pairs]


def _others(responses: Responses, some: tuple[int, ...]) -> list[int]:
    """Return which responses are of other effects than those of a set."""
    names = {responses[i][0].name for i in some}
    return [i for i, (c, _) in enumerate(responses) if c.name not in names]


def _added(problem: Problem, responses: Responses, here: Compact, begin: Begin) -> Sum:
    """Return where effects leave least together, were what each changes of `here (E, K)` to add up."""
    at = [r.at if isinstance(r, Plane) else begin(problem, r) for _, r in responses]
    z, loss = _read(problem, responses, at, here)
    for _ in range(STEPS):
        target = _plane(responses, at, z).best(np.arange(len(z)))
        ends = np.cumsum([len(u) for u in at])[:-1]
        now = np.concatenate(at)
        for share in SHARES:
            moved = np.split(now + share * (target - now), ends)
            there, less = _read(problem, responses, moved, here)
            if less < loss:
                break
        else:
            break
        before, at, z, loss = loss, moved, there, less
        if before - loss < ENOUGH * before:
            break
    return Sum(tuple((c, u) for (c, _), u in zip(responses, at, strict=True)), loss)


def _neutral(problem: Problem, curve: Curve) -> Array:
    """Return where a curve does nothing; of a choice, which has no slope, where it leaves least."""
    return _alone(problem, curve) if curve.who.choices else curve.who.neutral


def _alone(problem: Problem, curve: Curve) -> Array:
    """Return where a curve leaves least, never neutral of a choice."""
    points = [u for u in curve.at[:, None] if not (curve.who.choices and curve.who.is_neutral(u))]
    return min(points, key=lambda u: float(problem.score.loss(curve.read(u)).mean()))


def _read(problem: Problem, responses: Responses, at: Sequence[Array], here: Compact) -> tuple[Compact, float]:
    """Return residuals `(E, K)` with all that effects change of `here (E, K)` added up, and their mean loss."""
    z = here.copy()
    for (_, response), u in zip(responses, at, strict=True):
        z += response.read(u) - here
    return z, float(problem.score.loss(z).mean())


def _plane(responses: Responses, at: Sequence[Array], z: Compact) -> Plane:
    """Return the plane of all coordinates around `at`, where the residuals are `z (E, K)`."""
    low = np.concatenate([c.low for c, _ in responses])
    high = np.concatenate([c.high for c, _ in responses])
    slope = np.concatenate([slope_of(c, response, u, WITHIN) for (c, response), u in zip(responses, at, strict=True)])
    return Plane(low, high, np.concatenate(at), z, slope)
