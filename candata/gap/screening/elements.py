"""Local causes: which effects on one joint, fingertip or geom alone are worth simulating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect, sensed_at
from candata.gap.data.robust_loss import rho
from candata.gap.fit.candidates import Candidate, local_candidates, on_slides
from candata.gap.fit.problem import Problem, fit_one
from candata.gap.fit.response import Curve, Plane
from candata.gap.measure.score import Compact
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Variants on one element that are simulated by their promise, and the largest number of one effect among them. Chosen
#: for cost: as many more simulations as a twelfth of the first screen of a hand.
LOCAL, LOCAL_EACH = 6, 2
#: Most variants that are simulated because they act on the joint, a link that its drive feels, or the fingertip whose
#: readings stand out: most drive and joint effects of a joint. Record 43.
ALSO = 9
#: Loss of an element's readings, in those of the nulls, from which all effects on it are simulated. Chosen: it decides
#: what is simulated, never what is named.
STANDS_OUT = 1.5


def promising(
    problem: Problem, here: Compact, responses: Sequence[tuple[Candidate, Curve | Plane]], base: Array
) -> list[Candidate]:
    """Return the variants on one element that are worth simulating.

    Parameters
    ----------
    problem : Problem
    here : (E, K) float32
        Normalised residuals without another effect.
    responses : sequence of (Candidate, Curve or Plane)
        Of the effects on all elements.
    base : (E,) float64
        Typical loss without another effect, in floors.

    Notes
    -----
    What a fault of one joint or fingertip does is taken for what the same fault of all does to that joint's or
    fingertip's own readings: a screen without simulations. All effects on the elements whose readings stand out most
    come along too, as a strong fault spreads beyond what it sits on. So do all variants on the support, which has no
    readings, and on slides, where the effect as a whole does nothing: of them such a screen says nothing.
    """
    found: list[tuple[float, Candidate]] = []
    aside: list[Candidate] = []
    scene, worst = problem.replayer.scene, _standing_out(problem, here)
    also: dict[str, list[tuple[float, Candidate]]] = {channel: [] for channel in worst}
    for c, response in responses:
        variants = local_candidates(c, scene)
        aside += [*on_slides(c, scene), *(v for v in variants if v.element == scene.file.support)]
        apart = {v.label for v in aside}
        gains = promises(problem, c, [v for v in variants if v.label not in apart], response, base)
        found += [pair for pair in gains[:LOCAL_EACH] if pair[0] > 0]
        channel = _channel(c)
        if channel in worst:
            also[channel] += [(gain, v) for gain, v in gains if _acts_at(v, worst[channel], scene)]
    chosen = aside + [c for _, c in sorted(found, key=lambda pair: -pair[0])[:LOCAL]]
    taken = {c.label for c in chosen}
    for pairs in also.values():
        others = [c for _, c in sorted(pairs, key=lambda pair: -pair[0]) if c.label not in taken]
        chosen += others[:ALSO]
    return chosen


def promises(
    problem: Problem, c: Candidate, variants: Sequence[Candidate], response: Curve | Plane, base: Array
) -> list[tuple[float, Candidate]]:
    """Return the held-out gain that each variant of `c` on one element promises, the best first; see `promising`.

    An element without readings (a fingertip where no forces were recorded, the support) promises what all of them do.
    """
    whole = fit_one(problem, c, response, base).gain if any(_columns(problem, v) is None for v in variants) else 0.0
    gains = [(_screened(problem, c, v, response, base, whole), v) for v in variants]
    return sorted(gains, key=lambda pair: -pair[0])


def _standing_out(problem: Problem, here: Compact) -> dict[str, str]:
    """Return the joint and the fingertip whose readings leave the nulls most, by channel, where they do so at all."""
    found = {}
    for channel in ("joint_position", "fingertip_force"):
        elements = dict.fromkeys(_owner(c, e) for c, e, _ in problem.plan.columns if c == channel)
        loss = {e: _own_loss(problem, here, channel, e) for e in elements}
        worst = max(loss, key=lambda e: loss[e], default=None)
        if worst is not None and loss[worst] > STANDS_OUT:
            found[channel] = worst
    return found


def _own_loss(problem: Problem, here: Compact, channel: str, element: str) -> float:
    """Return the loss of an element's own readings over what the nulls have there."""
    mine = _own_columns(problem, channel, (element,)) & problem.score.mask
    size = [float(rho(z[mine]).mean()) if mine.any() else 0.0 for z in (here, *problem.score.null)]
    return size[0] / max(float(np.mean(size[1:])), 1e-9)


def _screened(
    problem: Problem, c: Candidate, variant: Candidate, response: Curve | Plane, base: Array, whole: float
) -> float:
    """Return the held-out gain that a variant on one element promises, from the response of its effect `c`."""
    columns = _columns(problem, variant)
    if columns is None:
        return whole
    if isinstance(response, Curve):
        kept = np.where(columns, response.z, response.neutral())
        return fit_one(problem, variant, replace(response, z=kept), base).gain
    mine = np.flatnonzero(variant.own[c.own])
    if len(mine) < variant.size:  # numbers that the effect as a whole has not: of jaws on rails
        return 0.0
    slope = response.slope[mine] * columns
    plane = Plane(variant.low, variant.high, variant.neutral, response.z, slope)
    return fit_one(problem, variant, plane, base).gain


def _columns(problem: Problem, variant: Candidate) -> NDArray[np.bool_] | None:
    """Return `(K,)` which block means are readings of the variant's element; None where it has none."""
    places = sensed_at(variant.name, problem.replayer.scene, str(variant.element))
    mine = _own_columns(problem, _channel(variant), places)
    return mine if mine.any() else None


def _acts_at(variant: Candidate, place: str, scene: Scene) -> bool:
    """Tell whether a variant acts on a joint or fingertip itself, or on a link that the joint's drive feels."""
    if effect(variant.name).acts_on == "link":
        return place in sensed_at(variant.name, scene, str(variant.element))
    return variant.element == place


def _channel(c: Candidate) -> str:
    """Return the channel in which what an effect acts on has readings; a joint and a fingertip may share a name."""
    return "joint_position" if effect(c.name).acts_on in ("joint", "link") else "fingertip_force"


def _own_columns(problem: Problem, channel: str, elements: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return `(K,)` which block means are readings of some elements in a channel."""
    family = _family(channel)
    mine = np.array([_family(c) == family and _owner(c, label) in elements for c, label, _ in problem.plan.columns])
    return np.tile(mine, problem.plan.phase.shape[1])


def _family(channel: str) -> str:
    """Return what a channel is read from: all that joints read is one family."""
    return "joint" if channel.startswith("joint_") else channel


def _owner(channel: str, label: str) -> str:
    """Return the joint or fingertip that a column belongs to; a force's label ends with its axis."""
    return label.rsplit(" ", 1)[0] if channel == "fingertip_force" else label
