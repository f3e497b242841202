"""Training and sampling speed of the models, side by side in one run of under three minutes.

    OMP_NUM_THREADS=1 python benchmarks/training_speed.py

Training: whole steps of the loop (losses, gradient, clipping, optimiser, average of the weights) at batch 64 on made-up
windows, by model and preset: windows per second of CPU time, and the step's floating point operations (three times
those that torch.utils.flop_counter counts in the losses) over those of a large matrix product. Sampling: forecasts by
100, 10 and 4 steps. Waiting: drawing batches of a simulated dataset, beside the steps that they feed. All take turns,
and each figure is the least CPU time of its turns: on a shared machine the others measure the neighbours. Compare the
shares of the matrix product, not the windows, between machines.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from candata.loaders import windows
from candata.models import Sizes, model, model_names
from candata.testing.models import made_up_batch, made_up_normaliser
from candata.training.feed import drawing
from candata.training.loop import TrainingJob, train
from candata.training.memory import keep_freed_memory
from candata.training.settings import Run, TrainingSettings

SIZES = Sizes(history=8, horizon=16, joints=15, actuators=15, fingertips=5, points=512)
BATCH = 64
#: Side of the matrix product that stands for the machine's peak.
PEAK_SIDE = 1024
#: Operations of losses and gradient over those of the losses: each product has two in the gradient.
STEP_OVER_LOSSES = 3
#: Windows and samples of a forecast; what is to be reached.
FORECAST_WINDOWS, SAMPLES = 4, 4
WINDOWS_TARGET, SAMPLING_TARGET, WAIT_TARGET = 1_000, 22, 0.01
#: Models without a simulator; another one needs a scene.
NAMES = [name for name in model_names() if name != "sim_residual"]


def build(name: str, preset: str) -> Any:
    """Return the model for the benchmark's sizes."""
    kind = model(name)
    return kind.build(kind.presets[preset], SIZES, made_up_normaliser(SIZES))


def cpu_s(act: Callable[[], object]) -> float:
    """Return the CPU time of an action [s]."""
    began = time.process_time()
    act()
    return time.process_time() - began


def best_of_turns(actions: dict[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Return the least CPU time of each action [s]; they take turns."""
    times = [{name: cpu_s(act) for name, act in actions.items()} for _ in range(turns)]
    return {name: min(turn[name] for turn in times) for name in actions}


def matrix_product() -> Callable[[], object]:
    """Return what stands for the machine's peak."""
    a, b = torch.randn(2, PEAK_SIDE, PEAK_SIDE).unbind(0)
    return lambda: a @ b


def steps_of(net: Any, folder: Path, draw: Callable[[int], Any]) -> Callable[[int], float]:
    """Return what trains a fresh run for so many steps, and gives the CPU time of one [s]."""

    def run(steps: int) -> float:
        marks: list[float] = []

        def should_stop() -> bool:
            marks.append(time.process_time())
            return len(marks) > steps

        settings = TrainingSettings(steps=10**6, batch=BATCH, log_every=10**6, validate_every=10**6, save_every_s=1e9)
        facts = {"config": {}, "sizes": {}, "digest": "", "version": 0, "split": "", "split_digest": "", "rate_hz": 10}
        card = Run(
            model="m", dataset="d", channels=(), units={}, normaliser={}, settings=settings, revision="", **facts
        )
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            train(TrainingJob(card, net, draw), Path(scratch) / "run", should_stop=should_stop)
        return min(after - before for before, after in pairwise(marks[1:]))

    return run


def training(folder: Path, presets: list[str], turns: int) -> None:
    """Print windows per CPU second and the share of the peak, by model and preset."""
    batch, product = made_up_batch(BATCH, sizes=SIZES, clouds=1), matrix_product()
    rows = [(name, preset, build(name, preset)) for preset in presets for name in NAMES]
    runs = {row[:2]: steps_of(row[2], folder, lambda _step: batch) for row in rows}
    operations = {}
    for name, preset, net in rows:
        with FlopCounterMode(display=False) as counter:
            net.losses(batch, torch.Generator().manual_seed(0))
        operations[name, preset] = STEP_OVER_LOSSES * counter.get_total_flops()
    least: dict[Any, float] = dict.fromkeys(runs, float("inf"))
    peak_s = float("inf")
    for _ in range(turns):
        for key, run in runs.items():
            least[key] = min(least[key], run(3 if key[1] == "base" else 8))
            peak_s = min(peak_s, cpu_s(product))
    peak = 2 * PEAK_SIDE**3 / peak_s
    print(f"training, batch {BATCH}, one thread; matrix product of side {PEAK_SIDE}: {peak / 1e9:.0f} GFLOP/s")
    for (name, preset), step_s in least.items():
        share = operations[name, preset] / step_s / peak
        target = f", target >= {WINDOWS_TARGET:,}" if (name, preset) == ("contact_diffusion", "small") else ""
        rate = f"{BATCH / step_s:>9,.0f} windows/CPU-s{target}"
        print(f"  {name:<20}{preset:<7}{1e3 * step_s:>8.1f} ms a step, {100 * share:>3.0f} % of the product, {rate}")


def sampling(presets: list[str], turns: int) -> None:
    """Print how much faster forecasts by few steps are than by a hundred."""
    batch, noise = made_up_batch(FORECAST_WINDOWS, sizes=SIZES, clouds=1), torch.Generator().manual_seed(0)
    print(f"sampling, {FORECAST_WINDOWS} windows x {SAMPLES} samples")
    for preset in presets:
        net = build("contact_diffusion", preset)
        actions = {str(n): lambda n=n, net=net: net.forecast(batch, SAMPLES, n, noise) for n in (100, 10, 4)}
        taken = best_of_turns(actions, turns)
        ratios = ", ".join(f"{n} steps {taken['100'] / taken[n]:.1f} times as fast as 100" for n in ("10", "4"))
        rate = FORECAST_WINDOWS / taken["10"]
        print(f"  {preset:<7}{ratios} (target for 4: >= {SAMPLING_TARGET}); by 10 steps {rate:,.0f} windows/CPU-s")


def waiting(folder: Path, turns: int) -> None:
    """Print the share of the training's CPU time that drawing batches takes, for the model with the quickest data."""
    words = ["--scene", "xhand_tabletop", "--episodes", "8", "--duration-s", "2.4", "--jobs", "1"]
    command = [sys.executable, "-m", "candata_cli.main", "generate-sim", *words, "--out", str(folder / "data")]
    subprocess.run(command, check=True, capture_output=True)
    feed = windows(folder / "data", pad="both", cache=folder / "cache")
    draw = drawing(feed, TrainingSettings(batch=BATCH), "cpu")
    kind = model("contact_diffusion")
    net = kind.build(kind.presets["small"], Sizes(**feed.sizes()), feed.normaliser)
    step_s = min(steps_of(net, folder, draw)(12) for _ in range(turns))
    draw_s = min(cpu_s(lambda: [draw(step) for step in range(20)]) / 20 for _ in range(turns))
    share = draw_s / step_s
    print(
        f"waiting for data, contact_diffusion small: {100 * share:.2f} % of a step, target <= {100 * WAIT_TARGET:g} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", nargs="+", default=["small", "base"], choices=["small", "base"])
    parser.add_argument("--turns", type=int, default=3, help="turns of each measurement")
    args = parser.parse_args()
    torch.set_num_threads(1)
    keep_freed_memory()
    with tempfile.TemporaryDirectory() as scratch:
        training(Path(scratch), args.presets, args.turns)
        sampling(args.presets, args.turns)
        waiting(Path(scratch), args.turns)


if __name__ == "__main__":
    main()
