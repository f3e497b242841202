"""Mismatch: recordings that are not what scene and schema say, found before anything is called physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.data.testability import untested_notes
from candata.gap.mismatch.commands import Paired, late, paired, slope_findings, unit_findings
from candata.gap.mismatch.fingertip_exchange import exchange_findings, exchange_rivals
from candata.gap.mismatch.force_units import scale_findings
from candata.gap.mismatch.poses import pose_findings, without_object
from candata.gap.mismatch.ranges import range_findings
from candata.gap.mismatch.readings import felt_findings, place_findings
from candata.gap.mismatch.recording_mismatch import Comparison, RecordingMismatch
from candata.gap.mismatch.sensors import distance_findings, force_findings, touches
from candata.gap.mismatch.swaps import Swap, confirmed, distances, ordered, overlap, swap_findings, swaps
from candata.gap.mismatch.timing import SampleReplay, late_findings, shift_findings
from candata.gap.mismatch.tracking import following_findings, still_findings, unstable_findings, zero_findings
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.replayer import Replayer
from candata.scenes import Scene
from candata.scenes.traits import is_toss

Array = NDArray[np.float64]
#: Episodes that are played: a mismatch is in all of them, or in a part that shows among so many.
LOOKED_AT = 12
#: RMS difference [rad or m] to the scene's joints, and its ratio to that of the better episodes, beyond which an
#: episode is broken (effects gave at most 0.04 on the built-in hand, broken channels 0.4 and more), and the share of
#: such episodes, or of those that the scene cannot be stepped through, beyond which nothing is diagnosed.
STRANGE, STRANGER, MANY = 0.3, 10.0, 0.25
#: Fewest of them: a motor may be too weak for the motion of one. Chosen.
FEWEST_BROKEN = 2


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
        found += (_exchanged(SampleReplay(replayer, some, pairs)) if units else []) or units
        found += still_findings(some, pairs)
    if not any(f.definite for f in found) and not is_toss(scene):
        played = _by_replay(SampleReplay(replayer, some, pairs))
    found = [*found, *played.findings, *_tasks(recs)]
    # What is wrong leaves the rest of the recordings with little to say.
    undecidable = () if any(f.definite for f in found) else played.undecidable
    return Comparison(tuple(sorted(found, key=lambda f: not f.definite)), undecidable)


def _exchanged(look: SampleReplay) -> list[RecordingMismatch]:
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


def _by_replay(look: SampleReplay) -> Comparison:
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
        found += shift_findings(look, look.pairs, own)
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


def _swapped(look: SampleReplay, pairs: Paired, own: Array) -> list[RecordingMismatch]:
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
        plays = (SampleReplay(look.replayer, r, None).play(r)["joint_position"][..., drive.joints] for r in others)
        if one := confirmed(pairs, chosen, own, *plays):
            found.append(one)
    return swap_findings(pairs, look.recs, found)


def _strangers(look: SampleReplay, pairs: Paired, own: Array) -> list[RecordingMismatch]:
    """Return that the joints of some episodes do not belong to their commands, while those of others do.

    Sure where many are such, `FEWEST_BROKEN` at least, unless they move otherwise in all episodes of some tasks that
    are looked at and in none of another: joints may be too weak for that motion. What is a constant off is no weakness.
    """
    apart, every = pairs.joint - own, np.ones(len(pairs.names), bool)
    off, swing = distances(apart, every), distances(apart - np.nanmedian(apart, axis=1, keepdims=True), every)
    strange = (off > STRANGE) & (off > STRANGER * np.quantile(off, 0.25))
    if not strange.any():
        return []
    names = [name for name, s in zip(look.recs.ids, strange, strict=True) if s]
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return [
        RecordingMismatch(
            "broken_episodes",
            bool(
                strange.mean() >= MANY
                and strange.sum() >= FEWEST_BROKEN
                and not (_by_task(look.recs.tasks, strange) and (2 * swing > off)[strange].all())
            ),
            "joints and commands of some episodes do not belong together",
            f"joints within {STRANGE:g} rad or m of where the commands take the scene's, as in the others",
            f"{len(names)} of {len(off)} episodes looked at: {', '.join(names[:6])}{more}",
            "leave them out with `candata registry filter`, or mend their channels",
            "joint_position",
        )
    ]


def _by_task(tasks: Sequence[str], some: NDArray[np.bool_]) -> bool:
    """Tell whether some episodes `(E,)` are all those of their named tasks, two or more of each."""
    inside, outside = ([tasks[int(i)] for i in np.flatnonzero(kind)] for kind in (some, ~some))
    return not set(inside) & set(outside) and all(t and inside.count(t) > 1 for t in inside)


def _tasks(recs: Recordings) -> list[RecordingMismatch]:
    """Return the note that no motion was repeated."""
    if len(recs) < 2 or not all(recs.tasks) or len(set(recs.tasks)) < len(recs):
        return []
    return [
        RecordingMismatch(
            "no_repeats",
            False,
            "every episode is a task of its own",
            "several episodes of each motion",
            f"{len(recs)} tasks in {len(recs)} episodes",
            "no motion is held out that was also searched: give like motions one task",
            "time_ns",
        )
    ]


def checked(replayer: Replayer, recs: Recordings, reference: Recordings | None = None) -> Recordings:
    """Return the recordings with notes of what is doubtful or cannot be tested, joints that are dead left out.

    What contradicts the scene in the `reference` too is no news: nothing is said about it.

    Raises
    ------
    DataError
        For the first finding that no effect explains: nothing is diagnosed from such recordings.
    """
    known = {(f.kind, f.elements) for f in mismatch(replayer, reference)} if reference is not None else set()
    found = [f for f in mismatch(replayer, recs) if (f.kind, f.elements) not in known]
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
