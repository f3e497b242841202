"""Commands of a random small scene: smooth motions that begin at the command at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.servos import Drive, Servo
from candata.gap.blind.rigs.text import chance, uniform

Array = NDArray[np.float64]
#: Time in which a sum of sines fades in [s], its frequencies [Hz], shortest and longest time between points [s].
FADE_S, SINES_HZ, POINTS_S = 0.3, (0.3, 1.8), (0.18, 0.6)


def commands(rig: Rig, rng: np.random.Generator, lead: int) -> Array:
    """Return `(lead + T, A)` commands of one task, held at rest for `lead` rows unless episodes are cut.

    Parameters
    ----------
    rig : Rig
    rng : numpy.random.Generator
        Of the task.
    lead : int
        Rows before the episode begins.
    """
    rows, rate = rig.rows + (lead if rig.cut else 0), rig.file.rate_hz
    time = np.arange(rows + 1) / rate
    beat = _beat(rng, time[-1])
    paths = np.stack([_path(d.servo, rig, time, beat, rng) for d in rig.drives], axis=1)
    if not rig.cut:
        paths = np.concatenate([np.repeat(paths[:1], lead, axis=0), paths])
    fast = np.array([d.integrates for d in rig.drives])
    return np.where(fast, np.diff(paths, axis=0) * rate, paths[:-1])


def rest_command(rig: Rig) -> Array:
    """Return `(A,)` commands at rest: no velocity, or the place at which episodes begin."""
    return np.array([0.0 if d.integrates else start_of(d, rig) for d in rig.drives])


def start_of(drive: Drive, rig: Rig) -> float:
    """Return where a servo's joint is told to be when an episode begins."""
    servo = drive.servo
    if rig.situation == "held" and servo.role == "grip":
        return servo.rest + 0.7 * (servo.toward - servo.rest)
    return servo.rest


def _beat(rng: np.random.Generator, length: float) -> tuple[float, float, float, float]:
    """Return when a grasp closes, is closed, opens again and is open [s]."""
    close = uniform(rng, 0.05, 0.15) * length
    closed = close + uniform(rng, 0.15, 0.4)
    opens = uniform(rng, 0.7, 0.9) * length if chance(rng, 0.5) else 2 * length
    return close, closed, opens, opens + uniform(rng, 0.15, 0.3)


def _path(servo: Servo, rig: Rig, time: Array, beat: tuple[float, ...], rng: np.random.Generator) -> Array:
    """Return `(T,)` targets of one servo."""
    rest, away, toward = servo.rest, servo.away, servo.toward
    if servo.role == "grip" and rig.situation == "held":
        start = rest + 0.7 * (toward - rest)
        return _sines(time, start, 0.3 * (toward - rest) * uniform(rng, 0.3, 0.9), rng)
    if servo.role == "grip":
        close, closed, opens, opened = beat
        ripple = _sines(time, 0.0, 0.15 * (toward - rest), rng)
        shut = _step(time, close, closed) - _step(time, opens, opened)
        return rest + shut * (toward - rest + ripple)
    if servo.role == "lift":
        _, closed, opens, _ = beat
        up = closed + uniform(rng, 0.1, 0.2)
        raised = _step(time, up, up + uniform(rng, 0.3, 0.6))
        down = uniform(rng, 0.75, 0.95) * time[-1] if opens > time[-1] else opens - 0.25
        lowered = _step(time, max(down - 0.3, up + 0.4), max(down, up + 0.6)) if chance(rng, 0.7) else 0.0
        return rest + (toward - rest) * raised * (1 - lowered) + 0.05 * (toward - rest) * raised * np.sin(6 * time)
    if servo.role == "carry":
        return _sines(time, rest, min(abs(toward - rest), abs(away - rest) + 0.004), rng)
    if servo.role in ("push", "press"):
        return _points(time, rest, away, toward, rng, strokes=True)
    kind = rng.choice(["sines", "points", "hold"], p=[0.45, 0.45, 0.1])
    if kind == "hold" and len(rig.drives) > 1:
        return np.full(len(time), rest)
    if kind == "sines":
        return _sines(time, rest, 0.5 * abs(toward - away), rng)
    return _points(time, rest, away, toward, rng, strokes=False)


def _step(time: Array, start: float, end: float) -> Array:
    """Return a minimum-jerk step from 0 to 1 (Flash and Hogan 1985, eq. 1 with rest at both ends)."""
    s = np.clip((time - start) / max(end - start, 1e-9), 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def _sines(time: Array, rest: float, size: float, rng: np.random.Generator) -> Array:
    """Return one to three sines around `rest` that fade in, at most `size` away."""
    count = int(rng.integers(1, 4))
    parts = rng.uniform(0.3, 1.0, count)
    hertz, phase = rng.uniform(*SINES_HZ, count), rng.uniform(0, 2 * np.pi, count)
    waves = parts @ np.sin(2 * np.pi * hertz[:, None] * time + phase[:, None]) / parts.sum()
    return rest + size * _step(time, 0.0, FADE_S) * waves


def _points(time: Array, rest: float, away: float, toward: float, rng: np.random.Generator, strokes: bool) -> Array:
    """Return minimum-jerk moves through random points, some held; every other one far toward where `strokes`."""
    out, now, at = np.full(len(time), rest), uniform(rng, 0.0, 0.15), rest
    inward = chance(rng, 0.8)
    while now < time[-1]:
        length = uniform(rng, *POINTS_S)
        if strokes:
            goal = rest + (toward - rest) * uniform(rng, 0.7, 1.0) if inward else away + (rest - away) * rng.random()
            inward = not inward
        else:
            goal = away + (toward - away) * float(rng.random())
        out += (goal - at) * _step(time, now, now + length)
        at, now = goal, now + length + (uniform(rng, 0.05, 0.3) if chance(rng, 0.4) else 0.0)
    return out
