"""What repeats of one motion differ by beyond sensor noise: drift, temperature, supply, stick-slip.

Sensor noise is white and averages out; these deviations last for seconds. They are measured on residuals of repeats of
one motion, and null recordings are given deviations of the same size and duration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.deviation import SlowDeviation, unshaped
from candata.gap.data.noise import PAIRS, NoiseKind
from candata.gap.data.recordings import Recordings
from candata.gap.data.repetition import ALIKE, repeat_groups
from candata.gap.replay.residuals import Layout
from candata.scenes import Scene
from candata.schema.scene import Repeatability

Array = NDArray[np.float64]
#: Length over which the deviation of repeats counts as equally large [s]: stick-slip ends within it. Chosen.
STRETCH_S = 0.5
#: Variance between repeats, over that of null recordings, from which on they differ by more than noise; and by how many
#: standard deviations of the null recordings' own value. Chosen: the noise estimate too trusts no less than 1.3 times.
EXCESS, EXCESS_SDS = 1.69, 5.0
#: Degrees of freedom by which the variance of a stretch is drawn to that of all alike. Chosen: two repeats give one.
#: Source of the rule: G. K. Smyth, "Linear models and empirical Bayes methods", SAGMB 3 (2004), eq. for s~^2.
PRIOR_DF = 4.0
#: Longest time that a deviation is taken to last [s]. Chosen: an episode seldom lasts longer.
LONGEST_S = 10.0


def slow_deviation(
    scene: Scene, recs: Recordings, raw: Array, null: Array, plan: Layout, noise_kind: NoiseKind
) -> tuple[tuple[SlowDeviation, ...], tuple[str, ...]]:
    """Return what repeats of a motion differ by beyond sensor noise, and what to tell about it.

    It is measured where motions were repeated, and never below what the scene declares. Without repeats what is
    declared counts; where nothing is, the floor is a lower bound.

    Parameters
    ----------
    scene : Scene
    recs : Recordings
    raw : (E, B, D) float64
        Residuals under the nominal replay.
    null : (R, E, B, D) float64
        Residuals of null recordings with sensor noise alone.
    plan : Layout
    noise_kind : str
        Where the sensors' noise comes from.
    """
    is_known, found = bool(recs.slow) or has_repeats(recs), recs.slow
    notes: tuple[str, ...] = ()
    if is_known and not found:  # a comparison with a reference has found it already
        measured = measured_deviation(recs, raw, null, plan, scene.file.rate_hz)
        found, notes = ((measured,), _sizes_told(measured, plan)) if measured else ((), ())
    if scene.file.repeatability is not None:
        return (*found, *_declared(scene.file.repeatability, plan, recs.commands.shape[1], found)), notes
    if not is_known and noise_kind == "assumed":
        notes = (_lower_bound(recs, scene.file.rate_hz),)
    return found, notes


def has_repeats(recs: Recordings) -> bool:
    """Tell whether enough motions were played more than once to measure what repeats differ by."""
    return sum(len(g) - 1 for g in repeat_groups(recs)) >= PAIRS


def deviation_of_others(recs: Recordings, episodes: int) -> tuple[SlowDeviation, ...]:
    """Return what other episodes of the same kind are expected to deviate by: the mean variance, in every row."""
    variance = np.sum([part.variance for part in recs.slow], axis=0).mean((0, 1))
    sd = np.broadcast_to(np.sqrt(variance), (episodes, recs.commands.shape[1], len(variance)))
    return (unshaped(sd, recs.slow[0].time_s),)


def _lower_bound(recs: Recordings, rate_hz: float) -> str:
    """Return the note on a floor without repeats: what one more recording of each motion would tell."""
    stretches = float((recs.lengths / rate_hz / STRETCH_S).sum())
    error = 100 / np.sqrt(2 * max(stretches, 1.0))
    return (
        "no motion was repeated and the scene declares no `noise` or `repeatability`: the floor is sensor noise alone, "
        "a lower bound of what two recordings of one motion differ by; recording each motion once more would tell it "
        f"to about {max(error, 1.0):.0f} %"
    )


def _sizes_told(measured: SlowDeviation, plan: Layout) -> tuple[str, ...]:
    """Return what repeats differ by, a note for each quantity that does."""
    sizes = np.sqrt(measured.variance.mean((0, 1)))
    notes = []
    for channel, unit in dict.fromkeys((c, u) for c, _, u in plan.columns):
        columns = [i for i, (c, _, u) in enumerate(plan.columns) if (c, u) == (channel, unit)]
        largest = max(columns, key=lambda i: sizes[i])
        if sizes[largest] > 0:
            notes.append(
                f"repeats of a motion differ in {channel.replace('_', ' ')} by up to {sizes[largest]:.2g} {unit} "
                f"({plan.columns[largest][1]}) for {measured.time_s[largest]:.2g} s at a time, beyond sensor noise: "
                "the floor holds it"
            )
    return tuple(notes)


def _moving_blocks(recs: Recordings, plan: Layout, rate_hz: float) -> NDArray[np.bool_]:
    """Return `(E, B)` the blocks in which a command differs from what it was `STRETCH_S` before."""
    commands, blocks = recs.commands, plan.phase.shape[1]
    back = max(1, round(STRETCH_S * rate_hz))
    spread = np.ptp(commands, axis=(0, 1)) if commands.size else np.zeros(commands.shape[2])
    earlier = np.concatenate([np.repeat(commands[:, :1], back, axis=1), commands], axis=1)[:, : commands.shape[1]]
    moves = (np.abs(commands - earlier) > ALIKE * spread).any(2)
    return np.asarray(moves[:, : blocks * plan.rows].reshape(len(recs), blocks, plan.rows).any(2))


def _declared(
    declared: Repeatability, plan: Layout, rows: int, measured: tuple[SlowDeviation, ...]
) -> tuple[SlowDeviation, ...]:
    """Return what a scene declares beyond what was measured; nothing where that is as large everywhere."""
    sizes = {
        "joint_position": lambda element: declared.joint_position,
        "object_pose": lambda element: declared.object_pose[element.startswith("rotation")],
        "fingertip_force": lambda element: declared.fingertip_force,
    }
    least = np.array([sizes[c](element) if c in sizes else 0.0 for c, element, _ in plan.columns], float)
    known = sum((part.variance for part in measured), np.zeros((len(plan.phase), rows, len(least))))
    sd = np.sqrt(np.maximum(least**2 - known, 0.0))
    return (unshaped(sd, np.full(len(least), declared.time_s)),) if sd.any() else ()


def measured_deviation(recs: Recordings, raw: Array, null: Array, plan: Layout, rate_hz: float) -> SlowDeviation | None:
    """Return by how much repeats of a motion differ beyond null recordings; None where they do not.

    Parameters
    ----------
    recs : Recordings
        E recordings, some of them repeats.
    raw : (E, B, D) float64
        Their residuals under the nominal replay.
    null : (R, E, B, D) float64
        Those of null recordings with the sensors' noise alone.
    plan : Layout
        Their blocks.
    rate_hz : float
        Rows a second.
    """
    groups, moving, rows = repeat_groups(recs), _moving_blocks(recs, plan, rate_hz), recs.commands.shape[1]
    size = max(1, round(STRETCH_S * rate_hz / plan.rows))
    observed, copies = _variance(raw, groups), np.stack([_variance(z, groups) for z in null])
    differing = _differs(observed, copies)
    if not differing.any():
        return None
    excess = np.where(differing, observed - copies.mean(0), 0.0)
    df = np.array([len(g) - 1 for g in groups], float)
    spread = np.zeros(raw.shape)
    typical = {kind: _pooled(excess, groups, moving, df, kind) for kind in (False, True)}
    for k, group in enumerate(groups):
        for begin in range(0, raw.shape[1], size):
            part = slice(begin, begin + size)
            kind = bool(moving[group[0], part].any())
            seen = np.nan_to_num(mean_of_runs(excess[k, part]))
            pooled = (df[k] * seen + PRIOR_DF * typical[kind]) / (df[k] + PRIOR_DF)
            spread[group, part] = np.maximum(pooled, 0.0) / (df[k] + 1)  # the part that no run seen has
    # A variance known from few repeats is larger than it seems as often as smaller: Student's t of as many degrees.
    total = max(df.sum(), 3.0)
    for e in np.setdiff1d(np.arange(len(raw)), np.concatenate(groups)):
        spread[e] = np.where(moving[e][:, None], typical[True], typical[False]) * total / (total - 2)
    away = [np.nan_to_num(raw[g] - mean_of_runs(raw[g])) for g in groups]
    motion, shapes = np.full(len(raw), len(groups)), np.zeros((len(groups) + 1, int(df.max()) + 1, *raw.shape[1:]))
    slow_share = np.sqrt(np.clip(np.nansum(excess, (0, 1)) / np.maximum(np.nansum(observed, (0, 1)), 1e-18), 0.0, 1.0))
    for k, group in enumerate(groups):
        motion[group] = k
        shapes[k, : len(group)] = away[k] * slow_share / np.sqrt(df[k] + 1)
    return SlowDeviation(
        _by_row(np.sqrt(spread), plan.rows, rows),
        duration_s(np.concatenate(away), plan.rows / rate_hz),
        _by_row(shapes, plan.rows, rows),
        motion,
        np.arange(len(raw)),
    )


def _by_row(blocks: Array, size: int, rows: int) -> Array:
    """Return values of blocks `(..., B, D)` for every row `(..., rows, D)`, the last for those beyond."""
    at = np.minimum(np.arange(rows) // size, blocks.shape[-2] - 1)
    return blocks[..., at, :]


def mean_of_runs(values: Array) -> Array:
    """Return the mean over the first axis `(n, ...)`; NaN where no run has a value."""
    finite = np.isfinite(values)
    count = finite.sum(0)
    return np.where(count > 0, np.where(finite, values, 0.0).sum(0) / np.maximum(count, 1), np.nan)


def _variance(residuals: Array, groups: list[list[int]]) -> Array:
    """Return `(G, B, D)` the unbiased variance of residuals between repeats; NaN where fewer than two were seen."""
    out = []
    for group in groups:
        values = residuals[group]
        count = np.isfinite(values).sum(0)
        squares = np.nansum((values - mean_of_runs(values)) ** 2, axis=0)
        out.append(np.where(count > 1, squares / np.maximum(count - 1, 1), np.nan))
    return np.stack(out)


def _differs(observed: Array, copies: Array) -> NDArray[np.bool_]:
    """Return `(D,)` the columns in which repeats differ by more than null recordings do."""
    seen = np.isfinite(observed)[None] & np.isfinite(copies)
    level = np.maximum(np.where(seen, copies, 0.0).sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1), 1e-18)
    usual = level.mean(0)
    ratio = np.where(seen[0], observed, 0.0).sum((0, 1)) / np.maximum(seen[0].sum((0, 1)), 1) / usual
    least = np.maximum(EXCESS, 1 + EXCESS_SDS * (level / usual).std(0, ddof=1))
    return np.asarray(ratio > least)


def _pooled(excess: Array, groups: list[list[int]], moving: NDArray[np.bool_], df: Array, kind: bool) -> Array:
    """Return `(D,)` the mean excess of blocks of one kind, moving or still, by degrees of freedom; of all without."""
    weights = np.broadcast_to(df[:, None], excess.shape[:2])
    chosen = np.stack([moving[g[0]] == kind for g in groups])
    chosen = chosen if chosen.any() else np.ones_like(chosen)
    weight = np.where(np.isfinite(excess) & chosen[..., None], weights[..., None], 0.0)
    mean = np.where(weight > 0, excess * weight, 0.0).sum((0, 1)) / np.maximum(weight.sum((0, 1)), 1e-12)
    return np.maximum(mean, 0.0)


def duration_s(deviations: Array, block_s: float) -> Array:
    """Return `(D,)` how long deviations `(E, B, D)` last, from their autocorrelation over one and two blocks.

    White noise lowers both alike, so their ratio is that of the slow part alone.
    """
    lags = []
    for lag in (1, 2):
        product = deviations[:, lag:] * deviations[:, : deviations.shape[1] - lag]
        lags.append(np.where(np.isfinite(product), product, 0.0).sum((0, 1)))
    falls = (lags[0] > 0) & (lags[1] > 0)
    share = np.where(falls, lags[1] / np.where(falls, lags[0], 1.0), 0.0)
    return np.clip(-block_s / np.log(np.clip(share, 1e-3, 1 - 1e-9)), block_s, LONGEST_S)
