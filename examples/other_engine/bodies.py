"""One small description of a three-finger gripper, a box and a table, written out for both engines.

All numbers are our own. Only the fingertips (balls), the box and the table collide; a fingertip never meets the table.
"""

from __future__ import annotations

from typing import NamedTuple


class Link(NamedTuple):
    """One joint and the link it moves: origin in the parent [m], axis, range, mass [kg], centre [m], inertia, servo.

    `tip` is where a fingertip's ball sits in the link [m]; kp, kv and limit are of the position servo (SI).
    """

    name: str
    parent: str
    kind: str
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    range: tuple[float, float]
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]
    kp: float
    kv: float
    limit: float
    tip: tuple[float, float, float] | None = None


def _finger(name: str, x: float, y: float) -> tuple[Link, Link]:
    """Return the two links of a finger that hangs from the palm at (x, y) and closes towards the middle."""
    axis = (0.0, -1.0 if x < 0 else 1.0, 0.0)
    upper = Link(
        f"{name}1",
        "z",
        "hinge",
        (x, y, -0.02),
        axis,
        (-0.5, 1.0),
        0.06,
        (0, 0, -0.025),
        (4e-5, 4e-5, 1e-5),
        2.0,
        0.06,
        0.8,
    )
    lower = Link(
        f"{name}2",
        f"{name}1",
        "hinge",
        (0, 0, -0.05),
        axis,
        (-0.5, 1.2),
        0.04,
        (0, 0, -0.03),
        (3e-5, 3e-5, 1e-5),
        1.5,
        0.03,
        0.5,
        tip=(0, 0, -0.045),
    )
    return upper, lower


RATE_HZ = 80.0
PALM_M = (0.0, 0.0, 0.15)
LINKS = (
    Link("x", "base", "slide", (0, 0, 0), (1, 0, 0), (-0.2, 0.2), 0.4, (0, 0, 0), (1e-3,) * 3, 2500.0, 90.0, 80.0),
    Link("z", "x", "slide", (0, 0, 0), (0, 0, 1), (-0.05, 0.25), 0.4, (0, 0, 0), (1e-3,) * 3, 2500.0, 90.0, 80.0),
    *_finger("left", -0.05, 0.025),
    *_finger("right", -0.05, -0.025),
    *_finger("thumb", 0.05, 0.0),
)
TIPS = tuple(link.name for link in LINKS if link.tip is not None)
TIP_RADIUS_M, TIP_FRICTION = 0.011, 0.8
BOX_HALF_M, BOX_MASS_KG, TABLE_FRICTION = (0.025, 0.035, 0.03), 0.15, 0.4
#: Sensor noise of the recordings, which the scene declares: its floor.
NOISE = "{object_pose: [0.0005, 0.004], joint_position: 0.001, fingertip_force: 0.02, force_step: 0.02}"


def box_inertia(mass: float) -> tuple[float, float, float]:
    """Return the principal moments of a solid box [kg m^2]."""
    x, y, z = (h * h for h in BOX_HALF_M)
    return mass / 3 * (y + z), mass / 3 * (x + z), mass / 3 * (x + y)


def _words(numbers: tuple[float, ...]) -> str:
    """Return numbers as XML has them."""
    return " ".join(f"{n:.9g}" for n in numbers)


def mjcf() -> str:
    """Return the scene as MJCF: MuJoCo's default contact, steps of 1.25 ms, implicit servos."""
    children: dict[str, list[Link]] = {}
    for link in LINKS:
        children.setdefault(link.parent, []).append(link)
    servos = "".join(
        f'<position name="{k.name}" joint="{k.name}" kp="{k.kp}" kv="{k.kv}" forcerange="{-k.limit} {k.limit}" '
        f'ctrlrange="{_words(k.range)}"/>'
        for k in LINKS
    )
    # A pair takes the larger friction of two geoms in MuJoCo: the box's own is never the larger.
    return f"""<mujoco><compiler angle="radian" autolimits="true"/>
<option timestep="0.00125" integrator="implicitfast"/>
<worldbody><light pos="0 -0.5 1"/>
<geom name="table" type="plane" size="0.5 0.5 0.05" friction="{TABLE_FRICTION} 0 0" contype="2" conaffinity="0"/>
<body name="base" pos="{_words(PALM_M)}">{"".join(_mjcf_body(k, children) for k in children["base"])}</body>
<body name="box" pos="0 0 {BOX_HALF_M[2]}"><freejoint/>
<inertial pos="0 0 0" mass="{BOX_MASS_KG}" diaginertia="{_words(box_inertia(BOX_MASS_KG))}"/>
<geom name="box" type="box" size="{_words(BOX_HALF_M)}" friction="0 0 0" contype="0" conaffinity="3" rgba=".2 .5 .7 1"/>
</body></worldbody><actuator>{servos}</actuator></mujoco>
"""


def _mjcf_body(link: Link, children: dict[str, list[Link]]) -> str:
    """Return one link and what hangs on it."""
    ball = ""
    if link.tip is not None:
        ball = (
            f'<geom name="{link.name}_tip" type="sphere" size="{TIP_RADIUS_M}" pos="{_words(link.tip)}" '
            f'friction="{TIP_FRICTION} 0 0" contype="1" conaffinity="0" rgba=".9 .5 .2 1"/>'
        )
    return (
        f'<body name="{link.name}" pos="{_words(link.origin)}">'
        f'<joint name="{link.name}" type="{link.kind}" axis="{_words(link.axis)}" range="{_words(link.range)}"/>'
        f'<inertial pos="{_words(link.centre)}" mass="{link.mass}" diaginertia="{_words(link.inertia)}"/>'
        f"{ball}{''.join(_mjcf_body(k, children) for k in children.get(link.name, []))}</body>"
    )


def roles() -> str:
    """Return `scene.yaml`."""
    names = ", ".join(link.name for link in LINKS)
    return f"""model: scene.xml
rate_hz: {RATE_HZ:g}
object: box
joints: [{names}]
actuators: [{names}]
fingertips: [{", ".join(TIPS)}]
support: table
noise: {NOISE}
"""


def urdf(damping_nms_rad: float = 0.0) -> str:
    """Return the gripper as URDF, with damping in its hinges."""
    parts = [
        '<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    ]
    for k in LINKS:
        kind, d = ("prismatic", 0.0) if k.kind == "slide" else ("revolute", damping_nms_rad)
        xx, yy, zz = k.inertia
        ball = ""
        if k.tip is not None:
            ball = (
                f'<collision><origin xyz="{_words(k.tip)}"/><geometry><sphere radius="{TIP_RADIUS_M}"/></geometry>'
                "</collision>"
            )
        parts.append(
            f'<link name="{k.name}"><inertial><origin xyz="{_words(k.centre)}"/><mass value="{k.mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>{ball}</link>'
            f'<joint name="{k.name}" type="{kind}"><parent link="{k.parent}"/><child link="{k.name}"/>'
            f'<origin xyz="{_words(k.origin)}"/><axis xyz="{_words(k.axis)}"/><dynamics damping="{d}" friction="0"/>'
            f'<limit lower="{k.range[0]}" upper="{k.range[1]}" effort="1000" velocity="1000"/></joint>'
        )
    return f'<robot name="gripper">{"".join(parts)}</robot>'
