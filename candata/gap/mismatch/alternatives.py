"""Alternative readings: poses conjugated or mirrored, joints and fingertips exchanged, forces turned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.commands import Paired
from candata.scenes import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Alternative:
    """A way to read recordings other than as given.

    Attributes
    ----------
    kind, channel : str
        As in `Finding`.
    problem : str
        What is wrong if the alternative holds.
    words : str
        The alternative, after "as if".
    fix : str
        What to do if it holds.
    recs : Recordings
        The recordings read that way.
    elements : tuple of str
        Joints or fingertips concerned; empty for all.
    name : str
        What it is called where the recordings cannot decide; empty where a sibling is named for it.
    moves : bool
        Whether the scene does something else under it, so that it must be played again.
    """

    kind: str
    channel: str
    problem: str
    words: str
    fix: str
    recs: Recordings
    elements: tuple[str, ...] = ()
    name: str = ""
    moves: bool = True


def pose_alternatives(recs: Recordings) -> Iterator[Alternative]:
    """Yield alternatives for the object's poses: conjugated quaternions, left-handed worlds."""
    pose = recs.readings["object_pose"]
    turn = np.array([1, 1, 1, 1, -1, -1, -1.0])
    yield Alternative(
        "conjugated_quaternions",
        "object_pose",
        "quaternions of object_pose turn from the world to the body",
        "they were conjugated",
        "conjugate them before the import: the signs of x, y and z change",
        _posed(recs, pose * turn),
        name="conjugated quaternions",
    )
    for words, mirrored, fix in _mirrors(pose):
        yield Alternative(
            "left_handed_world",
            "object_pose",
            "object_pose is in a left-handed world",
            words,
            fix,
            _posed(recs, mirrored),
            name=f"a left-handed world, {words.removeprefix('its ').replace(' were', '')}",
        )
        places = np.concatenate([mirrored[..., :3], pose[..., 3:]], axis=-1)
        yield Alternative(
            "left_handed_world",
            "object_pose",
            "places of object_pose are in a left-handed world, its turns are not",
            f"{words} in the places alone",
            fix,
            _posed(recs, places),
        )


def _mirrors(pose: Array) -> Iterator[tuple[str, Array, str]]:
    """Yield what was done to the axes in words, the poses with that undone, and what to do.

    A left-handed world has one axis reversed, or two exchanged. A mirror turns a rotation's axis as it does
    places, and its angle the other way (Goldstein 1980, section 4-2).
    """
    for k, axis in enumerate("xyz"):
        sign = np.ones(3)
        sign[k] = -1
        others = ", ".join(f"q{a}" for a in "xyz" if a != axis)
        yield (
            f"its {axis} axis were reversed",
            pose * np.r_[sign, 1, -sign],
            f"change the signs of p{axis}, {others}",
        )
    for a, b in combinations(range(3), 2):
        order = np.arange(3)
        order[[a, b]] = order[[b, a]]
        names = f"{'xyz'[a]} and {'xyz'[b]}"
        mirrored = np.concatenate([pose[..., order], pose[..., 3:4], -pose[..., 4 + order]], axis=-1)
        yield (
            f"its axes {names} were exchanged",
            mirrored,
            f"exchange the columns of {names} of place and quaternion, and change the signs of qx, qy and qz",
        )


def _posed(recs: Recordings, pose: Array) -> Recordings:
    """Return the recordings with other poses."""
    return replace(recs, readings=recs.readings | {"object_pose": pose})


def count_pairs(scene: Scene, pairs: Paired) -> int:
    """Return how many pairs of driven joints are of a kind."""
    kinds = scene.model.jnt_type[scene.joint_ids[pairs.drive.joints]]
    return sum(int(a == b) for a, b in combinations(kinds, 2))


def pair_alternatives(scene: Scene, recs: Recordings, pairs: Paired) -> Iterator[Alternative]:
    """Yield alternatives in which two joints of a kind, and their commands, take the place of each other."""
    drive, kinds = pairs.drive, scene.model.jnt_type[scene.joint_ids[pairs.drive.joints]]
    for a, b in combinations(range(len(drive.joints)), 2):
        if kinds[a] != kinds[b]:
            continue
        joint, commands = recs.readings["joint_position"].copy(), recs.commands.copy()
        for values, columns in ((joint, drive.joints[[a, b]]), (commands, drive.columns[[a, b]])):
            values[..., columns] = values[..., columns[::-1]]
        names = (pairs.names[a], pairs.names[b])
        yield Alternative(
            "swapped_pairs",
            "joint_position",
            "joints and their commands are in another order than the scene's",
            f"the columns of {names[0]} and {names[1]} were exchanged in joint_position and action",
            "put the columns of both in the order of `joints` and `actuators` in scene.yaml, or name them",
            replace(recs, commands=commands, readings=recs.readings | {"joint_position": joint}),
            names,
            name="joints exchanged together with their commands",
        )


def force_alternatives(scene: Scene, recs: Recordings) -> Iterator[Alternative]:
    """Yield alternatives for the forces, which the scene need not play again: sign, axes, two fingertips exchanged."""
    force, tips = recs.readings["fingertip_force"], scene.file.fingertips
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if order == (0, 1, 2) and signs == (1.0, 1.0, 1.0):
            continue
        negated, reordered = order == (0, 1, 2) and signs == (-1.0, -1.0, -1.0), signs == (1.0, 1.0, 1.0)
        axes = " ".join(("-" if s < 0 else "") + "xyz"[k] for k, s in zip(order, signs, strict=True))
        yield Alternative(
            "force_sign" if negated else "force_frame",
            "fingertip_force",
            "fingertip_force is not the force on the fingertip in its own frame",
            "their sign were the other" if negated else f"their columns x y z held {axes}",
            "turn them into the fingertips' frames, or give these as `fingertip_frames` in scene.yaml",
            _felt(recs, force[..., list(order)] * np.array(signs)),
            name="forces of the other sign" if negated else "axes of the forces in another order" * reordered,
            moves=False,
        )
    for a, b in combinations(range(len(tips)), 2):
        columns = np.arange(len(tips))
        columns[[a, b]] = b, a
        yield Alternative(
            "swapped_fingertips",
            "fingertip_force",
            "forces are in another order than the scene's fingertips",
            f"{tips[a]} and {tips[b]} were exchanged",
            "put the columns of `fingertip_force` in the order of `fingertips` in scene.yaml, or name them",
            _felt(recs, force[:, :, columns]),
            (tips[a], tips[b]),
            name=f"fingertips {tips[a]} and {tips[b]} exchanged",
            moves=False,
        )


def _felt(recs: Recordings, force: Array) -> Recordings:
    """Return the recordings with other forces."""
    return replace(recs, readings=recs.readings | {"fingertip_force": force})
