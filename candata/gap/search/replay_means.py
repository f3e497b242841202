"""Effects so faint that contact's chaos hides them: found in the mean over replays that chaos deals other outcomes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import parameters_on
from candata.gap.data.recordings import Recordings
from candata.gap.fit.candidates import Candidate, candidate, elements_of, local_candidates
from candata.gap.fit.comparison import is_tied, standard_error
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import CrossFit, rest
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane, vertex
from candata.gap.fit.stage import Stage
from candata.gap.measure.floor import null_recordings, perturbed
from candata.gap.measure.score import Score
from candata.gap.replay.replayer import EffectSet, is_simulated, name_of, replay_all
from candata.gap.replay.residuals import residual
from candata.gap.replay.starts import starts
from candata.gap.run.pace import MEAN, REST
from candata.gap.screening.episodes import brief
from candata.rotation import exp, multiply
from candata.schema.scene import Noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Member = tuple[Candidate, Array]
#: Rise of the loss [floors], by its signature, below which the faintest clear fault is quiet, and how many such are
#: tried at most, the loudest first. Chosen: 15 of a gripper's are; of many fingers' joints more than could be paid for.
QUIET, MOST = 0.18, 16
#: Replays over which a first look averages, those that choose values, and with as many more those that decide.
FIRST, SOME, ALL = 2, 8, 16
#: Null recordings of each episode that tell what a discrepancy is in such a mean without any effect.
NULLS = 6
#: Mean gain [floors] from which a value is looked at over more replays, and from which others are tried around it.
#: Chosen: the mean of two differs by some 0.015 from that of many. Record 43.
WORTH, TRIED = -0.015, 0.005
#: How much nearer the three values of a second parabola lie. Chosen.
NEARER = 3.0
#: How many effects are compared at the end, and what share of the best gain so far they must have. Chosen.
COMPARED, RIVAL = 2, 0.4
#: Mean gain [floors] beyond what null recordings gain, and standard errors of it, from which an effect is named.
#: Chosen: one in 700 of normal errors, as some 16 effects are tried.
NAMED, STEADY = 0.01, 3.0


@dataclass(frozen=True)
class Averaged:
    """Losses of worlds over replays that each follow the recording with fresh noise on top of its own.

    Chaos deals each replay another outcome, so that the mean loss over them tells what is due to the world alone: of
    two worlds it differs by a third of the error of one replay each. The noise is the same for every world.
    """

    problem: Problem
    kept: dict[tuple[str, int], Array] = field(default_factory=dict)

    def losses(self, members: Sequence[Member | None], copies: int, first: int = 0) -> Array:
        """Return `(V, E)` mean losses of worlds of one effect (None: the nominal one) over replays from `first`."""
        return self._means(members, copies, first)[:, 0]

    def null_losses(self, members: Sequence[Member | None]) -> Array:
        """Return `(V, E)` mean losses of worlds of one effect over replays of null recordings of the nominal world."""
        return self._means(members, NULLS, of_nulls=True)[:, 0]

    def sizes(self, members: Sequence[Member | None], copies: int, first: int = 0) -> Array:
        """Return the same of discrepancies, in those that null recordings have in such a mean."""
        nulls = self._means([None], NULLS, of_nulls=True)[0, 1].mean()
        return self._means(members, copies, first)[:, 1] / nulls

    def _means(self, members: Sequence[Member | None], copies: int, first: int = 0, of_nulls: bool = False) -> Array:
        """Return `(V, 2, E)` mean losses and discrepancies of worlds, or those of null recordings."""
        worlds = [self.problem.setting([m] if m else []) for m in members]
        numbers = [-1 - k if of_nulls else k for k in range(first, copies)]
        for k in numbers:
            missing = {name_of(w): w for w in worlds if (name_of(w), k) not in self.kept}
            if missing:
                found = self._played(k, list(missing.values()))
                self.kept.update(((name, k), read) for name, read in zip(missing, found, strict=True))
        return np.array([np.mean([self.kept[name_of(w), k] for k in numbers], axis=0) for w in worlds])

    def _played(self, k: int, worlds: Sequence[EffectSet]) -> list[Array]:
        """Return losses and discrepancies `(2, E)` of one replay of each world; below 0, of a null recording's."""
        p, rng = self.problem, self.problem.stream("mean over replays", k)
        recs = null_recordings(p.replayer, p.recs, p.begin, p.noise, rng, 1) if k < 0 else p.recs
        begin = perturbed(
            p.replayer, starts(p.replayer.scene, recs, p.begin.moving) if k < 0 else p.begin, p.noise, rng
        )
        played = replay_all(p.replayer, _jittered(recs, p.noise, rng), begin, worlds)
        zs = [p.score.normal(residual(recs, p.plan, r)) for r in played]
        return [np.stack([p.score.loss(z), p.score.size(z)]) for z in zs]


def faint(problem: Problem, first: Stage) -> tuple[Fit, Averaged] | None:
    """Return the quiet effect that surely gains in the mean over many replays, and these; None where none does."""
    problem.pace.say("looking for what contact hides, in the mean over many replays", MEAN, after=REST.most)
    many = Averaged(problem)
    fits = _compared(many, [(c, u) for c in _quiet(problem, first) for u in _clear(problem, c)])
    return next(((f, many) for f in fits if _surpasses_nulls(many, f)), None)


def _surpasses_nulls(many: Averaged, fit: Fit) -> bool:
    """Tell whether an effect surely gains more in the mean than the same effect gains on null recordings."""
    without, beside = many.null_losses([None, fit.members[0]])
    excess = fit.evidence.gain - (without - beside)
    return bool(excess.mean() > max(NAMED, STEADY * standard_error(excess)))


def placed(problem: Problem, chosen: Fit) -> tuple[Fit | None, Averaged] | None:
    """Return a faint effect elsewhere, on an element or all, if it surely gains more there in the mean; else None.

    No fit stands for an effect that gains nothing in the mean, wherever it acts: what it gained in one replay was luck.
    """
    (c, u), scene = chosen.members[0], problem.replayer.scene
    whole = candidate(c.name, scene)
    single = _single(problem, whole)
    if not single or not _is_scalar(whole):
        return None
    problem.pace.say("asking where it acts, in the mean over many replays", MEAN, after=REST.most)
    many = Averaged(problem)
    places = (c, *(v for v in (whole, *single) if v.label != c.label))
    fits = _compared(many, [(v, at) for v in places for at in (u, *_clear(problem, v))])
    fits = [f for f in fits if _surpasses_nulls(many, f)]
    if not fits:
        return None, many
    own = next((f for f in fits if f.labels == chosen.labels), None)
    if fits[0].labels == chosen.labels or (own is not None and is_tied(own, fits[0])):
        return None
    return fits[0], many


def sizes_in_mean(many: Averaged, fit: Fit) -> tuple[Array, Array]:
    """Return `(E,)` discrepancies without and with an effect, held out, in the mean over the replays that decided."""
    members = [None, *((fit.members[0][0], u) for u in fit.evidence.points)]
    before, *others = many.sizes(members, ALL, SOME)
    return before, _pieced(others, many.problem.parts)


def _compared(many: Averaged, points: Sequence[Member]) -> list[Fit]:
    """Return the effects that gain most in the mean, at the values that gain most, the best first.

    Values are chosen by other replays than those by which effects are compared.
    """
    for copies, least, share in ((FIRST, WORTH, 0.0), (SOME, TRIED, RIVAL)):
        gains = (many.losses([None], copies) - many.losses(points, copies)).mean(1) if points else np.zeros(0)
        least = max(least, share * gains.max(initial=0.0)) if share else least
        points = [points[i] for i in np.argsort(-gains) if gains[i] > least]
    best = {c.label: (c, u) for c, u in points[::-1]}
    fits = [_fitted(many, c, u) for c, u in list(best.values())[::-1][:COMPARED]]
    return sorted(fits, key=lambda f: -f.gain)


def _is_scalar(c: Candidate) -> bool:
    """Tell whether a candidate is one number of a world that has to be simulated, and no choice."""
    return c.size == 1 and not c.choices and is_simulated(c.name)


def _single(problem: Problem, c: Candidate) -> list[Candidate]:
    """Return the variants of a candidate on one joint, fingertip or geom each."""
    scene = problem.replayer.scene
    return [v for v in local_candidates(c, scene) if len(elements_of(v, scene)) == 1]


def _quiet(problem: Problem, first: Stage) -> list[Candidate]:
    """Return the effects of which the faintest clear fault may hide in chaos, the loudest first.

    By its signature a fault of one of n elements costs an n-th of what that of all does.
    """
    score = brief(problem)[0].score if first.rough else problem.score
    found: list[tuple[float, Candidate]] = []
    for c, response in first.rough or [(f.members[0][0], f.response) for f in first.fits]:
        if c.element is None and _is_scalar(c) and isinstance(response, Curve):
            single = _single(problem, c)
            rise = min(_rise(score, response, np.array([near])) for near, _ in _sides(problem, c))
            found += [(rise, c), *((rise / len(single), v) for v in single)]
    quiet = [(rise, c) for rise, c in found if NAMED < rise < QUIET]
    return [c for _, c in sorted(quiet, key=lambda pair: -pair[0])[:MOST]]


def _rise(score: Score, response: Curve, u: Array) -> float:
    """Return by how much what a value changes raises the mean loss of null replays, in floors."""
    moved = response.read(u) - response.neutral()
    return float(np.mean([score.loss(z + moved) - score.loss(z) for z in score.null[:NULLS]]))


def _clear(problem: Problem, c: Candidate) -> list[Array]:
    """Return the coordinates `(1,)` of a clear fault, nearer to the faintest, of each side."""
    return [np.array([near + (far - near) / 3]) for near, far in _sides(problem, c)]


def _sides(problem: Problem, c: Candidate) -> Array:
    """Return the coordinates `(s, 2)` of the faintest and the strongest clear fault of each side."""
    (p,) = parameters_on(c.name, problem.replayer.scene, c.element)
    ends = np.array(p.draws(problem.replayer.scene), float)
    sides = np.log(ends) if c.logarithmic[0] else ends
    return np.array([side[np.argsort(np.abs(side - c.neutral[0]))] for side in sides])


def _fitted(many: Averaged, c: Candidate, u: Array) -> Fit:
    """Return the fit of an effect near a value that gains, each episode held out by what the others choose.

    Chosen is where the parabola through the mean losses at three values is least: first of all episodes, then of each
    fold's others, at three values nearer to that.
    """
    problem = many.problem
    step, own = float(np.abs(np.diff(_sides(problem, c))).max()) / 2, u
    train, everything = [rest(problem.parts, f) for f in range(len(problem.parts))], np.arange(len(problem.recs))
    for near in (step, step / NEARER):
        at = np.clip(own[0] + near * np.array([-1.0, 0.0, 1.0]), c.low[0], c.high[0])
        losses = many.losses([(c, at[[i]]) for i in range(3)], SOME)
        *chosen, own = (np.array([_least(at, losses[:, some].mean(1))]) for some in (*train, everything))
    base, *fresh = many.losses([None, *((c, point) for point in chosen)], ALL, SOME)
    loss = _pieced(fresh, problem.parts)
    z = problem.residuals([problem.setting([(c, own)])])[0]
    plane = Plane(c.low, c.high, own, z, np.zeros((1, *z.shape), z.dtype))
    return Fit(((c, own),), plane, CrossFit(base - loss, loss, np.array(chosen)))


def _least(at: Array, loss: Array) -> float:
    """Return where the parabola through three losses is least, or the end that is."""
    i = int(np.argmin(loss))
    return vertex(at, loss) if i == 1 else float(at[i])


def _pieced(each: Sequence[Array], parts: Sequence[Index]) -> Array:
    """Return `(E,)` what each fold's own world says of its episodes."""
    out = np.zeros(len(each[0]))
    for own, test in zip(each, parts, strict=True):
        out[test] = own[test]
    return out


def _jittered(recs: Recordings, noise: Noise, rng: np.random.Generator) -> Recordings:
    """Return recordings with fresh noise of their sensors on top of their own, where an observer follows them."""
    new = dict(recs.readings)
    if "joint_position" in new:
        joints = new["joint_position"]
        new["joint_position"] = joints + np.asarray(noise.joint_position) * rng.standard_normal(joints.shape)
    if "object_pose" in new:
        pose = new["object_pose"]
        shift, turn = (s * rng.standard_normal((*pose.shape[:2], 3)) for s in noise.object_pose)
        new["object_pose"] = np.concatenate([pose[..., :3] + shift, multiply(exp(turn), pose[..., 3:])], axis=-1)
    return replace(recs, readings=new)
