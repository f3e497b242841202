"""Does the proposed motion resolve a tie? Tied pairs of effects, recorded with motions that hardly tell them apart.

For each pair, one effect is the hidden truth. It is recorded in the built-in scene with a motion in which the other one
looks nearly alike; the other is fitted to that. The motion is designed from the two fits alone, played in the true
world, and the wrong effect is fitted again to what was recorded. The same with a motion drawn from the scene's usual
ones. Printed for each: the cosine of the two signatures, and how much better the truth is than the refitted rival
(loss difference in floors, and over its paired standard error), in both worlds: either of the two may be the truth.
Target: in the harder world the designed motion is clear (more than 2 SE), and clearer in floors than the random one.

    python benchmarks/next_motion.py --episodes 8 --only damping,lengths
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import Candidate, candidate
from candata.gap.fit.problem import Problem
from candata.gap.fit.signatures import library
from candata.gap.measure.floor import floor
from candata.gap.measure.score import score
from candata.gap.replay.replayer import EffectSet, Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.gap.run.streams import Streams
from candata.gap.verdict.next_motion import all_motions, rivals_of, separating_motion
from candata.policies import Motion
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.episodes import EpisodeJob, make_episodes

SCENE, DURATION_S, CLEAR_SE = "xhand_tabletop", 3.2, 2.0
#: Points of the first grid of a fit, and evaluations after it.
GRID, BRENT = 9, 10
#: Null replays of each episode.
NULLS = 8


class Tie(NamedTuple):
    """A hidden truth, its rival, and the motion that hardly tells them apart."""

    truth: EffectSetting
    rival: str
    recorded: str


#: Magnitudes so small, or motions so poor, that the rival fits nearly as well: `damping` and `friction` were looked at
#: before they were written down, the others were not.
TIES = {
    "damping": Tie(EffectSetting(name="servo_damping", parameters={"kv_scale": 1.8}), "joint_damping", "free_sweep"),
    "friction": Tie(
        EffectSetting(name="joint_damping", parameters={"damping_Nms_rad": 0.015}), "joint_dry_friction", "push"
    ),
    "lengths": Tie(EffectSetting(name="pose_scale", parameters={"scale": 0.98}), "pose_bias", "squeeze"),
    "height": Tie(EffectSetting(name="support_height", parameters={"height_m": 0.002}), "pose_bias", "push"),
    "lag": Tie(EffectSetting(name="tactile_lag", parameters={"timeconst_s": 0.012}), "actuation_delay", "push"),
    "backlash": Tie(EffectSetting(name="backlash", parameters={"gap_rad": 0.004}), "actuation_delay", "push"),
}


def record(scene: Scene, motion: Motion, world: EffectSet, count: int, seed: int) -> Problem:
    """Return the search problem of `count` noisy episodes of a motion in a world."""
    rng = np.random.default_rng(seed)
    jobs = [EpisodeJob(f"e{i}", i, motion.name, seed, world, hidden=True, motion=motion) for i in range(count)]
    replayer = Replayer(scene)
    recs = recordings(scene, make_episodes(scene, jobs, duration_s=DURATION_S, noise=scene.file.noise))
    begin = starts(scene, recs)
    nominal = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(scene, recs, begin, nominal)
    kind, noise, _ = sensor_noise(scene.file.noise, recs, nominal)
    spread = floor(replayer, recs, begin, plan, noise, rng, NULLS, world)
    raw = residual(recs, plan, nominal)
    level = score(raw, spread, plan)
    shelf = library(replayer, recs, begin, plan, raw, None)
    return Problem(replayer, recs, begin, plan, level, [], noise, kind, Streams(seed), shelf, nominal, raw)


def fitted(problem: Problem, c: Candidate) -> np.ndarray:
    """Return the coordinates with the least mean loss: each in turn on a grid, then by Brent's method."""
    u = c.neutral.copy()

    def losses(i: int, values: np.ndarray) -> list[float]:
        points = np.repeat(u[None], len(values), axis=0)
        points[:, i] = values
        found = problem.residuals([problem.setting([(c, p)]) for p in points])
        return [float(problem.score.loss(z).mean()) for z in found]

    for i in range(c.size):
        grid = np.linspace(c.low[i], c.high[i], GRID)
        best = int(np.argmin(losses(i, grid)))
        ends = grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)]
        found = minimize_scalar(
            lambda v, i=i: losses(i, np.array([v]))[0], bounds=ends, method="bounded", options={"maxiter": BRENT}
        )
        u[i] = found.x
    return u


class Told(NamedTuple):
    """Cosine of the signatures, and by how much the truth is better than its rival: in floors and in SE."""

    cosine: float
    floors: float
    sure: float


def told_apart(problem: Problem, truth: EffectSet, c: Candidate) -> tuple[Told, EffectSet]:
    """Return how the truth and its refitted rival differ on what was recorded, and the rival's fit."""
    rival = problem.setting([(c, fitted(problem, c))])
    none, right, wrong = problem.residuals([(), truth, rival])
    a, b = ((z - none).ravel().astype(float) for z in (right, wrong))
    cosine = float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))
    worse = problem.score.loss(wrong) - problem.score.loss(right)
    error = worse.std(ddof=1) / np.sqrt(len(worse))
    return Told(cosine, float(worse.mean()), float(worse.mean() / error)), rival


def resolve(scene: Scene, tie: Tie, count: int, seed: int, design: bool) -> list[tuple[str, str, str, Told]]:
    """Return (which, motion, truth, how told apart) of what was recorded, of a random motion and of the designed one.

    Either of the tied two may be the truth: the motion is tried in both worlds.
    """
    truth, c = (tie.truth,), candidate(tie.rival, scene)
    rng = np.random.default_rng(seed)
    known = {m.name: m for m in all_motions(scene, DURATION_S, seed)}
    first = record(scene, known[tie.recorded], truth, count, seed)
    told, rival = told_apart(first, truth, c)
    rows = [("recorded", tie.recorded, tie.truth.name, told)]
    if not design:
        return rows
    # Forces that the usual motions need are allowed, also where the recording touched nothing.
    rivals = dataclasses.replace(rivals_of(first, [truth, rival]), force_limit_n=None)
    choice = separating_motion(rivals, DURATION_S, rng)
    usual = str(rng.choice([p for p in scene.policies if p != tie.recorded]))
    worlds = ((truth, c), (rival, candidate(tie.truth.name, scene)))
    for which, motion in (("random", known[usual]), ("designed", choice.motion if choice else None)):
        for world, other in worlds if motion is not None else ():
            told, _ = told_apart(record(scene, motion, world, count, seed + 1), world, other)
            rows.append((which, motion.name, world[0].name, told))
    return rows


def least(rows: list[tuple[str, str, str, Told]], which: str) -> tuple[float, float]:
    """Return the least difference in floors and in SE over the worlds; -inf where there was no motion."""
    told = [t for w, _, _, t in rows if w == which]
    return min((t.floors for t in told), default=-np.inf), min((t.sure for t in told), default=-np.inf)


def main() -> None:
    """Run the ties and print each beside its target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recorded-only", action="store_true", help="how tied are they to begin with?")
    parser.add_argument("--only", help=f"some of {', '.join(TIES)}, comma separated")
    args = parser.parse_args()
    scene = load_scene(SCENE)
    clear = better = 0
    names = args.only.split(",") if args.only else list(TIES)
    print(f"{'tie':9} {'':9} {'motion':42} {'truth':19} cosine  truth better by")
    for name in names:
        start = time.process_time()
        rows = resolve(scene, TIES[name], args.episodes, args.seed, not args.recorded_only)
        for which, motion, world, told in rows:
            text = f"{told.cosine:6.3f} {told.floors:10.3f} floors {told.sure:8.1f} SE"
            print(f"{name:9} {which:9} {motion:42} {world:19} {text}", flush=True)
        clear += least(rows, "designed")[1] > CLEAR_SE
        better += least(rows, "designed")[0] > least(rows, "random")[0]
        print(f"{name:9} {time.process_time() - start:.0f} CPU s", flush=True)
    if args.recorded_only:
        return
    print(f"designed motion clear (> {CLEAR_SE:g} SE): {clear}/{len(names)}   target {len(names)}/{len(names)}")
    print(f"clearer than a random usual motion: {better}/{len(names)}   target {len(names)}/{len(names)}")


if __name__ == "__main__":
    main()
