"""The whole of a random small scene as MJCF text."""

from __future__ import annotations

import numpy as np

from candata.gap.blind.rigs.fingers import SPRING_RATIO
from candata.gap.blind.rigs.hands import Hand
from candata.gap.blind.rigs.servos import GRAVITY_M_S2, Drive
from candata.gap.blind.rigs.situations import Situation, Thing
from candata.gap.blind.rigs.text import chance, tag, uniform


def scene_xml(
    rng: np.random.Generator,
    trait: str,
    situation: Situation,
    step: float,
    thing: Thing | None,
    hand: Hand,
    drives: tuple[Drive, ...],
    table: bool,
) -> str:
    """Return the MJCF of a scene."""
    option = tag(
        "option",
        timestep=step,
        integrator=str(rng.choice(["Euler", "implicitfast"])),
        cone=str(rng.choice(["pyramidal", "elliptic"])),
    )
    world = (
        tag("geom", name="table", type="plane", size=(1.0, 1.0, 0.1), friction=(uniform(rng, 0.3, 1.0), 0.005, 0.0001))
        if table
        else ""
    )
    world += _object_xml(rng, situation, thing) if thing else ""
    fingers = hand.xml
    if trait == "free_base":
        fingers = _based(rng, fingers, sum(f.mass for f in hand.fingers), table)
    ties = "".join(
        tag(
            "joint",
            joint1=a,
            joint2=b,
            polycoef=(0.0, ratio, 0.0, 0.0, 0.0),
            solref=(uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.4) else None,
        )
        for f in hand.fingers
        for a, b, ratio in f.follows
    )
    motors = "".join(_motors(rng, trait, step, drives))
    return tag(
        "mujoco",
        tag("compiler", angle="radian")
        + option
        + tag("worldbody", world + fingers)
        + (tag("equality", ties) if ties else "")
        + tag("actuator", motors),
        model="small",
    )


def _object_xml(rng: np.random.Generator, situation: Situation, thing: Thing) -> str:
    """Return the object's body at its place: on the table, on the tray, or aside of fingers that need its room."""
    shapes = {"block": "box", "ball": "sphere", "can": "cylinder", "roller": "cylinder"}
    rolls = thing.kind in ("ball", "roller")
    geom = tag(
        "geom",
        name="shape",
        type=shapes[thing.kind],
        size=thing.half,
        mass=thing.mass,
        quat=(1.0, 1.0, 0.0, 0.0) if thing.kind == "roller" else None,  # a roller lies along y
        friction=(thing.friction, 0.005, uniform(rng, 0.0001, 0.001) if rolls else 0.0001),
        condim=6 if rolls and chance(rng, 0.7) else (4 if chance(rng, 0.15) else None),
        solref=(uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.25) else None,
    )
    aside = -0.12 if situation == "pressing" else 0.0
    lift = 0.06 if situation == "carried" else 0.0
    return tag("body", tag("freejoint") + geom, name="object", pos=(aside, 0.0, thing.middle + lift))


def _based(rng: np.random.Generator, fingers: str, mass: float, table: bool) -> str:
    """Return the fingers on a base that gives: sprung slides, a sprung ball, a sprung free joint, or a free block."""
    kind = str(rng.choice(["slides", "ball", "free", *(["block"] if table else [])]))
    base_mass = uniform(rng, 0.4, 1.5)
    total, height = base_mass + mass, 0.22
    omega, ratio = uniform(rng, 14.0, 30.0), uniform(rng, *SPRING_RATIO)
    stiffness, damping = total * omega**2, 2 * ratio * total * omega
    at = (0.0, 0.0, height)
    geom = tag("geom", type="box", size=(0.04, 0.04, 0.015), pos=at, mass=base_mass, contype=0, conaffinity=0)
    # Turning about the base's middle, at the height of the fingers' roots.
    turning = total * 0.05**2
    if kind == "slides":
        axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
        some = axes[: int(rng.integers(1, 4))]
        joints = "".join(
            tag("joint", name=f"base_{i}", type="slide", axis=axis, stiffness=stiffness, damping=damping)
            for i, axis in enumerate(some)
        )
    elif kind == "ball":
        stiff = max(turning * omega**2, 4 * total * GRAVITY_M_S2 * 0.1)
        joints = tag(
            "joint", name="base", type="ball", pos=at, stiffness=stiff, damping=2 * ratio * np.sqrt(stiff * turning)
        )
    elif kind == "free":
        joints = tag("joint", name="base", type="free", stiffness=stiffness, damping=damping)
    else:  # a free block stands beside, its arm carries the fingers
        heavy = uniform(rng, 2.5, 5.0)
        joints = tag("freejoint", name="base")
        geom = tag("geom", name="foot", type="box", size=(0.09, 0.09, 0.05), pos=(-0.38, 0.0, 0.05), mass=heavy)
    if kind == "free":  # its spring turns it about its frame's origin, which is therefore its middle
        return tag(
            "body",
            joints
            + tag("geom", type="box", size=(0.1, 0.1, 0.02), mass=base_mass, contype=0, conaffinity=0)
            + tag("body", fingers, pos=(0.0, 0.0, -height)),
            name="base_body",
            pos=at,
        )
    return tag("body", joints + geom + fingers, name="base_body")


def _motors(rng: np.random.Generator, trait: str, step: float, drives: tuple[Drive, ...]) -> list[str]:
    """Return the actuators' XML."""
    lag, general, delay = uniform(rng, 0.02, 0.08), chance(rng, 0.4), uniform(rng, 0.01, 0.06)
    smooth = chance(rng, 0.3)
    out = []
    for drive in drives:
        s = drive.servo
        ends = sorted((s.rest, s.away, s.toward))
        wide = 0.03 if s.slides else 0.3
        common = {"name": drive.name, "joint": s.joint, "forcerange": None if s.limit is None else (-s.limit, s.limit)}
        shown = (ends[0] - wide, ends[-1] + wide)
        if drive.integrates:
            out.append(tag("intvelocity", **common, kp=s.kp, kv=s.kv, actrange=shown))
        elif trait == "filtered" and general:
            out.append(
                tag(
                    "general",
                    **common,
                    dyntype="filter",
                    dynprm=lag,
                    gainprm=s.kp,
                    biastype="affine",
                    biasprm=(0.0, -s.kp, -s.kv),
                )
            )
        else:
            extra: dict[str, object] = {"timeconst": lag} if trait == "filtered" else {}
            if trait == "delayed":
                late = delay if smooth else step * max(round(delay / step), 1)
                extra = {
                    "delay": late,
                    "nsample": int(np.ceil(late / step)) + 2,
                    "interp": "linear" if smooth else None,
                }
            out.append(
                tag("position", **common, kp=s.kp, kv=s.kv, **extra, ctrlrange=shown if chance(rng, 0.4) else None)
            )
    return out
