"""The joint fit: every quantity that the recordings move, fitted at once, whatever a name of its own would be worth.

A datasheet is wrong in many quantities at once, and a search that adds one effect after another stops where no single
one helps. Bounded nonlinear least squares begins at several places instead. A replay forgets its errors within
1 / (gain x rate), half a second at 100 Hz, as the observer pulls it to its recording: like the restarts of multiple
shooting (Bock & Plitt 1984), this keeps an error of phase from locking the fit. Held-out episodes decide which
quantities stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import qmc

from candata.gap.candidates import Candidate, typical_size
from candata.gap.compare import standard_error
from candata.gap.folds import CrossFit, rest
from candata.gap.refine import divided
from candata.gap.response import Plane
from candata.gap.robust import NU, weights
from candata.gap.score import Compact
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.sparse import present
from candata.statistics import MAD_TO_SD

Array = NDArray[np.float64]
#: Most numbers that are fitted at once. Chosen: each costs a replay for every slope.
MOST_NUMBERS = 16
#: Share of the allowed replays that may be spent on the first fits, and on where they begin. Chosen.
FIRST_FITS, BEGINNING = 0.4, 0.1
#: Most places at which the fit may begin beside what was named, how far they lie from the neutral values in plausible
#: sizes, and from how many of them it begins. Chosen.
PLACES, REACH, BEGUN = 48, 1.5, 3
#: Shares of a plausible size over which slopes are differenced, rough and sharp. Chosen: the wider, the less is seen of
#: single contacts and of friction that holds or lets go.
ROUGH, SHARP = 0.1, 0.01
#: Most evaluations of a fit from each place, and of each later one. Chosen.
FIRST_STEPS, STEPS = 5, 10
#: Distance from a bound, in plausible sizes, at which a fit may begin, and the relative step at which it ends. Chosen.
EDGE, CLOSE = 1e-6, 1e-4
#: Share of the mean residual that another fit must take off for one more to follow. Chosen.
HELPS = 0.05
#: Standard errors over held-out episodes by which a quantity must gain to stay. Source: one-sided 95 % of a normal.
SURE = 1.64
#: Share of the whole gain that a quantity must be worth to stay. Chosen: a thousandth is no repair.
WORTH = 0.001


@dataclass(frozen=True)
class JointFit:
    """A joint fit.

    Attributes
    ----------
    fit : Fit
        Members, the plane around them, and losses of held-out episodes.
    combinations : int
        How many combinations of the numbers are known to less than a plausible size: singular values of the slopes, in
        units of noise and of plausible sizes, above one.
    """

    fit: Fit
    combinations: int


class _AllowanceSpent(Exception):
    """The allowed replays are spent."""


@dataclass
class _Allowance:
    """Replays of all episodes that are still to be had, and how many of them are reserved for a later step."""

    replays: float
    reserved: float = 0.0

    def spend(self, replays: float) -> None:
        """Take replays off.

        Raises
        ------
        _AllowanceSpent
            When fewer are left that are not reserved.
        """
        if replays > self.replays - self.reserved:
            raise _AllowanceSpent
        self.replays -= replays


@dataclass
class _Joint:
    """Quantities of a problem as one vector of coordinates `u (d,)`, each in units of its plausible size.

    Attributes
    ----------
    problem : Problem
    kinds : tuple of Candidate
    allowance : _Allowance
    whole : int
        Episodes of the whole problem, by which replays are counted.
    """

    problem: Problem
    kinds: tuple[Candidate, ...]
    allowance: _Allowance
    whole: int

    def __post_init__(self) -> None:
        """Set sizes and bounds of the coordinates."""
        scene = self.problem.replayer.scene
        self.size = np.concatenate([typical_size(c, scene) for c in self.kinds])
        self.neutral, low, high = (
            np.concatenate([getattr(c, side) for c in self.kinds]) for side in ("neutral", "low", "high")
        )
        self.low, self.high = low / self.size, high / self.size
        self.owners = np.repeat([c.label for c in self.kinds], [c.size for c in self.kinds])

    def members(self, u: Array) -> Members:
        """Return the members at coordinates."""
        pairs = tuple((c, c.neutral) for c in self.kinds)
        return divided(pairs, np.clip(u * self.size, self.low * self.size, self.high * self.size))

    def residuals(self, places: Sequence[Array]) -> list[Compact]:
        """Return normalised residuals `(E, K)` at each place, all simulated together."""
        self.allowance.spend(len(places) * len(self.problem.recs) / self.whole)
        return self.problem.residuals([self.problem.setting(present(self.members(u))) for u in places])

    def slopes(self, u: Array, z: Compact, width: float) -> Compact:
        """Return `(d, E, K)` how residuals change with each coordinate, by differences towards the wider side."""
        steps = np.where(self.high - u >= np.minimum(width, u - self.low), width, -width)
        moved = self.residuals([u + step * unit for step, unit in zip(steps, np.eye(len(u)), strict=True)])
        return np.stack([(there - z) / np.float32(step) for there, step in zip(moved, steps, strict=True)])

    def solved(self, begin: Array, scale: float, width: float, steps: int) -> Array:
        """Return the coordinates of the least robust sum of squares near `begin`; the best seen where replays end.

        A plausible size off the neutral value costs as much as one residual of the size `scale` (maximum a posteriori):
        what the data do not tell stays as the scene says.
        """
        seen: dict[bytes, Compact] = {}
        least, neutral = (np.inf, begin), self.neutral / self.size

        def value(u: Array) -> Array:
            nonlocal least
            (z,) = self.residuals([u])
            seen[u.tobytes()] = z
            rows = np.concatenate([z.ravel().astype(float), scale * (u - neutral)])
            cost = float(_student((rows / scale) ** 2)[0].sum())
            least = min(least, (cost, u.copy()), key=lambda pair: pair[0])
            return rows

        def jacobian(u: Array) -> Array:
            slope = self.slopes(u, seen[u.tobytes()], width).reshape(len(u), -1).T
            return np.concatenate([slope.astype(float), scale * np.eye(len(u))])

        inside = np.clip(begin, self.low + EDGE, self.high - EDGE)
        bounds = (self.low, self.high)
        with suppress(_AllowanceSpent):
            least_squares(value, inside, jacobian, bounds, loss=_student, f_scale=scale, max_nfev=steps, xtol=CLOSE)
        return least[1]


def _student(square: Array) -> Array:
    """Return the Student-t loss of squared residuals and its first two derivatives `(3, n)`, as SciPy asks for."""
    whole = NU + square
    return np.stack([(NU + 1) * np.log1p(square / NU), (NU + 1) / whole, -(NU + 1) / whole**2])


def joint_fit(problem: Problem, kinds: Sequence[Candidate], named: Members, replays: float) -> JointFit | None:
    """Return the joint fit of all quantities that gain on held-out episodes; None where none does.

    Parameters
    ----------
    problem : Problem
    kinds : sequence of Candidate
        Quantities that may be wrong, the likeliest first; choices do not count.
    named : Members
        What a search found: one of the places at which the fit begins.
    replays : float
        Replays of all episodes to spend at most; None is returned where they end before a fit was judged.
    """
    chosen = tuple(c for c, _ in named if not c.choices)
    kinds = _first_numbers((*chosen, *(c for c in kinds if c.label not in {n.label for n in chosen})))
    if not kinds:
        return None
    allowance = _Allowance(replays, (1 - FIRST_FITS) * replays)
    everything = _Joint(problem, kinds, allowance, len(problem.recs))
    few = replace(everything, problem=brief(problem)[0])
    try:
        places = min(PLACES, int(BEGINNING * replays * len(problem.recs) / len(few.problem.recs)))
        begins = _begins(few, named, places, problem.rng.spawn(1)[0])
        ends = [few.solved(u, _scale(z), ROUGH, FIRST_STEPS) for u, z in begins]
        allowance.reserved = 0.0
        spreads = [_spread(z) for z in everything.residuals(ends)]
        at, z = _settled(everything, ends[int(np.argmin(spreads))], ROUGH)
        return _thinned(everything, at, z)
    except _AllowanceSpent:
        return None


def _first_numbers(kinds: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return the first quantities, of at most `MOST_NUMBERS` numbers together."""
    kept: list[Candidate] = []
    for c in kinds:
        if not c.choices and sum(k.size for k in kept) + c.size <= MOST_NUMBERS:
            kept.append(c)
    return tuple(kept)


def _scale(z: Compact) -> float:
    """Return the robust spread of residuals, at least that of noise: what counts as an outlier depends on it."""
    return max(1.0, MAD_TO_SD * float(np.median(np.abs(z[z != 0])))) if (z != 0).any() else 1.0


def _spread(z: Compact) -> float:
    """Return the mean size of residuals."""
    return float(np.abs(z).mean())


def _begins(few: _Joint, named: Members, count: int, rng: np.random.Generator) -> list[tuple[Array, Compact]]:
    """Return the places from which to fit and their residuals: the best of a Latin hypercube, and the known ones."""
    neutral = few.neutral / few.size
    at = dict((c.label, u) for c, u in named)
    known = np.concatenate([at.get(c.label, c.neutral) for c in few.kinds]) / few.size
    cube = qmc.LatinHypercube(len(neutral), rng=rng).random(count)
    low, high = np.maximum(neutral - REACH, few.low), np.minimum(neutral + REACH, few.high)
    places = [known, *(low + cube * (high - low))]
    zs = few.residuals(places)
    order = sorted(range(len(places)), key=lambda i: _spread(zs[i]))[:BEGUN]
    return [(places[i], zs[i]) for i in dict.fromkeys([*order, 0])]


def _settled(joint: _Joint, at: Array, width: float) -> tuple[Array, Compact]:
    """Return the coordinates fitted again while that helps, and the residuals `(E, K)` there.

    What is needed to judge a fit is left of the allowance.
    """
    allowance, cost = joint.allowance, 2.0 * (len(at) + len(joint.kinds) + 2)
    (z,) = joint.residuals([at])
    while allowance.replays > cost + 1:
        allowance.reserved = cost
        moved = joint.solved(at, _scale(z), width, STEPS)
        allowance.reserved = 0.0
        (there,) = joint.residuals([moved])
        before, after = _spread(z), _spread(there)
        if after < before:
            at, z = moved, there
        if after > (1 - HELPS) * before:
            break
    return at, z


def _thinned(joint: _Joint, at: Array, z: Compact) -> JointFit | None:
    """Return the fit without the quantities that do not gain on held-out episodes, the others fitted again."""
    while True:
        scale = _scale(z)
        slope = joint.slopes(at, z, SHARP)
        unseen, points = _held_out(joint, at, z, slope, scale)
        losses = joint.problem.score.loss(unseen / np.float32(scale))
        base = joint.problem.score.loss(joint.problem.nominal / np.float32(scale))
        idle = _idle(joint, at, z, slope, scale, losses, float((base - losses).mean()))
        if not idle.any():
            at, z = _last_step(joint, at, z, slope, scale)
            return _concluded(joint, at, z, slope, unseen, points)
        if idle.all():
            return None
        at = _refitted(joint, at, z, slope, scale, np.arange(len(z)), idle)[~idle]
        owners = joint.owners
        joint = replace(joint, kinds=tuple(c for c in joint.kinds if c.label in set(owners[~idle])))
        at, z = _settled(joint, at, SHARP)


def _last_step(joint: _Joint, at: Array, z: Compact, slope: Compact, scale: float) -> tuple[Array, Compact]:
    """Return where slopes lead once more, and the residuals `(E, K)` there; the same place where that is no better."""
    if joint.allowance.replays < 1:
        return at, z
    moved = _refitted(joint, at, z, slope, scale, np.arange(len(z)), None)
    (there,) = joint.residuals([moved])
    return (moved, there) if _spread(there) < _spread(z) else (at, z)


def _idle(
    joint: _Joint, at: Array, z: Compact, slope: Compact, scale: float, losses: Array, gain: float
) -> NDArray[np.bool_]:
    """Return `(d,)` the numbers of quantities without which, the others following, held-out episodes lose nothing sure.

    Those that move least are tried first; each stands at its neutral value from then on.
    """
    idle = np.zeros(len(at), bool)
    moved = np.abs((at - joint.neutral / joint.size)[:, None, None] * slope).mean((1, 2))
    for c in sorted(joint.kinds, key=lambda c: float(moved[joint.owners == c.label].sum())):
        trial = idle | (joint.owners == c.label)
        unseen = _held_out(joint, at, z, slope, scale, trial)[0]
        rise = joint.problem.score.loss(unseen / np.float32(scale)) - losses
        if rise.mean() <= max(WORTH * gain, SURE * standard_error(rise)):
            idle = trial
    return idle


def _held_out(
    joint: _Joint, at: Array, z: Compact, slope: Compact, scale: float, fixed: NDArray[np.bool_] | None = None
) -> tuple[Compact, Array]:
    """Return residuals `(E, K)` of held-out episodes, simulated, and the coordinates `(FOLDS, d)` without each fold.

    Coordinates that are `fixed` stand at their neutral values.
    """
    problem, parts = joint.problem, joint.problem.parts
    points = np.stack([_refitted(joint, at, z, slope, scale, rest(parts, f), fixed) for f in range(len(parts))])
    joint.allowance.spend(1.0)
    unseen = np.zeros_like(z)
    for test, u in zip(parts, points, strict=True):
        part = _taken(problem, test)
        (unseen[test],) = part.residuals([part.setting(present(joint.members(u)))])
    return unseen, points


def _taken(problem: Problem, index: NDArray[np.int64]) -> Problem:
    """Return the problem of some episodes, as far as replays need it."""
    return replace(
        problem,
        recs=problem.recs.take(index),
        begin=problem.begin.take(index),
        plan=problem.plan.take(index),
        score=problem.score.take(index),
    )


def _refitted(
    joint: _Joint,
    at: Array,
    z: Compact,
    slope: Compact,
    scale: float,
    train: NDArray[np.int64],
    fixed: NDArray[np.bool_] | None,
) -> Array:
    """Return the coordinates `(d,)` that fit some episodes best by the slopes around `at`, within bounds."""
    neutral = joint.neutral / joint.size
    fixed = np.zeros(len(at), bool) if fixed is None else fixed
    u = np.where(fixed, neutral, at)
    if fixed.all():
        return u
    here = z[train] + np.tensordot((u - at).astype(np.float32), slope[:, train], 1)
    weight = np.sqrt(weights(here / np.float32(scale))).ravel().astype(float)
    matrix = (slope[~fixed][:, train].reshape(int((~fixed).sum()), -1) * weight).T
    matrix = np.concatenate([matrix, scale * np.eye(matrix.shape[1])])
    target = np.concatenate([-here.ravel() * weight, scale * (neutral - u)[~fixed]])
    room = (joint.low - u - EDGE)[~fixed], (joint.high - u + EDGE)[~fixed]
    u[~fixed] += lsq_linear(matrix, target, room).x
    return np.clip(u, joint.low, joint.high)


def _concluded(joint: _Joint, at: Array, z: Compact, slope: Compact, unseen: Compact, points: Array) -> JointFit:
    """Return a joint fit with its evidence, in the coordinates of its candidates."""
    problem, size = joint.problem, joint.size
    base, loss = problem.score.loss(problem.nominal), problem.score.loss(unseen)
    per_coordinate = (slope / size[:, None, None]).astype(np.float32)
    plane = Plane(joint.low * size, joint.high * size, at * size, z, per_coordinate)
    fit = Fit(joint.members(at), plane, CrossFit(base - loss, loss, points * size))
    weighted = slope.reshape(len(at), -1) * np.sqrt(weights(z / np.float32(_scale(z)))).ravel()
    values = np.linalg.svd(weighted.astype(float), compute_uv=False)
    return JointFit(fit, int((values > _scale(z)).sum()))
