"""Does the proposed motion resolve a tie? Tied pairs of effects, recorded with motions that hardly tell them apart.

For each pair, one effect is the hidden truth. It is recorded in the built-in scene with a motion in which the other one
looks nearly alike; the other is fitted to that. The motion is designed from the two fits alone, played in the true
world, and the wrong effect is fitted again to what was recorded. The same with a motion drawn from the scene's usual
ones. Printed for each: the cosine of the two signatures, and how much better the truth is than the refitted rival
(paired loss difference over its standard error). Target: the designed motion is clear (more than 2 SE), and clearer
than the random one.

    python benchmarks/next_motion.py --episodes 8 --only damping,lengths
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import NamedTuple

import numpy as np

from candata.gap.candidates import Candidate, candidate
from candata.gap.floor import floor
from candata.gap.next_motion import all_motions, rivals_of, separating_motion
from candata.gap.recordings import recordings
from candata.gap.replay import EffectSet, Replayer, replay_all
from candata.gap.residuals import layout, residual
from candata.gap.score import score
from candata.gap.search import Problem
from candata.gap.starts import starts
from candata.policies import Motion
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.episodes import Job, make_episodes

SCENE, DURATION_S, CLEAR_SE = "xhand_tabletop", 3.2, 2.0


class Tie(NamedTuple):
    """A hidden truth, its rival, and the motion that hardly tells them apart."""

    truth: EffectSetting
    rival: str
    recorded: str


TIES = {
    "damping": Tie(EffectSetting(name="servo_damping", parameters={"kv_scale": 1.8}), "joint_damping", "free_sweep"),
    "lengths": Tie(EffectSetting(name="pose_scale", parameters={"scale": 0.96}), "pose_bias", "squeeze"),
    "height": Tie(EffectSetting(name="support_height", parameters={"height_m": 0.004}), "pose_bias", "squeeze"),
    "friction": Tie(
        EffectSetting(name="joint_damping", parameters={"damping_Nms_rad": 0.05}),
        "joint_dry_friction",
        "slow reversals in the air",
    ),
    "lag": Tie(EffectSetting(name="tactile_lag", parameters={"timeconst_s": 0.03}), "actuation_delay", "squeeze"),
    "backlash": Tie(
        EffectSetting(name="backlash", parameters={"gap_rad": 0.03}), "actuation_delay", "slow reversals in the air"
    ),
}


def record(scene: Scene, motion: Motion, world: EffectSet, count: int, seed: int) -> Problem:
    """Return the search problem of `count` noisy episodes of a motion in a world."""
    rng = np.random.default_rng(seed)
    jobs = [Job(f"e{i}", i, motion.name, seed, world, hidden=True, motion=motion) for i in range(count)]
    replayer = Replayer(scene)
    recs = recordings(scene, make_episodes(scene, jobs, duration_s=DURATION_S, noise=scene.file.noise))
    begin = starts(scene, recs)
    nominal = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(scene, recs, begin, nominal)
    spread = floor(replayer, recs, begin, plan, rng, 8, world)
    level = score(residual(recs, plan, nominal), spread, plan)
    return Problem(replayer, recs, begin, plan, level, [], spread.noise, spread.kind, rng)


def fitted(problem: Problem, c: Candidate) -> np.ndarray:
    """Return the coordinates with the least mean loss: each in turn on a grid, then on a finer one."""
    u = c.neutral.copy()
    for i in range(c.size):
        low, high = c.low[i], c.high[i]
        for _ in range(3):
            points = np.repeat(u[None], 7, axis=0)
            points[:, i] = np.linspace(low, high, 7)
            losses = [
                problem.score.loss(z).mean() for z in problem.residuals([problem.setting([(c, p)]) for p in points])
            ]
            u = points[int(np.argmin(losses))]
            step = (high - low) / 6
            low, high = max(c.low[i], u[i] - step), min(c.high[i], u[i] + step)
    return u


def told_apart(problem: Problem, truth: EffectSet, c: Candidate) -> tuple[float, float, EffectSet]:
    """Return the cosine of the signatures, the loss difference in SE, and the rival's best fit."""
    rival = problem.setting([(c, fitted(problem, c))])
    none, right, wrong = problem.residuals([(), truth, rival])
    a, b = ((z - none).ravel().astype(float) for z in (right, wrong))
    cosine = float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))
    worse = problem.score.loss(wrong) - problem.score.loss(right)
    return cosine, float(worse.mean() / (worse.std(ddof=1) / np.sqrt(len(worse)))), rival


def resolve(scene: Scene, tie: Tie, count: int, seed: int) -> list[tuple[str, str, float, float]]:
    """Return (which, motion, cosine, SE) of what was recorded, of a random motion and of the designed one."""
    truth, c = (tie.truth,), candidate(tie.rival, scene)
    rng = np.random.default_rng(seed)
    known = {m.name: m for m in all_motions(scene, DURATION_S, seed)}
    first = record(scene, known[tie.recorded], truth, count, seed)
    cosine, sure, rival = told_apart(first, truth, c)
    rows = [("recorded", tie.recorded, cosine, sure)]
    # Forces that the usual motions need are allowed, also where the recording touched nothing.
    rivals = dataclasses.replace(rivals_of(first, [truth, rival]), force_limit_n=None)
    choice = separating_motion(rivals, DURATION_S, rng)
    usual = str(rng.choice([p for p in scene.policies if p != tie.recorded]))
    for which, motion in (("random", known[usual]), ("designed", choice.motion if choice else None)):
        if motion is not None:
            cosine, sure, _ = told_apart(record(scene, motion, truth, count, seed + 1), truth, c)
            rows.append((which, motion.name, cosine, sure))
    return rows


def main() -> None:
    """Run the ties and print each beside its target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help=f"some of {', '.join(TIES)}, comma separated")
    args = parser.parse_args()
    scene = load_scene(SCENE)
    clear = better = 0
    names = args.only.split(",") if args.only else list(TIES)
    print(f"{'tie':9} {'':9} {'motion':42} cosine  truth better by")
    for name in names:
        start = time.process_time()
        rows = resolve(scene, TIES[name], args.episodes, args.seed)
        for which, motion, cosine, sure in rows:
            print(f"{name:9} {which:9} {motion:42} {cosine:6.3f} {sure:8.1f} SE", flush=True)
        found = {which: sure for which, _, _, sure in rows}
        clear += found.get("designed", -np.inf) > CLEAR_SE
        better += found.get("designed", -np.inf) > found["random"]
        print(f"{name:9} {time.process_time() - start:.0f} CPU s", flush=True)
    print(f"designed motion clear (> {CLEAR_SE:g} SE): {clear}/{len(names)}   target {len(names)}/{len(names)}")
    print(f"clearer than a random usual motion: {better}/{len(names)}   target {len(names)}/{len(names)}")


if __name__ == "__main__":
    main()
