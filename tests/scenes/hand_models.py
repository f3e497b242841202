"""Models in the manner of public hands, made here: what a new user brings."""

from __future__ import annotations

#: The four fingers of the hands, with where they stand in the palm [m].
FINGERS = {"ff": "0 .045 .02", "mf": "0 0 .02", "rf": "0 -.045 .02", "th": "-.03 .02 -.04"}
HEAD = '<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.002" integrator="implicitfast"/>'
CUBE = '<body name="cube" pos="0 0 .03"><freejoint/><geom name="cube" type="box" size=".03 .03 .03" mass=".1"/></body>'
FLOOR = '<geom name="floor" type="plane" size="1 1 .1"/>'


def finger(name: str, place: str, joints: int, tip: str = "", joint: str = "{name}j{i}") -> str:
    """A chain of links that bend; `tip` goes into the last one."""
    text = tip.format(name=name)
    for i in reversed(range(joints)):
        at = place if i == 0 else "0 0 .03"
        hinge = joint.format(name=name, i=i)
        text = (
            f'<body name="{name}_{i}" pos="{at}"><joint name="{hinge}" axis="0 1 0" range="-.3 1.6" damping=".05" '
            f'armature=".001"/><geom type="capsule" fromto="0 0 0 0 0 .03" size=".008" mass=".02"/>{text}</body>'
        )
    return text


def four_fingers(tip: str, joints: int = 4) -> str:
    """The four fingers of a hand."""
    return "".join(finger(name, place, joints, tip) for name, place in FINGERS.items())


def servos(names: list[str], of: str = "{name}") -> str:
    """Position servos of joints, called otherwise than the joints."""
    return "".join(
        f'<position name="{of.format(name=name)}" joint="{name}" kp="3" kv=".05" forcerange="-1 1"/>' for name in names
    )


def joints(count: int = 4) -> list[str]:
    """Names of the fingers' joints, in the order of the model."""
    return [f"{name}j{i}" for name in FINGERS for i in range(count)]


#: As the Allegro hand: a fixed palm, a body without a joint at each end, actuators with names of their own.
TIP_BODIES = (
    f'{HEAD}<worldbody><body name="palm" pos="0 0 .2"><geom type="box" size=".02 .05 .04"/>'
    + four_fingers('<body name="{name}_tip" pos="0 0 .03"><geom type="sphere" size=".012" mass=".005"/></body>')
    + f"</body></worldbody><actuator>{servos(joints(), '{name}_drive')}</actuator></mujoco>"
)
#: As the LEAP hand: the tip is a geom of the last link, beside one that only shows; a floor, an object, a target.
TIP_GEOMS = (
    f'{HEAD}<worldbody>{FLOOR}<body name="palm" pos="0 0 .3" quat="0 1 0 0"><geom type="box" size=".02 .05 .04"/>'
    + four_fingers(
        '<geom name="{name}_tip_visual" size=".013" pos="0 0 .03" contype="0" conaffinity="0" mass="0"/>'
        '<geom name="{name}_tip" size=".012" pos="0 0 .03" mass=".005"/>'
    )
    + f'</body>{CUBE}<body name="target" pos="0 0 .03"><freejoint/><geom type="box" size=".03 .03 .03" contype="0" '
    f'conaffinity="0"/></body></worldbody><actuator>{servos(joints())}</actuator></mujoco>'
)
#: As the Shadow hand: a wrist of two hinges, outer joints pulled with the middle ones by a tendon, sites on the tips,
#: names with a prefix.
TENDONS = (
    f'{HEAD}<worldbody><body name="rh:forearm" pos="0 0 .2"><geom type="box" size=".02 .02 .02"/>'
    '<body name="rh:wrist"><joint name="rh:WRJ1" axis="1 0 0" range="-.5 .5" armature=".01" damping=".1"/>'
    '<joint name="rh:WRJ0" axis="0 1 0" range="-.5 .5" armature=".01" damping=".1"/>'
    '<geom type="box" size=".02 .05 .02"/>'
    + "".join(
        finger(f"rh:{name}", place, 3, '<site name="{name}tip" pos="0 0 .03"/>', f"rh:{name.upper()}J{{i}}")
        for name, place in FINGERS.items()
    )
    + "</body></body></worldbody><tendon>"
    + "".join(
        f'<fixed name="{f}"><joint joint="{f}J1" coef="1"/><joint joint="{f}J2" coef="1"/></fixed>'
        for f in (f"rh:{name.upper()}" for name in FINGERS)
    )
    + f"</tendon><actuator>{servos(['rh:WRJ1', 'rh:WRJ0'])}"
    + "".join(
        f'<position name="rh:A_{f.upper()}0" joint="rh:{f.upper()}J0" kp="2" kv=".05"/>'
        f'<position name="rh:A_{f.upper()}1" tendon="rh:{f.upper()}" kp="2" kv=".05"/>'
        for f in FINGERS
    )
    + "</actuator></mujoco>"
)
#: An arm of four hinges that carries a hand of torque motors, over a table with a can and a mug.
ON_ARM = (
    f'{HEAD}<worldbody>{FLOOR}<body name="table" pos="0 0 .1"><geom name="top" type="box" size=".3 .3 .1"/></body>'
    '<body name="base" pos="0 0 .9"><geom type="box" size=".04 .04 .04"/>'
    + "".join(
        f'<body name="link{i}" pos="0 0 -.1"><joint name="arm{i}" axis="{axis}" armature=".05" damping="1"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02" mass=".3"/>'
        for i, axis in enumerate(("0 0 1", "0 1 0", "1 0 0", "0 1 0"))
    )
    + '<body name="palm" pos="0 0 -.1" quat="0 1 0 0"><geom type="box" size=".02 .05 .02"/>'
    + four_fingers('<body name="{name}_tip" pos="0 0 .03"><geom type="sphere" size=".012" mass=".005"/></body>', 2)
    + "</body>" * 6
    + '<body name="mug" pos=".25 0 .24"><freejoint/><geom type="box" size=".03 .03 .03"/></body>'
    '<body name="can" pos=".02 0 .24"><freejoint/><geom type="box" size=".03 .03 .03"/></body></worldbody><actuator>'
    + "".join(f'<position name="arm{i}" joint="arm{i}" kp="200" kv="20"/>' for i in range(4))
    + "".join(f'<motor name="{name}" joint="{name}" forcerange="-1 1"/>' for name in joints(2))
    + "</actuator></mujoco>"
)
#: A hand whose palm floats free, and nothing else.
FLOATING = (
    f'{HEAD}<worldbody>{FLOOR}<body name="palm" pos="0 0 .3"><freejoint name="root"/>'
    '<geom type="box" size=".02 .05 .04"/>'
    + four_fingers('<body name="{name}_tip" pos="0 0 .03"><geom type="sphere" size=".012" mass=".005"/></body>', 2)
    + f"</body></worldbody><actuator>{servos(joints(2))}</actuator></mujoco>"
)


def urdf_link(name: str, shape: str = '<sphere radius="0.01"/>') -> str:
    """A link that weighs something; without a shape it is the frame of a tip."""
    collision = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
    inertial = (
        '<inertial><mass value="0.05"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return f'<link name="{name}">{inertial if shape else ""}{collision}</link>'


def urdf_joint(name: str, parent: str, child: str, inside: str = "", kind: str = "revolute", side: float = 0) -> str:
    """A joint between two links, the child 3 cm above the parent."""
    limit = '<limit lower="0" upper="1.5" effort="0.8" velocity="3"/>' if kind == "revolute" else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 {side} 0.03"/><axis xyz="0 1 0"/>{limit}{inside}</joint>'
    )


#: A URDF of two fingers: no actuators, outer joints that mimic the inner ones, tips fixed to the outer links.
URDF = (
    '<robot name="hand">'
    + urdf_link("palm")
    + "".join(
        urdf_link(f"{f}_inner")
        + urdf_link(f"{f}_outer")
        + urdf_link(f"{f}_tip", tip)
        + urdf_joint(f"{f}_bend", "palm", f"{f}_inner", side=side)
        + urdf_joint(f"{f}_curl", f"{f}_inner", f"{f}_mid")
        + urdf_link(f"{f}_mid")
        + urdf_joint(f"{f}_follow", f"{f}_mid", f"{f}_outer", f'<mimic joint="{f}_curl" multiplier="0.8"/>')
        + urdf_joint(f"{f}_fix", f"{f}_outer", f"{f}_tip", kind="fixed")
        for f, tip, side in (("index", '<sphere radius="0.012"/>', 0.05), ("thumb", "", -0.05))
    )
    + "</robot>"
)
