"""How well a floor foretells recordings of the very world that it is of: the evidence that the search stands on.

    python benchmarks/null_calibration.py --worlds 24 --jobs 2 --out out/null_calibration
    python benchmarks/null_calibration.py --worlds 0 --cases out/training --out out/null_calibration   # kept nulls

Every world is a random small scene, played by plain MuJoCo, in which nothing is wrong; or a null of a folder of kept
cases. Nothing is searched: the recordings are replayed in the nominal scene, and their loss is ranked among those of
the floor's own null recordings. Printed are two ranks, which are even between 0 and 1 where the floor is right: of
each episode among the nulls of that episode, and of each world's mean loss among null sets of its episodes. The second
decides whether there is a gap at all. Targets: the mean of the episodes' ranks within 0.05 of one half, or its 90 %
interval holds one half; no distance of the worlds' ranks from even (Kolmogorov and Smirnov) beyond its 1 % limit. A
picture shows both (`--plot`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.datasets import open_dataset
from candata.gap.blind.cases import CASES, read_cases, scene_of
from candata.gap.blind.labels import LABELS, open_labels, read_labels
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.rigs.cases import make_rig_cases, seal_rig_labels
from candata.gap.preparation import posed
from candata.gap.replay.replayer import Replayer
from candata.simulate.crew import Crew, local
from candata.statistics import resamples

Array = NDArray[np.float64]
EPISODES = 12
#: Target: distance of the mean rank of episodes from one half.
OFF_HALF = 0.05
#: Limit of the largest distance from even of n ranks, times sqrt(n), at level 1 %. Source: Kolmogorov's distribution.
LIMIT_1_PERCENT = 1.628


class Ranks(NamedTuple):
    """A world: its name, the rank of each episode among its nulls, and that of the mean loss among null sets."""

    name: str
    episodes: list[float]
    mean: float


def ranked(name: str, folder: str, scene: NominalScene, seed: int) -> Ranks | None:
    """Return the ranks of one world; None where a recording is too short to be posed."""
    problem = posed(open_dataset(Path(folder)), Replayer(scene.load()), seed, None).problem
    if problem is None:
        return None
    loss, score = problem.score.loss(problem.nominal), problem.score
    # Half of a tie counts, so that a rank among few nulls is even too.
    below = (score.null_loss < loss).sum(0) + 0.5
    return Ranks(name, list(below / (len(score.null_loss) + 1)), float((score.null_means < loss.mean()).mean()))


def nulls_of(folder: Path) -> list[tuple[str, str, NominalScene]]:
    """Return the nulls of a folder of cases: name, dataset, and the scene in which each is diagnosed."""
    cases = read_cases(folder / CASES)
    labels = open_labels(cases, read_labels(folder / LABELS))
    kept = [(path, case) for path, case in cases.items() if labels[case.name].kind == "null"]
    return [(f"{folder.name} {c.name}", str(p), NominalScene(scene_of(p, c), c.noise_declared)) for p, c in kept]


def drawn(out: Path, worlds: int, seed: int, crew: Crew) -> Path:
    """Return the folder of random small scenes with nothing wrong."""
    folder = out / "worlds"
    sealed = seal_rig_labels(folder, {"null": worlds, "one": 0}, seed=seed, episodes=EPISODES, traits=("plain",))
    make_rig_cases(folder, sealed, episodes=EPISODES, crew=crew)
    return folder


def distance(ranks: Array) -> float:
    """Return the largest distance between the share of ranks below a value and the value (Kolmogorov and Smirnov)."""
    steps = np.sort(ranks)
    n = len(steps)
    return float(max((np.arange(1, n + 1) / n - steps).max(), (steps - np.arange(n) / n).max()))


def report(worlds: list[Ranks]) -> list[str]:
    """Return the printed lines."""
    means = np.array([w.mean for w in worlds])
    each = np.array([np.mean(w.episodes) for w in worlds])
    chosen = resamples(np.random.default_rng(0), len(worlds), 2000)
    low, high = np.quantile(each[chosen].mean(1), (0.05, 0.95))
    limit = LIMIT_1_PERCENT / np.sqrt(len(means))
    half, far = abs(each.mean() - 0.5), distance(means)
    return [
        f"worlds {len(worlds)}, episodes {sum(len(w.episodes) for w in worlds)}",
        f"mean rank of an episode {each.mean():.3f} (90 %: {low:.3f} to {high:.3f}), target 0.5 +- {OFF_HALF}: "
        f"{'met' if half <= OFF_HALF or low <= 0.5 <= high else 'MISSED'}",
        f"ranks of worlds: distance from even {far:.3f}, limit at 1 % {limit:.3f}: "
        f"{'met' if far <= limit else 'MISSED'}",
        f"worlds above the 95th percentile of null sets {100 * (means > 0.95).mean():.0f} % (5 % expected), "
        f"above the 99.8th, from which there is a gap: {int((means > 0.998).sum())}",
    ]


def draw(worlds: list[Ranks], path: Path) -> None:
    """Write the picture: both ranks against the share of them below, with the band that chance allows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    groups = {
        "episodes among nulls of the same episode": np.concatenate([w.episodes for w in worlds]),
        "worlds: mean loss among null sets": np.array([w.mean for w in worlds]),
    }
    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3.8), sharey=True, constrained_layout=True)
    for axis, (title, ranks) in zip(axes, groups.items(), strict=True):
        grid, n = np.linspace(0, 1, 101), len(ranks)
        band = LIMIT_1_PERCENT / np.sqrt(n)
        axis.fill_between(grid, grid - band, grid + band, color="0.88", label="chance, 99 %")
        axis.plot(grid, grid, color="0.5", linewidth=1)
        axis.step(np.sort(ranks), np.arange(1, n + 1) / n, where="post", color="C0", label=f"{n} measured")
        axis.set(title=title, xlabel="rank of the loss", xlim=(0, 1), ylim=(0, 1))
        axis.legend(loc="upper left", frameon=False)
    axes[0].set_ylabel("share of ranks below")
    figure.savefig(path, dpi=110)


def run(out: Path, worlds: int, cases: list[Path], seed: int, jobs: int, plot: Path | None) -> None:
    crew = local(jobs)
    folders = [*([drawn(out, worlds, seed, crew)] if worlds else []), *cases]
    tasks = [(*null, seed) for folder in folders for null in nulls_of(folder)]
    found: list[Ranks] = []
    for done, ranks in enumerate(crew(ranked, tasks), 1):
        found += [ranks] if ranks is not None else []
        print(f"  {done} of {len(tasks)} worlds", flush=True)
    for line in report(found):
        print(line)
    out.mkdir(parents=True, exist_ok=True)
    (out / "null_calibration.json").write_text(json.dumps([one._asdict() for one in found], indent=1) + "\n")
    if plot:
        draw(found, plot)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=24, help="random small scenes (default: 24)")
    parser.add_argument("--cases", type=Path, action="append", default=[], help="folder of kept cases; their nulls")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/null_calibration"))
    parser.add_argument("--plot", type=Path, help="write the picture here")
    args = parser.parse_args()
    run(args.out, args.worlds, args.cases, args.seed, args.jobs, args.plot)
