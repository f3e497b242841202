"""Episodes of a random small scene: settled, played, cut where they begin, checked."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.rigs.design import Rig, draw_rig
from candata.gap.blind.rigs.motions import commands
from candata.gap.blind.rigs.player import Log, World, play, settled
from candata.gap.blind.rigs.situations import TOUCHED

Array = NDArray[np.float64]
#: Rows played at rest before an episode begins, and the length of a log before a cut [s].
LEAD_ROWS, CUT_S = 3, (0.3, 0.8)
#: How far the object's place is off by, 1 sd [m] and [rad]; of a gripped one less.
PLACE_M, PLACE_RAD = 0.002, 0.06
#: What no sane scene exceeds: travel of the object [m], its speed [m/s], its least and largest height [m], a force [N].
#: Chosen: what a table-top rig could be recorded at.
FAR_M, FAST_M_S, LOW_M, HIGH_M, STRONG_N = 0.25, 1.5, -0.02, 0.3, 60.0
#: How far at least one joint moves [rad], [m]; speed of a joint that is in motion [rad/s], [m/s].
MOVES_RAD, MOVES_M, MOVING_RADPS, MOVING_M_S = 0.1, 0.005, 0.05, 0.005
#: A fingertip feels something from here on [N].
FELT_N = 0.05
#: Draws of a scene before its trait is given up.
TRIES = 200


class Outline(NamedTuple):
    """What an episode is to be: its commands before and while it is recorded, and where the object is put down."""

    actions: Array
    lead: int
    placed: Array


def outlines(rig: Rig, rng: np.random.Generator) -> list[Outline]:
    """Return the outline of each episode: tasks take turns, each with its own commands; cuts fall anywhere."""
    rate = rig.file.rate_hz
    seeds = rng.integers(2**62, size=rig.tasks)
    leads = [round(rng.uniform(*CUT_S) * rate) if rig.cut else LEAD_ROWS for _ in range(rig.episodes)]
    grips = rig.situation in ("pinched", "held", "lifted", "carried")
    size = np.array([PLACE_M, PLACE_M, PLACE_RAD]) * (0.3 if grips else 1.0)
    rolls = rig.thing is not None and rig.thing.kind in ("ball", "roller")
    places = rng.standard_normal((max(rig.episodes, rig.tasks), 3)) * size * (not rolls or np.array([1, 1, 0]))
    out = []
    for i, lead in enumerate(leads):
        task = i % rig.tasks
        actions = commands(rig, np.random.default_rng(seeds[task]), max(leads))
        actions = actions[: lead + rig.rows] if rig.cut else actions[max(leads) - lead :]
        out.append(Outline(actions, lead, places[i if rig.jitter else task]))
    return out


def logs(world: World, rig: Rig, some: Sequence[Outline]) -> list[Log] | None:
    """Return what an ideal rig records of each outline, its lead included; None where one does not come to rest.

    Equal outlines are played once.
    """
    out: list[Log] = []
    known: dict[bytes, Log] = {}
    for one in some:
        key = one.actions.tobytes() + one.placed.tobytes()
        if key not in known:
            state = settled(world, rig, one.placed)
            if state is None:
                return None
            known[key] = play(world, rig.file, state, one.actions)
        out.append(known[key])
    return out


def nominal(rig: Rig) -> World:
    """Return the world of the scene's own model.

    Raises
    ------
    ValueError
        When MuJoCo cannot compile the text.
    """
    return World(mujoco.MjModel.from_xml_string(rig.xml))


def trimmed(log: Log, lead: int) -> Log:
    """Return the log from the row on at which its episode begins."""
    substeps = 0 if log.fine is None else (len(log.fine) - 1) // len(log.joint)
    return log._replace(
        joint=log.joint[lead:],
        pose=None if log.pose is None else log.pose[lead:],
        force=log.force[lead:],
        action=log.action[lead:],
        fine=None if log.fine is None else log.fine[lead * substeps :],
        touched=log.touched[lead:],
        speed=log.speed[lead:],
        states=log.states[lead:],
    )


class Drawn(NamedTuple):
    """A sane scene with the outlines of its episodes and what an ideal rig records of them."""

    rig: Rig
    outlines: list[Outline]
    logs: list[Log]


def sane_rig(seed: int, trait: str, episodes: int, duration_s: float | None = None) -> Drawn:
    """Return the first sane scene that a seed draws for a trait.

    A drawn scene is not sane where MuJoCo warns, something flies off or out of reach, nothing moves, an episode does
    not begin at rest (or, when it is cut, in motion), or what its situation promises does not happen; it is drawn again
    with the next random numbers then.

    Parameters
    ----------
    seed : int
        Decides everything.
    trait : str
        One of `all_traits()`.
    episodes : int
    duration_s : float, optional
        Length of an episode; drawn by default.
    """
    for attempt in count():
        rng = np.random.default_rng([seed, attempt])
        rig = draw_rig(rng, trait, episodes, duration_s)
        found = _attempt(rig, rng)
        if found is not None:
            return found
        if attempt >= TRIES:
            raise RuntimeError(f"no sane scene of trait {trait} in {TRIES} draws of seed {seed}")
    raise AssertionError("unreachable")


def _attempt(rig: Rig, rng: np.random.Generator) -> Drawn | None:
    """Return a drawn scene played, or None where it is not sane."""
    if (rig.trait == "mimic" and not rig.follows) or (rig.trait == "spring" and "_flex" not in rig.xml):
        return None
    try:
        world = nominal(rig)
    except ValueError:
        return None
    some = outlines(rig, rng)
    first = logs(world, rig, some[:1])
    if first is None or problem(rig, some[:1], first):
        return None
    found = logs(world, rig, some)
    return None if found is None or problem(rig, some, found) else Drawn(rig, some, found)


def problem(rig: Rig, some: Sequence[Outline], found: Sequence[Log]) -> str:
    """Return what is not sane in recordings of a scene; empty where all is."""
    cut = [trimmed(log, one.lead) for one, log in zip(some, found, strict=True)]
    if any(log.warned or not np.isfinite(log.joint).all() for log in found):
        return "MuJoCo warned"
    slides = np.array([_slides(rig, j) for j in rig.file.joints])
    if np.abs(np.concatenate([log.joint for log in found])).max() > np.pi:
        return "a joint turned away"
    span = np.max([np.ptp(log.joint, axis=0) for log in cut], axis=0)
    if not (span > np.where(slides, MOVES_M, MOVES_RAD)).any():
        return "nothing moves"
    if max((float(np.abs(log.force).max(initial=0.0)) for log in found), default=0.0) > STRONG_N:
        return "a force is too large"
    return _object_problem(rig, found) or _begin_problem(rig, cut, slides) or _promise(rig, cut)


def _slides(rig: Rig, joint: str) -> bool:
    """Tell whether a recorded joint slides."""
    return next(d.servo.slides for d in rig.drives if d.servo.joint == joint)


def _object_problem(rig: Rig, found: Sequence[Log]) -> str:
    """Return what is not sane about the object's path."""
    for log in found:
        if log.pose is None:
            continue
        place = log.pose[:, :3]
        if np.linalg.norm(place - place[0], axis=1).max() > FAR_M or place[:, 2].min() <= LOW_M:
            return "the object leaves"
        if place[:, 2].max() > HIGH_M:
            return "the object is thrown"
        if np.linalg.norm(np.diff(place, axis=0), axis=1).max() * rig.file.rate_hz > FAST_M_S:
            return "the object is flung"
    return ""


def _begin_problem(rig: Rig, cut: Sequence[Log], slides: NDArray[np.bool_]) -> str:
    """Return what is not sane about how episodes begin."""
    limit = np.where(slides, MOVING_M_S, MOVING_RADPS)
    starts = [np.abs(log.joint[1] - log.joint[0]) * rig.file.rate_hz > limit for log in cut]
    moving = np.array([s.any() for s in starts])
    if rig.cut:
        return "" if moving.mean() >= 0.5 else "too few episodes begin in motion"
    return "an episode begins in motion" if moving.any() else ""


def _promise(rig: Rig, cut: Sequence[Log]) -> str:
    """Return what a situation promises that does not happen."""
    touched = np.array([log.touched.any() for log in cut])
    if rig.situation in TOUCHED and touched.mean() < 0.5:
        return "the object is not touched"
    if rig.situation in ("rest", "meeting", "pressing") and touched.any():
        return "the object is touched"
    if rig.situation in ("meeting", "pressing") and rig.file.fingertips:
        felt = np.array([np.abs(log.force).max() > FELT_N for log in cut])
        return "" if felt.mean() >= 0.5 else "no fingertip feels anything"
    if rig.situation == "lifted":
        rise = np.mean([np.ptp(log.pose[:, 2]) > 0.006 for log in cut if log.pose is not None])
        return "" if rise >= 0.5 else "the object is not lifted"
    return ""
