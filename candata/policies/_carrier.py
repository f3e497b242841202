"""What carries the whole hand, rails, hinges or both, and the commands that move the hand along a path in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from candata.errors import ReachError, Where
from candata.policies import _drive as d
from candata.policies._chain import HAND_M, Chain, along_rails, follow
from candata.policies._contract import Array
from candata.policies._drive import Ids
from candata.scenes import Scene

#: How upright a direction must be to count as the one that lifts (cosine to the vertical).
UPRIGHT = 0.7
#: Least singular value [m] of a motion that counts as possible, and the least share (squared cosine) of a direction
#: that must lie among the possible motions. Chosen: below the first, a hand moves 5 cm for a radian of the joints.
LEAST_GAIN_M, LEAST_SHARE = 0.05, 0.99
#: How far the hand may be off its path [m, rad]. Chosen: half the width of a finger, and what a grasp forgives.
MOST_OFF_M, MOST_OFF_RAD = 0.010, np.deg2rad(5.0)
#: Draws of a way along the support before the hand counts as unable to go any. Chosen.
WAYS = 50
#: Command noise (1 sd) by which one rail moves the hand [m], and all hinges together move and turn it [m, rad]. Chosen:
#: the repeatability of a path of a light arm; the first is 0.4 % of a rail of 0.5 m.
NOISE_M, NOISE_RAD = 0.002, 0.004


@dataclass(frozen=True, eq=False)
class Carrier:
    """Servos that carry the whole hand, asked for motions of the hand in space.

    Attributes
    ----------
    scene : Scene
        The scene.
    columns : (n,) int64
        Columns of `action` that carry the hand: position servos of slides and hinges, from the base outwards.
    start : (A,) float64
        Commands of the open hand, at which the directions below hold.
    reach : (6,) bool
        Which way the hand can go from its start, all else held: along world x, y, z, and about them.
    axes : (R, 3) float64
        Independent directions of pure translation: those of the rails, or world axes.
    lift, away, stroke : (3,) float64, optional
        Unit vectors that lead up, away from the object, and along the support; None where the hand cannot go so.
    sideways : bool
        Whether `away` leads over the support, not up.
    noise : (n,) float64
        Most command noise of each column, 1 sd, in the command's unit.
    chain : Chain
        Its joints under the commands of the open hand.
    """

    scene: Scene
    columns: Ids
    start: Array
    reach: np.ndarray
    axes: Array
    lift: Array | None
    away: Array | None
    stroke: Array | None
    sideways: bool
    noise: Array
    chain: Chain

    @property
    def level(self) -> Array:
        """`(L, 3)` the directions of `axes` that do not lift."""
        return self.axes if self.lift is None else self.axes[np.abs(self.axes @ self.lift) <= UPRIGHT]

    def noise_of(self, hand_m: float) -> Array:
        """Return command noise `(n,)`, 1 sd, by which the hand moves by `hand_m` [m]."""
        return self.noise * (hand_m / NOISE_M)

    def commands(self, base: Array, path: Array) -> Array:
        """Return the commands `(T, A)` that move the hand along a path.

        Rails alone move by what the path asks along them, and stop at their ends as servos do. Hinges, or both, follow
        by inverse kinematics, within the limits of joints and commands; the posture depends on the place in the path
        alone, so a hand that comes back has its posture back.

        Parameters
        ----------
        base : (A,) float64
            Commands that are held; the columns of the carrier move from there.
        path : (T, 6) float64
            Displacement from the pose under `base`: translation [m, world axes], rotation vector about the mean of the
            fingertips [rad, world axes].

        Raises
        ------
        ReachError
            When hinges cannot follow: the hand would be off by more than 10 mm or 5 degrees.
        """
        out = np.repeat(np.asarray(base, float)[None], len(path), axis=0)
        if not path.any():
            return out
        chain = self.chain if np.array_equal(base, self.start) else Chain(self.scene, self.columns, base)
        if chain.slides.all():
            moves = along_rails(chain, path)
        else:
            moves, error = follow(chain, path)
            self._check(chain, moves, error)
        out[:, self.columns] += moves * chain.command_per_move
        return out

    def _check(self, chain: Chain, moves: Array, error: Array) -> None:
        """Refuse moves that leave the hand too far off its path."""
        off_m, off_rad = (np.linalg.norm(part, axis=1) for part in (error[:, :3], error[:, 3:] / HAND_M))
        worst = int(np.argmax(np.maximum(off_m / MOST_OFF_M, off_rad / MOST_OFF_RAD)))
        if off_m[worst] <= MOST_OFF_M and off_rad[worst] <= MOST_OFF_RAD:
            return
        is_at_end = (moves[worst] <= chain.low) | (moves[worst] >= chain.high)
        names = [self.scene.file.actuator_names[c] for c in self.columns[is_at_end]]
        raise ReachError(
            "what carries the hand cannot follow its path",
            expected=f"within {1000 * MOST_OFF_M:.0f} mm and {np.rad2deg(MOST_OFF_RAD):.0f} degrees",
            found=f"{1000 * off_m[worst]:.0f} mm and {np.rad2deg(off_rad[worst]):.0f} degrees off after "
            f"{worst / self.scene.file.rate_hz:.2f} s, "
            + (
                f"{', '.join(names)} at the end of the range"
                if names
                else "at the end of its reach, no joint at a limit"
            ),
            where=Where(path=self.scene.name),
            fix="begin with the hand farther within its reach (keyframe `open`), or play a shorter motion",
        )


@lru_cache(maxsize=16)
def carrier(scene: Scene) -> Carrier:
    """Return what carries the hand of a scene, from the kinematics of its open hand and where the object stands."""
    start, servos = d.open_commands(scene), d.servos(scene)
    columns = np.array([c for c in d.carriers(scene) if servos[c]], int)
    columns = columns[np.argsort([scene.driven_joints[int(a)] for a in scene.actuator_ids[columns]])]
    chain = Chain(scene, columns, start)
    jacobian = chain.jacobian(*chain.place(np.zeros((1, len(columns))))[1:])[0]
    possible = _possible(jacobian)
    axes = _axes(chain, possible)
    return Carrier(
        scene,
        columns,
        start,
        np.diag(possible) > LEAST_SHARE,
        axes,
        *_roles(axes, chain.stand_off),
        _noise(chain, jacobian),
        chain,
    )


def _possible(jacobian: Array) -> Array:
    """Return the projection `(6, 6)` on the motions that joints can make, from their Jacobian `(6, n)`."""
    directions, gains, _ = np.linalg.svd(jacobian, full_matrices=False)
    able = directions[:, gains > LEAST_GAIN_M]
    return able @ able.T


def _axes(chain: Chain, possible: Array) -> Array:
    """Return `(R, 3)` directions of pure translation: the rails' where hinges add none, else world axes."""
    count = int((np.linalg.eigvalsh(possible[:3, :3]) > LEAST_SHARE).sum())
    rails = chain.axes * np.where(chain.command_per_move < 0, -1.0, 1.0)[:, None]
    if count <= chain.slides.sum():
        return rails[chain.slides]
    return np.eye(3)[np.diag(possible)[:3] > LEAST_SHARE]


def _roles(axes: Array, stand_off: Array) -> tuple[Array | None, Array | None, Array | None, bool]:
    """Return `lift`, `away`, `stroke` and `sideways` of directions `(R, 3)` for a hand that stands off so `(3,)`."""
    if not len(axes):
        return None, None, None, False
    upright, along = int(np.argmax(np.abs(axes[:, 2]))), axes @ stand_off
    away = int(np.argmax(np.abs(along)))
    level = [i for i in range(len(axes)) if abs(axes[i, 2]) <= UPRIGHT]
    stroke = next((i for i in [*(i for i in level if i != away), *level]), None)
    return (
        _sign(axes[upright, 2]) * axes[upright] if abs(axes[upright, 2]) > UPRIGHT else None,
        _sign(along[away]) * axes[away],
        None if stroke is None else -_sign(along[stroke], zero=-1.0) * axes[stroke],
        away in level,
    )


def _sign(number: float, zero: float = 1.0) -> float:
    """Return +1 or -1; `zero` for none."""
    return float(np.sign(number)) or zero


def _noise(chain: Chain, jacobian: Array) -> Array:
    """Return `(n,)` the command noise with which each rail, and all hinges together, move the hand as `NOISE_M` says.

    Parameters
    ----------
    chain : Chain
        The joints.
    jacobian : (6, n) float64
        Of the open hand.
    """
    moving, turning = np.linalg.norm(jacobian[:3], axis=0), np.linalg.norm(jacobian[3:], axis=0) / HAND_M
    by_joint = np.minimum(NOISE_M / np.maximum(moving, 1e-9), NOISE_RAD / np.maximum(turning, 1e-9))
    together = np.where(chain.slides, 1.0, np.sqrt(max(1, (~chain.slides).sum())))
    return by_joint / together * np.abs(chain.command_per_move)


def can_follow(scene: Scene, path: Array) -> bool:
    """Tell whether what carries the hand can follow a path `(T, 6)`."""
    hand, limits = carrier(scene), d.command_range(scene)
    try:
        commands = hand.commands(hand.start, path)
    except ReachError:
        return False
    return bool(((limits[:, 0] <= commands) & (commands <= limits[:, 1])).all())


def reachable_way(
    scene: Scene,
    rng: np.random.Generator,
    corners: Array,
    direction: Callable[[], Array],
    range_m: tuple[float, float],
    verb: str,
) -> Array:
    """Return a way along the support `(3,)` [m]: the first draw that the hand can follow.

    Parameters
    ----------
    scene : Scene
    rng : numpy.random.Generator
        Source of the distance.
    corners : (T, 6) float64
        Places of the hand that are moved by the way, see `Carrier.commands`.
    direction : callable
        Draws a direction `(3,)` of any length.
    range_m : (float, float)
        Least and greatest distance [m].
    verb : str
        What the hand does with the object, for the error.

    Raises
    ------
    ReachError
        When the hand can follow none of `WAYS` draws.
    """
    for _ in range(WAYS):
        drawn = direction()
        way = rng.uniform(*range_m) * drawn / np.linalg.norm(drawn)
        if can_follow(scene, corners + np.concatenate([way, np.zeros(3)])):
            return way
    raise ReachError(
        f"the hand cannot {verb} the object along its support",
        expected=f"room for at least {1000 * range_m[0]:.0f} mm",
        found=f"none in {WAYS} draws of a direction and a distance",
        where=Where(path=scene.name),
        fix="begin with the hand farther within its reach (keyframe `open`)",
    )
