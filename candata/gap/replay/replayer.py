"""Replay: the recorded commands in the scene with effects added, under the guarded slow observer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect, flatten, turn
from candata.gap.data.noise import SMALLEST
from candata.gap.data.recordings import Recordings
from candata.gap.data.velocity import joint_velocity
from candata.gap.replay.starts import Starts, starts
from candata.rotation import normalise
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.schema.effect import EffectSetting
from candata.simulate import Observer, followed_readings, rollout, true_state

Array = NDArray[np.float64]
EffectSet = tuple[EffectSetting, ...]
#: Simulations stepped together: enough to hide the loop's overhead, few enough to stay in cache.
BATCH = 256


@dataclass(frozen=True)
class Replayer:
    """What every replay of a diagnosis shares.

    Attributes
    ----------
    scene : Scene
    threads : int
    count : callable
        Called with the number of physics steps done, for progress.
    """

    scene: Scene
    threads: int = 1
    count: Callable[[int], None] = lambda steps: None


@dataclass
class ReplayedSteps:
    """How much a diagnosis has simulated: control steps, of one episode in one world each.

    What was kept from earlier is not simulated again and not counted. Not counted either are the short runs in which
    starts are estimated, and the recordings of motions that are proposed.

    Attributes
    ----------
    steps : int
    """

    steps: int = 0

    def watched(self, replayer: Replayer) -> Replayer:
        """Return a replayer whose simulations are counted here."""

        def count(physics_steps: int) -> None:
            self.steps += physics_steps // replayer.scene.substeps
            replayer.count(physics_steps)

        return replace(replayer, count=count)


def replay(
    replayer: Replayer,
    recs: Recordings,
    begin: Starts,
    variants: Sequence[EffectSet],
    *,
    keep_state: bool = False,
) -> list[dict[str, Array]]:
    """Return the readings of each variant, aligned with the recording's rows.

    Parameters
    ----------
    replayer : Replayer
    recs : Recordings
        E recorded episodes.
    begin : Starts
        Where they start.
    variants : sequence of V tuples of EffectSetting
        Effect sets to add to the nominal scene.
    keep_state : bool
        Also return `qpos (E, T, nq)`.

    Returns
    -------
    list of V dict
        Channel to `(E, T, ...)`, NaN before the start row; `touch (E, T)` beside the channels.
    """
    per = max(1, BATCH // len(recs))
    out: list[dict[str, Array]] = []
    for first in range(0, len(variants), per):
        out += _batch(replayer, recs, begin, variants[first : first + per], keep_state)
    return out


def _batch(
    replayer: Replayer, recs: Recordings, begin: Starts, variants: Sequence[EffectSet], keep_state: bool
) -> list[dict[str, Array]]:
    """Return the readings of variants that are stepped together."""
    scene, count, copies = replayer.scene, len(recs), len(variants)
    noise = np.asarray((scene.file.noise or SMALLEST).joint_position)
    observer = None if is_toss(scene) else Observer(_followed(scene, recs, begin, variants), joint_noise=noise)
    effects = [v for v in variants for _ in range(count)]
    commands = _tile(_shift(recs.commands, begin.rows, hold=True), copies)
    states = [true_start(scene, recs, begin, v) for v in variants]
    played = rollout(
        scene,
        commands,
        np.concatenate([s.qpos for s in states]),
        np.concatenate([s.qvel for s in states]),
        effects,
        observer=observer,
        memory=np.concatenate([s.memory for s in states]),
        earlier_commands=_tile(commands_before(recs.commands, begin.rows), copies),
        supply=None if recs.supply is None else _tile(_shift(recs.supply, begin.rows, hold=True), copies),
        instant_force=recs.instant_force,
        keep_state=keep_state,
        read_effort="joint_effort" in recs.readings,
        threads=replayer.threads,
    )
    replayer.count(commands.shape[0] * commands.shape[1] * scene.substeps)
    found = read_alike(scene, recs, played.readings) | {"touch": played.touch.astype(float)}
    if keep_state:
        found["qpos"] = played.qpos
    return [{n: _unshift(v[i * count : (i + 1) * count], begin.rows) for n, v in found.items()} for i in range(copies)]


def read_alike(scene: Scene, recs: Recordings, readings: dict[str, Array]) -> dict[str, Array]:
    """Return simulated readings with the velocity that servos derive from their encoders, where it was recorded."""
    if "joint_velocity" not in recs.readings:
        return dict(readings)
    return readings | {"joint_velocity": joint_velocity(readings["joint_position"], scene.file.rate_hz)}


def _followed(scene: Scene, recs: Recordings, begin: Starts, variants: Sequence[EffectSet]) -> dict[str, Array]:
    """Return what an observer follows in each variant, `(V x E, T, ...)` a channel, row 0 where the replay starts."""
    true = [followed_readings(scene, recs.readings, some) for some in variants]
    return {n: np.concatenate([_shift(one[n], begin.rows) for one in true]) for n in recs.readings}


def true_start(scene: Scene, recs: Recordings, begin: Starts, some: EffectSet) -> Starts:
    """Return where a replay in a world with some effects starts: as read, with what the sensors add taken off.

    An encoder that reads too much began at less; a tracker whose lengths are short saw a faster toss. Starts that were
    perturbed stay so.
    """
    if all(effect(s.name).unread is None for s in (*scene.given_effects, *some)):
        return begin
    true = replace(recs, readings=recs.readings | true_state(scene, recs.readings, some))
    own, plain = (starts(scene, r, begin.moving).arrays for r in (true, recs))
    state = {n: values + own[n] - plain[n] for n, values in begin.arrays.items() if n != "rows"}
    if scene.object_id is not None:
        turn = slice(scene.object_qpos + 3, scene.object_qpos + 7)
        for qpos in (state["qpos"], state["qpos0"]):
            qpos[:, turn] = normalise(qpos[:, turn])
    return Starts(begin.rows, **state)


def commands_before(commands: Array, rows: NDArray[np.int64]) -> Array:
    """Return `(E, L, A)` the commands before row `rows[e]`, as far back as any episode has some; the first is held."""
    back = np.arange(int(rows.max(initial=0)))[::-1] + 1
    at = np.maximum(rows[:, None] - back, 0)
    return commands[np.arange(len(rows))[:, None], at]


def _tile(values: Array, copies: int) -> Array:
    """Return the values repeated for each variant."""
    return np.concatenate([values] * copies)


def _shift(values: Array, rows: NDArray[np.int64], hold: bool = False) -> Array:
    """Return `(E, T, ...)` with row `rows[e]` moved to row 0; the tail is NaN, or held."""
    if not rows.any():
        return values
    out = np.full_like(values, np.nan)
    for e, row in enumerate(rows):
        kept = values.shape[1] - row
        out[e, :kept] = values[e, row:]
        if hold and row:
            out[e, kept:] = values[e, -1]
    return out


def _unshift(values: Array, rows: NDArray[np.int64]) -> Array:
    """Return the inverse of `_shift`, NaN before the start."""
    if not rows.any():
        return values
    out = np.full_like(values, np.nan)
    for e, row in enumerate(rows):
        out[e, row:] = values[e, : values.shape[1] - row]
    return out


def is_simulated(name: str) -> bool:
    """Tell whether an effect changes more than what is read after the fact.

    A reading that the observer follows (pose, joints) changes the replay; forces are only compared.
    """
    return effect(name).reading is None or bool(set(effect(name).moves) - {"fingertip_force"})


def needs_simulation(some: EffectSet) -> bool:
    """Tell whether a set changes more than what is read after the fact."""
    return any(is_simulated(s.name) for s in some)


def sense(scene: Scene, readings: dict[str, Array], some: EffectSet) -> dict[str, Array]:
    """Return the readings of a replay passed through sensing effects that need no simulation."""
    for s in sorted(some, key=lambda s: turn(s.name)):  # the stepping loop's order
        hook = effect(s.name).reading
        if hook is None:
            continue
        n = len(readings["fingertip_force"])
        state = hook.start(scene, np.repeat(flatten(s, scene)[None], n, axis=0), [s.element] * n)
        rows = []
        for k in range(readings["fingertip_force"].shape[1]):
            state, row = hook.apply(state, {"fingertip_force": readings["fingertip_force"][:, k]})
            rows.append(row["fingertip_force"])
        readings = readings | {"fingertip_force": np.stack(rows, 1)}
    return readings


def replay_all(
    replayer: Replayer, recs: Recordings, begin: Starts, variants: Sequence[EffectSet]
) -> list[dict[str, Array]]:
    """Return the readings of each variant; those that differ by force sensing alone share one simulation."""
    physical = [tuple(s for s in v if needs_simulation((s,))) for v in variants]
    distinct = list(dict.fromkeys(name_of(p) for p in physical))
    first = {name_of(p): p for p in reversed(physical)}
    simulated = dict(zip(distinct, replay(replayer, recs, begin, [first[k] for k in distinct]), strict=True))
    return [
        sense(replayer.scene, simulated[name_of(p)], tuple(s for s in v if not needs_simulation((s,))))
        for v, p in zip(variants, physical, strict=True)
    ]


def name_of(some: EffectSet) -> str:
    """Return a text that names a set of effects."""
    return "\n".join(s.model_dump_json() for s in some)
