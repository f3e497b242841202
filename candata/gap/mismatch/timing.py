"""Joints that move before their commands or a whole step late, and poses or forces that come some rows late."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect
from candata.gap.data.recordings import Recordings
from candata.gap.fit.candidates import candidate
from candata.gap.mismatch.commands import Paired, episode_spread, late, paired
from candata.gap.mismatch.poses import evenly
from candata.gap.mismatch.readings import Votes, errors, votes
from candata.gap.mismatch.recording_mismatch import Comparison, RecordingMismatch
from candata.gap.mismatch.swaps import distances
from candata.gap.replay.replayer import EffectSet, Replayer
from candata.gap.replay.starts import starts
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.simulate import Trajectory, rollout

Array = NDArray[np.float64]
#: Rows by which joints may react earlier than the scene's before it is asked why.
EARLY_ROWS = 0.6
#: Episodes on which that is asked: every rival is a replay of them.
EARLY_LOOK = 4
#: How near to whole steps a lateness of more than one is called a possible miscount.
WHOLE_ROWS = 0.1
#: Share of the difference to the scene's joints that may be left when they are taken as that late.
MOSTLY_LATE = 0.2
#: Longest delay that effects explain [s] (the bound of `actuation_delay`).
LATEST_S = 0.15
#: What makes joints react earlier than modelled: lighter damping, a stiffer servo, another clock; near enough to one
#: another that the nearest is a better account of what lies between than a shift. Record 43.
RIVALS = (
    *(("servo_damping", "kv_scale", v) for v in (0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85)),
    *(("servo_gain", "kp_scale", v) for v in (1.15, 1.3, 1.5, 1.7, 2.0, 2.5, 3.2, 4.0)),
    *(("clock_drift", "ppm", sign * v) for v in (3e3, 4e3, 6e3, 9e3, 1.4e4, 2e4, 3e4, 4.5e4) for sign in (-1, 1)),
)
#: So do stronger motors: the same limit for all, as shares of the strongest one's. Chosen, coarse. (Fingers of 1.1 N m
#: below a wrist of 8 N m, all limited to 3, were refused as shifted commands.)
STRONGER = (0.25, 0.5, 1.0)
#: By how much a shift must beat the best rival's joint error to be sure.
SURELY = 0.7
#: Share of the joint error that a shift may leave to be named beside a rival that explains it as well: what is logged
#: late leaves little. Measured on a servo at four gains in scenes of nine others: where gain or motor was the cause,
#: a shift left 0.73 to 1.
MOSTLY_EARLY = 0.5


@dataclass(frozen=True)
class SampleReplay:
    """The episodes that are looked at, and where the scene's joints and forces go, open loop."""

    replayer: Replayer
    recs: Recordings
    pairs: Paired | None

    def play(self, recs: Recordings, effects: EffectSet = ()) -> dict[str, Array]:
        """Return the readings of the scene under recorded commands from the recorded starts."""
        return dict(self.played(recs, effects).readings)

    def another(self, recs: Recordings) -> dict[str, Array]:
        """Return the readings of the scene under other recordings: their commands, from their starts."""
        return SampleReplay(self.replayer, recs, None).play(recs)

    def played(self, recs: Recordings, effects: EffectSet = ()) -> Trajectory:
        """Return what the scene does under recorded commands from the recorded starts."""
        scene, begin = self.replayer.scene, starts(self.replayer.scene, self.recs)
        played = rollout(
            scene,
            recs.commands,
            begin.qpos0,
            begin.qvel0,
            [effects] * len(recs),
            instant_force=recs.instant_force,
            memory=begin.memory0,
            supply=recs.supply,
            threads=self.replayer.threads,
        )
        self.replayer.count(len(recs) * recs.commands.shape[1] * scene.substeps)
        return played


def shift_findings(sample: SampleReplay, pairs: Paired, own: Array) -> list[RecordingMismatch]:
    """Return that joints react before their commands, or as late as a step that was counted wrong."""
    each = late(pairs, own)
    each = each[np.isfinite(each)]
    if not len(each):
        return []
    rows, rate = float(np.median(each)), sample.replayer.scene.file.rate_hz
    spread = float(np.quantile(each, 0.75) - np.quantile(each, 0.25))
    if rows > LATEST_S * rate:
        return [_lateness(rows, rate, "more than any delay that is searched: check the clocks of both streams")]
    if abs(rows - 1) < 0.2 and spread < 0.3:
        return [_lateness(rows, rate, "a delay, or one step counted wrong: `action: next` in map.yaml")]
    whole = rows > 1.5 and abs(rows - round(rows)) < WHOLE_ROWS and spread < 0.3
    if whole and _only_later(pairs.joint, own, round(rows)):
        return [_lateness(rows, rate, f"a delay, or commands logged {round(rows)} steps early: check their stamps")]
    if rows > -EARLY_ROWS:
        return []
    some = evenly(len(sample.recs), EARLY_LOOK)
    recs = sample.recs.take(some)
    return early_findings(
        SampleReplay(sample.replayer, recs, None), paired(sample.replayer.scene, recs) or pairs, own[some], rows
    )


def _only_later(joint: Array, own: Array, steps: int) -> bool:
    """Tell whether joints `(E, T, J)` do what the scene's do, but later: a weak or damped servo also does less."""
    every = np.ones(joint.shape[2], bool)
    shifted, before = distances(joint[:, steps:] - own[:, :-steps], every), distances(joint - own, every)
    return bool(np.median(shifted) < MOSTLY_LATE * np.median(before))


def _lateness(rows: float, rate: float, words: str) -> RecordingMismatch:
    """Return the note that joints react late."""
    return RecordingMismatch(
        "shifted_commands",
        False,
        "joints react later than the scene's",
        "the scene's delay",
        f"{rows:.1f} steps ({1e3 * rows / rate:.0f} ms)",
        words,
        "action",
    )


def early_findings(sample: SampleReplay, pairs: Paired, own: Array, rows: float) -> list[RecordingMismatch]:
    """Return that commands are logged late: sure where no servo and no clock explains it as well as a shift.

    Nothing where one of them explains it better, or where they explain it as well and a shift leaves most of it.
    """
    steps, joints = max(1, round(-rows)), pairs.drive.joints
    moved = replace(sample.recs, commands=_ahead(sample.recs.commands, steps))
    shift = _apart(pairs, sample.play(moved)["joint_position"][..., joints])
    scene = sample.replayer.scene
    # The coordinate of a positive number is its logarithm.
    strongest = float(np.exp(candidate("torque_limit", scene).neutral[0]))
    stronger = (("torque_limit", "limit_Nm", share * strongest) for share in STRONGER)
    possible = [r for r in (*RIVALS, *stronger) if effect(r[0]).possible(scene)]
    sets = [(EffectSetting(name=n, parameters={p: v}),) for n, p, v in possible]
    unshifted = rival = _apart(pairs, own)
    ahead = iter(sets)
    while rival >= SURELY * shift and (some := next(ahead, None)):
        rival = min(rival, _apart(pairs, sample.play(sample.recs, some)["joint_position"][..., joints]))
    if rival < SURELY * shift:
        return []
    sure = shift < SURELY * rival
    if not sure and shift > MOSTLY_EARLY * unshifted:
        return []
    one = "`action: previous` in map.yaml, if each row holds the command before it" if steps == 1 else ""
    fix = one or f"move the commands {steps} steps ahead"
    return [
        RecordingMismatch(
            "shifted_commands",
            sure,
            "joints react earlier than the scene's, as if commands were logged late",
            "commands that come first",
            f"{-rows:.1f} steps early",
            fix if sure else f"a faster servo or clock explains it as well; else: {fix}",
            "action",
        )
    ]


def _ahead(commands: Array, steps: int) -> Array:
    """Return commands moved to `steps` rows earlier; the last is held."""
    return np.concatenate([commands[:, steps:], np.repeat(commands[:, -1:], steps, axis=1)], axis=1)


def _apart(pairs: Paired, own: Array) -> float:
    """Return the median over moving joints of the RMS difference to `own (E, T, S)`, over each joint's spread."""
    size, spread = episode_spread(pairs.joint - own), episode_spread(pairs.joint)
    moving = spread > 5 * pairs.quiet + 1e-6
    return float(np.median(size[moving] / spread[moving])) if moving.any() else np.inf


#: Ratio of the errors from which a shift by whole rows is told: it costs no simulation and accuses nobody.
SHIFTED = 0.8
#: Largest shift that is tried [s] and, of readings that come early, [rows]; least distance from the joints' own [rows].
LATEST_READING_S, EARLIEST, APART_ROWS = 0.16, 3, 0.75
#: Added to errors before their logarithm.
SMALLEST = 1e-12


def late_findings(
    scene: Scene, recs: Recordings, nominal: dict[str, Array], joint_rows: float
) -> tuple[Comparison, Recordings]:
    """Return notes that poses or forces come some rows late or early beside the scene's, and the recordings in time.

    Undecidable is a lateness that fits best but not in all episodes, or of which no episode says anything.

    Parameters
    ----------
    joint_rows : float
        Rows by which the joints come after the scene's: what they do to the object comes with them.
    """
    notes: list[RecordingMismatch] = []
    undecidable: list[str] = []
    rate = scene.file.rate_hz
    for channel, name in (("object_pose", "poses"), ("fingertip_force", "forces")):
        if channel not in recs.readings:
            continue
        by_rows = _errors_by_shift(channel, recs, nominal, max(2, round(LATEST_READING_S * rate)))
        best = min(by_rows, key=lambda rows: _log_error(by_rows[rows]))
        vote, is_apart = votes(by_rows[0], by_rows[best], SHIFTED), abs(best - joint_rows) >= APART_ROWS
        if vote.won and is_apart:
            notes.append(_late_channel(channel, name, best, rate, vote))
            recs = replace(recs, readings=recs.readings | {channel: _in_time(recs.readings[channel], best)})
        elif (best and is_apart and not vote.ruled_out) or not any(
            v.better or v.worse for v in (votes(by_rows[0], e, SHIFTED) for e in by_rows.values())
        ):
            undecidable.append(f"{name} that come late")
    return Comparison(tuple(notes), tuple(undecidable)), recs


def _log_error(error: dict[str, Array]) -> float:
    """Return the sum of the logarithms of all errors."""
    return float(np.nansum(np.log(np.stack(list(error.values())) + SMALLEST)))


def _in_time(values: Array, rows: int) -> Array:
    """Return readings `(E, T, ...)` that came some rows late at the rows they belong to; NaN where they lack."""
    out = np.full_like(values, np.nan)
    if rows > 0:
        out[:, :-rows] = values[:, rows:]
    else:
        out[:, -rows:] = values[:, :rows]
    return out


def _errors_by_shift(
    channel: str, recs: Recordings, nominal: dict[str, Array], latest: int
) -> dict[int, dict[str, Array]]:
    """Return the errors of a channel against the scene's by the rows that it is taken to come late.

    All are of the same recorded rows.
    """
    real, simulated = recs.readings[channel], nominal[channel]
    latest = min(latest, real.shape[1] // 4)
    rows = np.arange(latest, real.shape[1] - EARLIEST)
    part = replace(recs, readings={channel: real[:, rows]})
    return {late: errors(part, {channel: simulated[:, rows - late]}) for late in range(-EARLIEST, latest + 1)}


def _late_channel(channel: str, name: str, rows: int, rate: float, vote: Votes) -> RecordingMismatch:
    """Return the note that a channel comes some rows late, or early."""
    when, ms = "later" if rows > 0 else "earlier", f"{1e3 * abs(rows) / rate:.0f} ms"
    count = f"{abs(rows)} row{'s' * (abs(rows) != 1)}"
    return RecordingMismatch(
        f"late_{name}",
        False,
        f"{name} come {when} than the scene's",
        "readings at the time of their row",
        f"as if they came {count} ({ms}) {'late' if rows > 0 else 'early'}: {vote.text}",
        "a sensor that takes its time, or rows counted wrong: look at the stamps of this stream",
        channel,
    )
