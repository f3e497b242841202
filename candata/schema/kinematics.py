"""Kinematics of a hand: how its joints move points near the ends of its fingers, as plain values."""

from __future__ import annotations

from candata.schema.record import Record

Vector = tuple[float, float, float]


class JointScrew(Record):
    """One joint of a chain, as it stands where every joint is at its reference.

    Attributes
    ----------
    parent : int
        Index of the joint that carries it, which comes before it; -1 for none.
    axis, anchor_m : (3)
        Unit axis, and a point on it [m], both in the world.
    slides : bool
        Whether it moves along its axis; else it turns about it.
    joint : int
        Index into `joint_position` of the reading that moves it.
    gain, offset : float
        It moves by gain x reading + offset from its reference [rad or m].
    """

    parent: int
    axis: Vector
    anchor_m: Vector
    slides: bool
    joint: int
    gain: float = 1.0
    offset: float = 0.0


class TipPoint(Record):
    """A ball near the end of a fingertip: the joint that carries it (-1 for none), its centre at reference, radius."""

    carrier: int
    centre_m: Vector
    radius_m: float


class HandKinematics(Record):
    """The joints that move the fingertips of a hand whose place in the world its joints decide.

    Attributes
    ----------
    screws : tuple of JointScrew
        Each after the one that carries it.
    tips : tuple of TipPoint
        One a fingertip, in the order of `fingertip_force`.
    driven_joints : tuple of int
        Index into `joint_position` of the joint that each actuator drives to its command, in the order of `action`; -1
        where an actuator drives none.
    support_height_m : float or None
        Height of the support's top in the world; None without a support.
    """

    screws: tuple[JointScrew, ...]
    tips: tuple[TipPoint, ...]
    driven_joints: tuple[int, ...]
    support_height_m: float | None = None
