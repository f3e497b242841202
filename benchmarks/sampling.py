"""Sampling and training speed of the diffusion models, as ratios measured side by side in one run.

    OMP_NUM_THREADS=1 python benchmarks/sampling.py --preset base --batch 32

Sampling: forecasts by 100, 10 and 4 steps, in turn. Training: the floating point operations of one step, as
torch.utils.flop_counter counts them in forward and backward, over the time of the whole step (forward, backward,
gradient clipping, fused AdamW), against a large matrix product on the same threads. Windows are made up. Each figure is
the best of its repeats: on a shared machine the others measure the neighbours.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import torch
from torch.utils.flop_counter import FlopCounterMode

from candata.models import Sizes, model
from candata.testing.models import made_up_batch, made_up_normaliser

SIZES = Sizes(history=8, horizon=16, joints=15, actuators=15, fingertips=5, points=512)
#: Side of the matrix product that stands for the machine's peak.
PEAK_SIDE = 1024


def build(name: str, preset: str) -> torch.nn.Module:
    """Return the model for the benchmark's sizes."""
    kind = model(name)
    return kind.build(kind.presets[preset], SIZES, made_up_normaliser(SIZES))


def best(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the least time of each action [s]; they take turns, after one unmeasured turn."""
    found = dict.fromkeys(actions, float("inf"))
    for turn in range(repeats + 1):
        for name, act in actions.items():
            began = time.perf_counter()
            act()
            if turn:
                found[name] = min(found[name], time.perf_counter() - began)
    return found


def line(what: str, value: str, target: str = "") -> None:
    print(f"{what:<52}{value:>12}   {target}")


def sampling(net: torch.nn.Module, args: argparse.Namespace) -> None:
    batch, g = made_up_batch(args.windows, sizes=SIZES, clouds=args.clouds), torch.Generator().manual_seed(0)
    took = best(
        {str(n): lambda n=n: net.forecast(batch, args.samples, n, g) for n in (100, 10, 4)}, max(args.repeats // 4, 2)
    )
    print(f"\nsampling: {args.windows} windows x {args.samples} samples")
    for n, target in (("100", ""), ("10", "target >= 9x"), ("4", "target >= 22x")):
        line(f"{n} steps, {1e3 * took[n]:.1f} ms", f"{took['100'] / took[n]:.2f}x", target)


def training(net: torch.nn.Module, args: argparse.Namespace) -> None:
    batch, g = made_up_batch(args.batch, sizes=SIZES, clouds=args.clouds), torch.Generator().manual_seed(0)
    optimiser = torch.optim.AdamW(net.parameters(), lr=1e-4, betas=(0.95, 0.999), fused=True)
    parts = dict.fromkeys(("forward", "backward", "clip", "AdamW"), 0.0)

    def step() -> None:
        marks = [time.perf_counter()]
        optimiser.zero_grad()
        loss = net.losses(batch, g)["loss"]
        marks.append(time.perf_counter())
        loss.backward()
        marks.append(time.perf_counter())
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        marks.append(time.perf_counter())
        optimiser.step()
        marks.append(time.perf_counter())
        for name, a, b in zip(parts, marks[:-1], marks[1:], strict=True):
            parts[name] += b - a

    with FlopCounterMode(display=False) as counter:
        step()
    parts.update(dict.fromkeys(parts, 0.0))
    a, b = torch.randn(2, PEAK_SIDE, PEAK_SIDE).unbind(0)
    took = best({"step": step, "peak": lambda: a @ b}, args.repeats)
    peak, reached = 2 * PEAK_SIDE**3 / took["peak"], counter.get_total_flops() / took["step"]
    whole = sum(parts.values())
    print(f"\ntraining: batch {args.batch}, {counter.get_total_flops() / 1e9:.1f} GFLOP a step")
    line(f"step {1e3 * took['step']:.1f} ms", f"{reached / 1e9:.1f} GFLOP/s")
    line(f"matrix product of side {PEAK_SIDE}", f"{peak / 1e9:.1f} GFLOP/s")
    line("training over matrix product", f"{100 * reached / peak:.1f} %", "target >= 40 %")
    print("  of the step: " + ", ".join(f"{name} {100 * value / whole:.0f} %" for name, value in parts.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="contact_diffusion")
    parser.add_argument("--preset", default="base", choices=["small", "base", "paper"])
    parser.add_argument("--batch", type=int, default=32, help="windows of a training step")
    parser.add_argument("--windows", type=int, default=4, help="windows of a forecast")
    parser.add_argument("--samples", type=int, default=16, help="samples of a window")
    parser.add_argument("--clouds", type=int, default=1, help="distinct objects")
    parser.add_argument("--repeats", type=int, default=12)
    args = parser.parse_args()
    net = build(args.model, args.preset)
    count = sum(p.numel() for p in net.parameters())
    print(f"{args.model} {args.preset}: {count / 1e6:.1f} M parameters, float32, {torch.get_num_threads()} thread(s)")
    sampling(net, args)
    training(net, args)


if __name__ == "__main__":
    main()
