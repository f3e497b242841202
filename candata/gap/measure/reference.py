"""What changed since a reference: what the simulator leaves open there is the misfit of the recordings, and no news.

A replay is compared with the recordings less that misfit, so that the diagnosis sees the change alone. What is not
known of the misfit joins the floor.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.gap.data.deviation import SlowDeviation, unshaped
from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import Recordings
from candata.gap.data.repetition import motion_numbers, same_motions
from candata.gap.measure.floor import null_residuals
from candata.gap.measure.repeats import duration_s, has_repeats, mean_of_runs, measured_deviation
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import Layout, layout, residual, row_residual
from candata.gap.replay.starts import starts
from candata.gap.run.streams import Streams
from candata.scenes.traits import is_toss

Array = NDArray[np.float64]
#: Ridge penalties, in variances of a feature, among which left-out motions choose. Chosen: from hardly any to strong.
PENALTIES = (1e-4, 1e-2, 1.0)
#: Share of the misfit's variance on motions left out that a model must foretell to be used. Chosen: what foretells
#: less adds its own error and hardly takes the misfit off.
FORETOLD = 0.2


class _Replayed(NamedTuple):
    """Recordings under the nominal replay: residuals by row `(E, T, D)` and by block `(E, B, D)`.

    `slow` is what repeats differ by beyond sensor noise; None where nothing, or where no motion was repeated.
    """

    recs: Recordings
    plan: Layout
    readings: dict[str, Array]
    rows: Array
    raw: Array
    has_repeats: bool
    slow: SlowDeviation | None


def changed_since(replayer: Replayer, recs: Recordings, reference: Recordings, title: str, seed: int = 0) -> Recordings:
    """Return recordings with what the simulator leaves open in a reference as their misfit.

    Motions that were played in both are compared directly: the mean misfit of the reference's runs is taken off. For
    others a smooth function of each joint's state is fitted to the reference's misfit, and taken off where it foretells
    the misfit of reference motions that had no part in the fit. The spread between repeats and the error of that
    function are kept as slow deviations, so that the floor holds them.

    Parameters
    ----------
    replayer : Replayer
        Replays in the nominal scene.
    recs, reference : Recordings
        Both of that scene.
    title : str
        What the reference is called in notes.
    seed : int
        Seed of null recordings.

    Returns
    -------
    Recordings
        With notes on how they were compared, slow deviations, and by how much their noise is larger.

    Raises
    ------
    DataError
        For tosses, and where the two share no channel.
    """
    scene = replayer.scene
    if is_toss(scene):
        raise DataError(
            "tosses cannot be compared with a reference",
            expected="a scene with actuators, whose commands can be the same in both",
            where=Where(path=scene.name),
            fix="diagnose each data set by itself",
        )
    shared = [c for c in recs.readings if c in reference.readings]
    if not shared:
        raise DataError(
            "the recordings and the reference share no channel",
            expected=", ".join(recs.readings),
            found=", ".join(reference.readings),
            fix="record the same channels",
        )
    new, old = (_replayed(replayer, _of_channels(r, shared), seed) for r in (recs, reference))
    same, model = same_motions(new.recs, old.recs), _fitted(replayer, old)
    misfit = model.foretold(replayer, new)
    for e, others in enumerate(same):
        if others:
            misfit[e] = _mean(old.rows[others], misfit.shape[1])
    runs = np.array([len(others) for others in same])
    factor = float(np.sqrt(1 + np.mean(1 / np.maximum(runs, 1) * (runs > 0))))
    slow = (*_between_runs(new, old, same), *_unknown_misfit(replayer, new, old, same, model))
    notes = (*recs.notes, f"compared with {title}", *_notes(new, old, same, model))
    return replace(new.recs, misfit=misfit, slow=slow, noise_factor=factor, notes=notes)


def _between_runs(new: _Replayed, old: _Replayed, same: list[list[int]]) -> tuple[SlowDeviation, ...]:
    """Return what runs of the recordings differ by; as those of the reference where none of their own is repeated."""
    if new.slow is not None:
        return (new.slow,)
    if new.has_repeats or old.slow is None:
        return ()
    variance = old.slow.variance
    usual = np.broadcast_to(variance.mean((0, 1)), new.rows.shape[1:])
    sd = np.stack([np.sqrt(_cut(variance[others].mean(0), len(usual)) if others else usual) for others in same])
    return (unshaped(sd, old.slow.time_s),)


def _unknown_misfit(
    replayer: Replayer, new: _Replayed, old: _Replayed, same: list[list[int]], model: MisfitModel
) -> tuple[SlowDeviation, ...]:
    """Return what is not known of the reference's misfit, which all episodes of a motion share.

    That is the error of the mean over its runs where repeats tell it, else the error of the model.
    """
    motion, rows = motion_numbers(new.recs), new.rows.shape[1]
    is_known = np.array([bool(others) and (new.has_repeats or old.has_repeats) for others in same])
    sd = np.where(is_known[:, None, None], 0.0, np.broadcast_to(np.sqrt(model.variance), new.rows.shape))
    parts = (unshaped(sd, _duration_s(replayer, old, model), motion),) if sd.any() else ()
    source, at = (old, [o[0] if o else 0 for o in same]) if old.has_repeats else (new, list(range(len(same))))
    seen = source.slow
    if not is_known.any() or seen is None:
        return parts
    share = np.array([1 / np.sqrt(len(o)) if k else 0.0 for o, k in zip(same, is_known, strict=True)])
    shapes = np.stack([_cut(seen.shapes[seen.motion[i]].swapaxes(0, 1), rows).swapaxes(0, 1) for i in at])
    spread = np.stack([_cut(seen.sd[i], rows) for i in at]) * share[:, None, None]
    numbers = np.arange(len(same))
    return (*parts, SlowDeviation(spread, seen.time_s, shapes * share[:, None, None, None], numbers, motion))


def _cut(values: Array, rows: int) -> Array:
    """Return values `(rows, ...)`: the first ones, or with the last one repeated."""
    return values[np.minimum(np.arange(rows), len(values) - 1)]


def _notes(new: _Replayed, old: _Replayed, same: list[list[int]], model: MisfitModel) -> tuple[str, ...]:
    """Return how the recordings were compared with the reference, and what that leaves open."""
    matched = sum(bool(others) for others in same)
    notes = [f"{matched} of {len(same)} episodes play a motion of the reference"]
    repeated = new.has_repeats or old.has_repeats
    if matched and not repeated:
        notes[0] += (
            "; no motion was repeated in either, so what its runs differ by is taken from the reference's misfit"
        )
    if matched < len(same) or not repeated:
        largest = max(range(len(model.variance)), key=lambda i: model.variance[i])
        channel, element, unit = new.plan.columns[largest]
        how = "less what a smooth function of the joints' state foretells of it" if model.is_used else "as it is"
        notes.append(
            f"the reference's misfit, {how}, joins the floor: up to {np.sqrt(model.variance[largest]):.2g} {unit} "
            f"({channel.replace('_', ' ')} {element}); the same motions, repeated in both, would tell more"
        )
    return tuple(notes)


def _of_channels(recs: Recordings, channels: list[str]) -> Recordings:
    """Return recordings of some channels."""
    return replace(recs, readings={c: recs.readings[c] for c in channels})


def _replayed(replayer: Replayer, recs: Recordings, seed: int) -> _Replayed:
    """Return recordings under the nominal replay, and how much repeats in them differ."""
    scene = replayer.scene
    begin = starts(scene, recs)
    readings = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(scene, recs, begin, readings)
    raw = residual(recs, plan, readings)
    noise = sensor_noise(scene.file.noise, recs, readings, scene.sliding)
    repeated, slow = has_repeats(recs), None
    if repeated:
        null = null_residuals(replayer, recs, begin, plan, noise.noise, Streams(seed).of("nulls of repeats", recs.ids))
        slow = measured_deviation(recs, raw, null, plan, scene.file.rate_hz)
    return _Replayed(recs, plan, readings, row_residual(recs, plan, readings), raw, repeated, slow)


def _duration_s(replayer: Replayer, old: _Replayed, model: MisfitModel) -> Array:
    """Return `(D,)` how long what the model leaves lasts."""
    rows, count = old.plan.rows, old.raw.shape[1]
    foretold = model.foretold(replayer, old)[:, : count * rows]
    away = old.raw - foretold.reshape(len(old.raw), count, rows, -1).mean(2)
    return duration_s(away, rows / replayer.scene.file.rate_hz)


def _mean(rows: Array, length: int) -> Array:
    """Return `(length, D)` the mean of runs `(n, T, D)`; NaN where none of them has a reading."""
    mean = mean_of_runs(rows)[:length]
    return np.concatenate([mean, np.full((length - len(mean), rows.shape[2]), np.nan)])


class MisfitModel(NamedTuple):
    """A smooth function of each joint's state that foretells what the simulator leaves open.

    Attributes
    ----------
    weights : (C, K) float64
        Of the features of the joint whose position, velocity or effort a column holds, in units of `scale`; zero where
        the function foretells too little. Such columns come first.
    scale : (C, K) float64
        Root mean square of the features.
    variance : (D,) float64
        Mean square of what is left on motions that had no part in the fit, in the unit of each column squared.
    """

    weights: Array
    scale: Array
    variance: Array

    @property
    def is_used(self) -> bool:
        """Whether the function foretells anything."""
        return bool(self.weights.any())

    def foretold(self, replayer: Replayer, played: _Replayed) -> Array:
        """Return `(E, T, D)` the misfit foretold for recordings; zero for all but joints."""
        out = np.zeros(played.rows.shape)
        for c, joint in enumerate(_joints(replayer, played)):
            out[..., c] = np.nan_to_num(_features(replayer, played, joint) / self.scale[c]) @ self.weights[c]
        return out


def _joints(replayer: Replayer, played: _Replayed) -> list[int]:
    """Return the joint of each column that holds a joint's position, velocity or effort."""
    names = replayer.scene.file.joints
    return [names.index(element) for channel, element, _ in played.plan.columns if channel.startswith("joint_")]


def _fitted(replayer: Replayer, old: _Replayed) -> MisfitModel:
    """Return the model of the reference's misfit, each penalty judged on motions left out."""
    joints = _joints(replayer, old)
    variance = np.nan_to_num(mean_of_runs(old.raw.reshape(-1, old.raw.shape[2]) ** 2))
    motion, every = motion_numbers(old.recs), slice(None, None, old.plan.rows)
    size = _features(replayer, old, 0).shape[2] if joints else 0
    weights, scale = np.zeros((len(joints), size)), np.ones((len(joints), size))
    for c, joint in enumerate(joints):
        x, y = _features(replayer, old, joint)[:, every], old.rows[:, every, c]
        known = np.isfinite(x).all(2) & np.isfinite(y)
        number = np.broadcast_to(motion[:, None], y.shape)[known]
        x, y = x[known], y[known]
        if len(np.unique(number)) < 2:
            continue
        scale[c] = np.maximum(np.sqrt((x**2).mean(0)), 1e-12)
        z = x / scale[c]
        errors = [_left_out_error(z, y, number, penalty) for penalty in PENALTIES]
        best = int(np.argmin(errors))
        if errors[best] < (1 - FORETOLD) * variance[c]:
            weights[c], variance[c] = _ridge(z, y, PENALTIES[best]), errors[best]
    return MisfitModel(weights, scale, variance)


def _left_out_error(x: Array, y: Array, number: NDArray[np.int64], penalty: float) -> float:
    """Return the mean square error of ridge regression on each motion from the others."""
    squares = [
        (y[number == n] - x[number == n] @ _ridge(x[number != n], y[number != n], penalty)) ** 2
        for n in np.unique(number)
    ]
    return float(np.concatenate(squares).mean())


def _ridge(x: Array, y: Array, penalty: float) -> Array:
    """Return `(K,)` weights that minimise (y - x w)^2 + n penalty w^2."""
    return np.asarray(np.linalg.solve(x.T @ x + len(x) * penalty * np.eye(x.shape[1]), x.T @ y))


def _features(replayer: Replayer, played: _Replayed, joint: int) -> Array:
    """Return `(E, T, K)` what the misfit of a joint may depend on: its replayed place, speed, direction and error."""
    scene = replayer.scene
    place = played.readings["joint_position"][..., joint]
    speed = np.gradient(place, axis=1) * scene.file.rate_hz
    usual = np.nanmedian(np.abs(speed)) + 1e-9
    columns = [np.ones_like(place), place, place**2, np.sin(place), np.cos(place), speed, np.tanh(speed / usual)]
    columns.append(np.gradient(speed, axis=1) * scene.file.rate_hz)
    drive = next(
        (k for k, a in enumerate(scene.actuator_ids) if scene.joint_ids[joint] in scene.levers.get(a, ())), None
    )
    if drive is not None:
        error = played.recs.commands[..., drive] - place
        columns += [error, np.tanh(error / (np.nanmedian(np.abs(error)) + 1e-9))]
    return np.stack(columns, axis=-1)
