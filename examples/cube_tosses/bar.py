"""The bar for a diagnosis of the cube tosses: what a set of effects reaches when its names are given.

    python examples/cube_tosses/bar.py --dataset out/cube_tosses --splits 5 --effects cone friction softness inertia

No search and no evidence: the names are given, the values are fitted by Nelder and Mead on 64 tosses, and counted on
the others, with the study's error (see compare.py). `lengths` is not fitted but read off free fall and rest height.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from compare import PUBLISHED, SCENE, TARGET, WIDTH_M
from scipy.optimize import minimize

from candata.datasets import open_dataset
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.fit.length_scale import length_scale
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.starts import Starts, starts
from candata.gap.run.streams import Streams
from candata.rotation import difference
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting

#: Short name to effect, parameter, where the fit starts, and the first step; numbers are fitted as logarithms.
FITTED = {
    "friction": ("sliding_friction", "scale", 1.0, 0.03),
    "softness": ("contact_compliance", "timeconst_s", 0.01, -0.5),
    "bounce": ("contact_damping", "dampratio", 1.0, 0.3),
    "rolling": ("rolling_friction", "rolling_m", 0.002, 0.5),
    "size": ("object_size", "scale", 1.0, -0.01),
    "inertia": ("object_inertia", "inertia_scale", 1.0, 0.15),
}
CONE = EffectSetting(name="friction_cone", parameters={"cone": "elliptic"})
SEARCHED, EVALUATIONS = 64, 30


def errors(replayer: Replayer, recs: Recordings, begin: Starts, world: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Return position error [% of width] and rotation error [deg] of each toss."""
    found = replay_all(replayer, recs, begin, [world])[0]["object_pose"]
    seen = recs.readings["object_pose"]
    shift = np.linalg.norm(seen[..., :3] - found[..., :3], axis=-1)
    turn = np.linalg.norm(difference(seen[..., 3:], found[..., 3:]), axis=-1)
    return 100 / WIDTH_M * np.nanmean(shift, axis=1), np.degrees(np.nanmean(turn, axis=1))


def world_of(names: Sequence[str], logs: Sequence[float], fixed: tuple) -> tuple:
    """Return the effect settings at fitted logarithms."""
    rows = zip((FITTED[n] for n in names), logs, strict=True)
    fitted = (EffectSetting(name=r[0], parameters={r[1]: float(np.exp(x))}) for r, x in rows)
    return tuple(sorted((*fixed, *fitted), key=lambda s: s.name))


def fit(replayer: Replayer, recs: Recordings, begin: Starts, names: Sequence[str], fixed: tuple) -> tuple:
    """Return the world of least error on some tosses, both errors in units of their targets."""

    def loss(logs: np.ndarray) -> float:
        position, rotation = errors(replayer, recs, begin, world_of(names, logs, fixed))
        return float(position.mean() / TARGET[0] + rotation.mean() / TARGET[1])

    if not names:
        return fixed
    start = np.log([FITTED[n][2] for n in names])
    simplex = start + np.concatenate([np.zeros((1, len(names))), np.diag([FITTED[n][3] for n in names])])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS}
    return world_of(names, minimize(loss, start, method="Nelder-Mead", options=options).x, fixed)


def main() -> None:
    """Fit and print each split, then their mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--splits", type=int, default=5)
    known = ("cone", "lengths", *FITTED)
    parser.add_argument("--effects", nargs="+", choices=known, default=("cone", "friction", "softness", "inertia"))
    given = parser.parse_args()
    scene = load_scene(SCENE)
    recs = recordings(scene, open_dataset(given.dataset).episodes())
    begin, replayer = starts(scene, recs), Replayer(scene)
    names = [n for n in given.effects if n in FITTED]
    rows = []
    for seed in range(given.splits):
        order = np.random.default_rng(seed).permutation(len(recs))
        train, test = order[:SEARCHED], order[SEARCHED:]
        fixed = (CONE,) if "cone" in given.effects else ()
        if "lengths" in given.effects:
            found = length_scale(scene, recs.take(train), begin.take(train), Streams(seed)).scale
            value = found.value if found else 1.0
            fixed += (EffectSetting(name="pose_scale", parameters={"scale": value}),)
        world = fit(replayer, recs.take(train), begin.take(train), names, fixed)
        position, rotation = errors(replayer, recs.take(test), begin.take(test), world)
        rows.append((position.mean(), position.std(), rotation.mean(), rotation.std()))
        print(f"split {seed}: " + "; ".join(f"{s.name} {said(s)}" for s in world), flush=True)
    print(f"\n{'':24}{'position, % of width':>22}{'rotation, deg':>18}")
    each = [(f"split {seed}", r) for seed, r in enumerate(rows)]
    for name, (p, p_sd, r, r_sd) in (*each, ("mean of splits", np.mean(rows, axis=0)), *PUBLISHED):
        print(f"{name:24}{p:>14.1f} +- {p_sd:4.1f}{r:>10.1f} +- {r_sd:4.1f}")
    print(f"{'target':24}{TARGET[0]:>14.1f}{'':8}{TARGET[1]:>10.1f}")


def said(setting: EffectSetting) -> str:
    """Return the values of a setting."""
    return ", ".join(v if isinstance(v, str) else f"{v:.4g}" for v in setting.parameters.values())


if __name__ == "__main__":
    main()
