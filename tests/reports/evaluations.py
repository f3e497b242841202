"""Evaluations made by hand, for the tests of their pages."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from candata.schema.effect import EffectSetting
from candata.training.results import (
    ClosedLoopScores,
    Contact,
    EpisodeScores,
    Evaluation,
    EventTiming,
    Group,
    GroupScores,
    LongLoopScores,
    ModelFacts,
    Pair,
    Scores,
    SimulatorFacts,
    Success,
    Track,
    WindowScores,
)

NAMES = ("first", "second", "simulator", "stays")
SUMMARIES = (
    "first (contact_diffusion, mean of 16 samples)",
    "second (mlp, mean of 16 samples)",
    "the simulator",
    "the object stays",
)
#: Errors grow in proportion to these.
SIZES = dict(zip(NAMES, (0.0005, 0.001, 0.0016, 0.005), strict=True))
#: Pictures left out; many episodes included.
LARGEST_PAGE = 400_000


def scores(summary: str, size: float, adds: bool = True, contact: bool = True, horizon: int = 16) -> Scores:
    """Errors that grow with the horizon in proportion to `size`."""
    errors_m = tuple(0.002 + size * k for k in range(1, horizon + 1))
    contact_scores = Contact(precision=0.9, recall=0.8, f1=0.847, auroc=0.93) if contact else None
    timing = EventTiming(recorded=9, matched=7, spurious=1, median_s=0.1, q25_s=-0.1, q75_s=0.2) if contact else None
    windows = WindowScores(
        position_error_m=errors_m,
        rotation_error_rad=tuple(5 * v for v in errors_m),
        position_mse_m2=tuple(v**2 for v in errors_m),
        rotation_mse_rad2=tuple(25 * v**2 for v in errors_m),
        increment_mse=3.21e-4,
        position_energy_m=tuple(0.8 * v for v in errors_m),
        adds_m=tuple(v / 2 if adds else None for v in errors_m),
        adds_auc=1 - 40 * size if adds else None,
        contact=contact_scores,
    )
    long_loops = [
        LongLoopScores(
            time_s=2, episodes=38, position_error_m=size * 14, rotation_error_rad=0.1, adds_m=None, adds_auc=None
        ),
        LongLoopScores(
            time_s=5, episodes=0, position_error_m=None, rotation_error_rad=None, adds_m=None, adds_auc=None
        ),
    ]
    closed_loop = ClosedLoopScores(
        adds_auc=1 - 50 * size if adds else None,
        adds_auc_interval=(0.9 - 50 * size, 0.95 - 50 * size) if adds else None,
        adds_m=size * 8 if adds else None,
        position_error_m=size * 12,
        rotation_error_rad=size * 50,
        final_position_error_m=size * 16,
        success=Success(count=28, total=40, share=0.7, low=0.546, high=0.819),
        contact=contact_scores,
        onset=timing,
        release=timing,
        long_loops=tuple(long_loops),
    )
    return Scores(summary=summary, windows=windows, closed_loop=closed_loop)


def facts(model: str, **changes: object) -> ModelFacts:
    fields = {
        "run": "run",
        "checkpoint": "best.safetensors",
        "step": 4000,
        "model": model,
        "preset": "paper",
        "trained_on": "sim@0123456789ab",
        "planned_actions": False,
        "seen_episodes": 0,
        "history": 8,
        "horizon": 16,
        "execute": 8,
        "contact_from": "predicted",
    }
    return ModelFacts.model_validate(fields | changes)


def make_pairs(half_width: float | None = 0.01) -> tuple[Pair, ...]:
    """The differences of the forecasters' areas, all as sure as each other."""
    pairs = []
    for name, reference in combinations(NAMES, 2):
        value = 50 * (SIZES[reference] - SIZES[name])
        ends = (None, None) if half_width is None else (value - half_width, value + half_width)
        pairs.append(Pair(forecaster=name, reference=reference, value=value, low=ends[0], high=ends[1]))
    return tuple(pairs)


READS_SIMULATOR = facts(
    "sim_residual",
    horizon=12,
    planned_actions=True,
    simulator=SimulatorFacts(scene=None, effects=(EffectSetting(name="object_mass"),)),
)


def make_evaluation(adds: bool = True, contact: bool = True, **changes: object) -> Evaluation:
    forecasters = {
        name: scores(text, SIZES[name], adds, contact, 12 if name == "second" else 16)
        for name, text in zip(NAMES, SUMMARIES, strict=True)
    }
    auc = {name: 1 - 50 * size for name, size in SIZES.items()} if adds else {}
    group = GroupScores(adds_auc=0.9, adds_m=0.005, position_error_m=0.01, rotation_error_rad=0.05)
    groups = {name: Group(episodes=20, rows=240, scores=dict.fromkeys(NAMES, group)) for name in ("push", "roll")}
    fields = {
        "dataset": "sim@0123456789ab",
        "split": "default",
        "group": "test",
        "episodes": 40,
        "windows": 620,
        "rows": 480,
        "gap_rows": 24,
        "rate_hz": 10.0,
        "begins_after": 8,
        "samples": 16,
        "sampling_steps": 10,
        "seed": 0,
        "models": {"first": facts("contact_diffusion"), "second": READS_SIMULATOR},
        "simulators": {"simulator": SimulatorFacts(scene=None)},
        "forecasters": forecasters,
        "pairs": make_pairs() if adds else (),
        "breakdown": {"task": groups, "object": {"cup": groups["push"]}},
        "by_episode": [
            EpisodeScores(id=f"ep-{k}", moved_m=0.03 * k, adds_auc=auc, final_position_error_m={NAMES[0]: 0.01})
            for k in range(2)
        ],
        "revision": "0.1.0",
    }
    return Evaluation.model_validate(fields | changes)


def make_track(number: int = 0, contact: bool = True) -> Track:
    """A lift, which the model follows half way."""
    time_s = 0.7 + np.arange(26) / 10
    truth = np.tile([0.1, 0.05, 0.06, 1.0, 0, 0, 0], (26, 1))
    truth[:, 2] += 0.08 * np.clip(time_s - 1, 0, 1)
    half_lift = truth.copy()
    half_lift[:, 2] = (truth[:, 2] + 0.06) / 2
    drifting = truth.copy()
    drifting[:, 0] += 0.1 * (time_s - 0.7)
    poses = {"first": half_lift, "second": half_lift, "simulator": drifting, "stays": np.tile(truth[0], (26, 1))}
    forecast = np.concatenate([[np.nan], np.linspace(0, 1, 25)])
    says_contact = {"first": forecast, "simulator": np.round(forecast), "stays": 0 * forecast} if contact else {}
    sampled = (
        {} if number else {"first": half_lift + np.linspace(-0.01, 0.01, 5)[:, None, None] * (time_s > 1)[:, None]}
    )
    return Track(f"ep-{number}", time_s, truth, poses, time_s > 1 if contact else None, says_contact, sampled)


TRACKS = (make_track(0), make_track(1))
