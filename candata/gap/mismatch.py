"""Mismatch: recordings that are not what scene and schema say, found before anything is called physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.effects import effect
from candata.gap.candidates import candidate
from candata.gap.finding import Comparison, RecordingMismatch
from candata.gap.mismatch_commands import (
    Paired,
    following_findings,
    late,
    paired,
    slope_findings,
    still_findings,
    unit_findings,
    unstable_findings,
    within,
    zero_findings,
)
from candata.gap.mismatch_forces import exchange_findings, exchange_rivals, scale_findings
from candata.gap.mismatch_range import range_findings
from candata.gap.mismatch_readings import felt_findings, late_findings, place_findings
from candata.gap.mismatch_sensors import distance_findings, force_findings, pose_findings, touches
from candata.gap.mismatch_swaps import Swap, confirmed, distances, ordered, overlap, swap_findings, swaps
from candata.gap.recordings import Recordings
from candata.gap.replay import EffectSet, Replayer
from candata.gap.starts import STILL_ROWS, is_toss, starts
from candata.gap.unseen import without_object
from candata.gap.untested import untested_notes
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.simulate import Trajectory, rollout

Array = NDArray[np.float64]
#: Episodes that are played: a mismatch is in all of them, or in a part that shows among so many.
LOOKED_AT = 12
#: Rows by which joints may react earlier than the scene's before it is asked why.
EARLY_ROWS = 0.6
#: Episodes on which that is asked: every rival is a replay of them.
EARLY_LOOK = 4
#: How near to whole steps a lateness of more than one is called a possible miscount.
WHOLE_ROWS = 0.1
#: Share of the difference to the scene's joints that may be left when they are taken as that late.
MOSTLY_LATE = 0.2
#: RMS difference [rad or m] to the scene's joints, and its ratio to that of the better episodes, beyond which an
#: episode is broken (effects gave at most 0.04 on the built-in hand, broken channels 0.4 and more), and the share of
#: such episodes, or of those that the scene cannot be stepped through, beyond which nothing is diagnosed.
STRANGE, STRANGER, MANY = 0.3, 10.0, 0.25
#: Longest delay that effects explain [s] (the bound of `actuation_delay`).
LATEST_S = 0.15
#: What makes joints react earlier than modelled: lighter damping, a stiffer servo, another clock; near enough to one
#: another that the nearest is a better account of what lies between than a shift. (Of a clock slow by 0.57 %, -1.5 %
#: was a worse one than two steps.)
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


@dataclass(frozen=True)
class _Look:
    """The episodes that are looked at, and where the scene's joints and forces go, open loop."""

    replayer: Replayer
    recs: Recordings
    pairs: Paired | None

    def play(self, recs: Recordings, effects: EffectSet = ()) -> dict[str, Array]:
        """Return the readings of the scene under recorded commands from the recorded starts."""
        return dict(self.played(recs, effects).readings)

    def another(self, recs: Recordings) -> dict[str, Array]:
        """Return the readings of the scene under other recordings: their commands, from their starts."""
        return _Look(self.replayer, recs, None).play(recs)

    def played(self, recs: Recordings, effects: EffectSet = ()) -> Trajectory:
        """Return what the scene does under recorded commands from the recorded starts."""
        scene, begin = self.replayer.scene, starts(self.replayer.scene, self.recs)
        played = rollout(
            scene, recs.commands, begin.qpos0, begin.qvel0, [effects] * len(recs), instant_force=recs.instant_force,
            memory=begin.memory0,
            threads=self.replayer.threads,
        )  # fmt: skip
        self.replayer.count(len(recs) * recs.commands.shape[1] * scene.substeps)
        return played


def mismatch(replayer: Replayer, recs: Recordings) -> tuple[RecordingMismatch, ...]:
    """Return what in the recordings is no physics; definite findings first, see `compared`."""
    return compared(replayer, recs).findings


def compared(replayer: Replayer, recs: Recordings) -> Comparison:
    """Return what in the recordings is no physics, and which mistakes they do not tell.

    First what the arrays alone tell; only where these are sound, open-loop replays of a few episodes.

    Parameters
    ----------
    replayer : Replayer
    recs : Recordings
        E recorded episodes.
    """
    scene = replayer.scene
    some = recs.take(_drawn(len(recs), LOOKED_AT))
    pairs = paired(scene, some)
    found = pose_findings(scene, recs) + range_findings(scene, recs, paired(scene, recs))
    played = Comparison(())
    if pairs is not None and not any(f.definite for f in found):
        units = unit_findings(scene, pairs)
        found += (_exchanged(_Look(replayer, some, pairs)) if units else []) or units
        found += still_findings(some, pairs)
    if not any(f.definite for f in found) and not is_toss(scene):
        played = _by_replay(_Look(replayer, some, pairs))
    found = [*found, *played.findings, *_tasks(recs)]
    # What is wrong leaves the rest of the recordings with little to say.
    undecidable = () if any(f.definite for f in found) else played.undecidable
    return Comparison(tuple(sorted(found, key=lambda f: not f.definite)), undecidable)


def _exchanged(look: _Look) -> list[RecordingMismatch]:
    """Return that joints or commands are exchanged, where some follow their own at another unit's factor.

    A slide that follows the command of a hinge moves by another number than it, which is no unit.
    """
    if look.pairs is None:
        return []
    own = look.play(look.recs).get("joint_position")
    return [] if own is None else _swapped(look, look.pairs, own[..., look.pairs.drive.joints])


def _drawn(count: int, most: int) -> NDArray[np.int64]:
    """Return the numbers of at most `most` of `count` episodes, one at random from each of as many equal stretches.

    Evenly spaced ones would miss, or hold only, what every other episode has.
    """
    ends = np.linspace(0, count, min(most, count) + 1)
    inside = np.random.default_rng(0).uniform(ends[:-1], ends[1:])
    return np.unique(np.minimum(inside.astype(int), count - 1))


def _evenly(count: int, most: int) -> NDArray[np.int64]:
    """Return the numbers of at most `most` of `count` episodes, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))


def _by_replay(look: _Look) -> Comparison:
    """Return what the scene's own motion tells."""
    scene, played = look.replayer.scene, look.played(look.recs)
    nominal = dict(played.readings)
    own = None
    if look.pairs is not None and "joint_position" in nominal:
        own = nominal["joint_position"][..., look.pairs.drive.joints]
        if sloped := slope_findings(look.pairs, own):
            # Joints that face each other run against the commands of each other.
            return Comparison(tuple(_swapped(look, look.pairs, own) or sloped))
    shaky = unstable_findings(scene, look.recs, played.failed, MANY)
    if any(f.definite for f in shaky):
        return Comparison(tuple(shaky))
    found = []
    if look.pairs is not None and own is not None:
        found += _swapped(look, look.pairs, own)
        found = found or _strangers(look, look.pairs, own)
        if any(f.definite for f in found):
            return Comparison(tuple(found))
        found += following_findings(look.pairs, own)
        if not found:
            found += zero_findings(scene, look.pairs, own)
    places = place_findings(scene, look.recs, look.pairs, nominal, look.another)
    if places.findings:
        return Comparison((*found, *places.findings))
    rows = 0.0
    if look.pairs is not None and own is not None and not any(f.kind == "scene_stuck" for f in found):
        found += _shifted(look, look.pairs, own)
        each = late(look.pairs, own)
        rows = float(np.median(each[np.isfinite(each)])) if np.isfinite(each).any() else 0.0
    timed, in_time = late_findings(scene, look.recs, nominal, rows)
    undecidable = (*places.undecidable, *timed.undecidable)
    if "fingertip_force" in nominal and "fingertip_force" in look.recs.readings:
        felt = _by_force(scene, look.recs, nominal["fingertip_force"])
        if not any(f.definite for f in felt):
            more = felt_findings(scene, in_time, nominal, look.another)
            felt, undecidable = list(more.findings) or felt, (*undecidable, *more.undecidable)
        found += felt
    wrong = {f.channel for f in found if f.definite}
    return Comparison((*found, *(note for note in timed.findings if note.channel not in wrong), *shaky), undecidable)


def _by_force(scene: Scene, recs: Recordings, force: Array) -> list[RecordingMismatch]:
    """Return what fingertips tell that the scene's, `(E, T, F, 3)`, do not: frames, unit, order, directions."""
    touching = touches(scene, recs, force)
    if touching is not None and (far := distance_findings(scene, touching)):
        return far
    found = scale_findings(scene, recs, force)
    if any(f.definite for f in found):
        return found
    found += exchange_findings(scene, recs, force)
    if any(f.definite for f in found) or touching is None:
        return found
    turned = force_findings(scene, touching)
    if turned and (rival := exchange_rivals(scene, recs, force)):
        words, fix = (
            f"{turned[0].found}; or fingertips are exchanged: {rival}",
            f"{turned[0].fix}, or put columns in order",
        )
        turned = [replace(turned[0], found=words, fix=fix), *turned[1:]]
    return found + turned


def _swapped(look: _Look, pairs: Paired, own: Array) -> list[RecordingMismatch]:
    """Return that commands or joints are in another order, where the scene agrees: with it its joints come closer."""
    drive = pairs.drive
    found: list[Swap] = []
    for chosen in swaps(pairs):
        if any(overlap(chosen, one.chosen) for one in found):
            continue
        commands, joint = look.recs.commands.copy(), look.recs.readings["joint_position"].copy()
        commands[..., drive.columns] = (pairs.target[..., chosen] - drive.offset) / drive.slope
        joint[..., drive.joints] = ordered(pairs.joint, chosen)
        others = (
            replace(look.recs, commands=commands),
            replace(look.recs, readings=look.recs.readings | {"joint_position": joint}),
        )
        plays = (_Look(look.replayer, r, None).play(r)["joint_position"][..., drive.joints] for r in others)
        if one := confirmed(pairs, chosen, own, *plays):
            found.append(one)
    return swap_findings(pairs, look.recs, found)


def _strangers(look: _Look, pairs: Paired, own: Array) -> list[RecordingMismatch]:
    """Return that the joints of some episodes do not belong to their commands, while those of others do.

    Sure where many are such, unless they move otherwise in all episodes of some tasks that are looked at and in none of
    another: joints may be too weak for that motion. (With 0.12 N m, a heavier rotor and less damping those of fast
    sweeps were refused.) What is a constant off is no weakness.
    """
    apart, every = pairs.joint - own, np.ones(len(pairs.names), bool)
    off, swing = distances(apart, every), distances(apart - np.nanmedian(apart, axis=1, keepdims=True), every)
    strange = (off > STRANGE) & (off > STRANGER * np.quantile(off, 0.25))
    if not strange.any():
        return []
    names = [name for name, s in zip(look.recs.ids, strange, strict=True) if s]
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return [RecordingMismatch(
        "broken_episodes",
        bool(strange.mean() >= MANY and not (_by_task(look.recs.tasks, strange) and (2 * swing > off)[strange].all())),
        "joints and commands of some episodes do not belong together",
        f"joints within {STRANGE:g} rad or m of where the commands take the scene's, as in the others",
        f"{len(names)} of {len(off)} episodes looked at: {', '.join(names[:6])}{more}",
        "leave them out with `candata registry filter`, or mend their channels", "joint_position",
    )]  # fmt: skip


def _by_task(tasks: Sequence[str], some: NDArray[np.bool_]) -> bool:
    """Tell whether some episodes `(E,)` are all those of their named tasks, two or more of each."""
    inside, outside = ([tasks[int(i)] for i in np.flatnonzero(kind)] for kind in (some, ~some))
    return not set(inside) & set(outside) and all(t and inside.count(t) > 1 for t in inside)


def _shifted(look: _Look, pairs: Paired, own: Array) -> list[RecordingMismatch]:
    """Return that joints react before their commands, or as late as a step that was counted wrong."""
    each = late(pairs, own)
    each = each[np.isfinite(each)]
    if not len(each):
        return []
    rows, rate = float(np.median(each)), look.replayer.scene.file.rate_hz
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
    some = _evenly(len(look.recs), EARLY_LOOK)
    recs = look.recs.take(some)
    return _early(_Look(look.replayer, recs, None), paired(look.replayer.scene, recs) or pairs, own[some], rows)


def _only_later(joint: Array, own: Array, steps: int) -> bool:
    """Tell whether joints `(E, T, J)` do what the scene's do, but later: a weak or damped servo also does less."""
    every = np.ones(joint.shape[2], bool)
    shifted, before = distances(joint[:, steps:] - own[:, :-steps], every), distances(joint - own, every)
    return bool(np.median(shifted) < MOSTLY_LATE * np.median(before))


def _lateness(rows: float, rate: float, words: str) -> RecordingMismatch:
    """Return the note that joints react late."""
    return RecordingMismatch(
        "shifted_commands", False, "joints react later than the scene's", "the scene's delay",
        f"{rows:.1f} steps ({1e3 * rows / rate:.0f} ms)", words, "action",
    )  # fmt: skip


def _early(look: _Look, pairs: Paired, own: Array, rows: float) -> list[RecordingMismatch]:
    """Return that commands are logged late: sure where no servo and no clock explains it as well as a shift.

    Nothing where one of them explains it better.
    """
    steps, joints = max(1, round(-rows)), pairs.drive.joints
    moved = replace(look.recs, commands=_ahead(look.recs.commands, steps))
    shift = _apart(pairs, look.play(moved)["joint_position"][..., joints])
    scene = look.replayer.scene
    # The coordinate of a positive number is its logarithm.
    strongest = float(np.exp(candidate("torque_limit", scene).neutral[0]))
    stronger = (("torque_limit", "limit_Nm", share * strongest) for share in STRONGER)
    possible = [r for r in (*RIVALS, *stronger) if effect(r[0]).possible(scene)]
    sets = [(EffectSetting(name=n, parameters={p: v}),) for n, p, v in possible]
    rival, ahead = _apart(pairs, own), iter(sets)
    while rival >= SURELY * shift and (some := next(ahead, None)):
        rival = min(rival, _apart(pairs, look.play(look.recs, some)["joint_position"][..., joints]))
    if rival < SURELY * shift:
        return []
    sure = shift < SURELY * rival
    one = "`action: previous` in map.yaml, if each row holds the command before it" if steps == 1 else ""
    fix = one or f"move the commands {steps} steps ahead"
    return [RecordingMismatch(
        "shifted_commands", sure, "joints react earlier than the scene's, as if commands were logged late",
        "commands that come first", f"{-rows:.1f} steps early",
        fix if sure else f"a faster servo or clock explains it as well; else: {fix}", "action",
    )]  # fmt: skip


def _ahead(commands: Array, steps: int) -> Array:
    """Return commands moved to `steps` rows earlier; the last is held."""
    return np.concatenate([commands[:, steps:], np.repeat(commands[:, -1:], steps, axis=1)], axis=1)


def _apart(pairs: Paired, own: Array) -> float:
    """Return the median over moving joints of the RMS difference to `own (E, T, S)`, over each joint's spread."""
    size, spread = within(pairs.joint - own), within(pairs.joint)
    moving = spread > 5 * pairs.quiet + 1e-6
    return float(np.median(size[moving] / spread[moving])) if moving.any() else np.inf


def _tasks(recs: Recordings) -> list[RecordingMismatch]:
    """Return the note that no motion was repeated."""
    if len(recs) < 2 or not all(recs.tasks) or len(set(recs.tasks)) < len(recs):
        return []
    return [RecordingMismatch(
        "no_repeats", False, "every episode is a task of its own", "several episodes of each motion",
        f"{len(recs)} tasks in {len(recs)} episodes",
        "no motion is held out that was also searched: give like motions one task", "time_ns",
    )]  # fmt: skip


def checked(replayer: Replayer, recs: Recordings) -> Recordings:
    """Return the recordings with notes of what is doubtful or cannot be tested, joints that are dead left out.

    Raises
    ------
    DataError
        For the first finding that no effect explains: nothing is diagnosed from such recordings.
    """
    found = mismatch(replayer, recs)
    for finding in found:
        if finding.definite:
            raise finding.error()
    dead = [name for f in found if f.kind == "dead_joint" for name in f.elements]
    notes = (*recs.notes, *(f.note() for f in found))
    moving = not any(f.kind == "still" for f in found)
    kept = replace(left_out(replayer.scene, recs, dead), notes=notes, moving=moving)
    if moving:
        kept = without_object(replayer, kept)
    return replace(kept, notes=(*kept.notes, *untested_notes(replayer.scene, kept)))


def left_out(scene: Scene, recs: Recordings, names: Sequence[str]) -> Recordings:
    """Return recordings in which joints are held where they were read, and not compared.

    Their commands become the constant that holds them there; their readings end after the first tenth of a second,
    from which a replay starts.
    """
    pairs = paired(scene, recs)
    if not names or pairs is None:
        return recs
    commands, joint = recs.commands.copy(), recs.readings["joint_position"].copy()
    for name in names:
        s = pairs.names.index(name)
        drive, column = pairs.drive, pairs.drive.columns[s]
        held = np.nanmedian(pairs.joint[..., s], axis=1)
        commands[..., column] = ((held - drive.offset[s]) / drive.slope[s])[:, None]
        joint[:, STILL_ROWS:, drive.joints[s]] = np.nan
    return replace(recs, commands=commands, readings=recs.readings | {"joint_position": joint})
