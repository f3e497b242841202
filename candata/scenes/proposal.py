"""Likely roles of the parts of a model: the start of a scene file of one's own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from candata.scenes import chains
from candata.scenes.assemble import subtree
from candata.schema.scene import Servo

_FREE = mujoco.mjtJoint.mjJNT_FREE
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
#: Rate that is proposed if the physics step allows it, and between which others are offered [Hz]. Chosen: hands log at
#: 50 to 200.
USUAL_RATE_HZ, LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 100.0, 20.0, 500.0
#: Steady error under full load by which a guessed servo is stiff [rad or m]. Chosen.
FULL_LOAD_ERROR = 0.3
#: Natural frequency of a guessed servo without a limit, times 2 pi [rad/s]. Chosen: 5 Hz.
USUAL_FREQUENCY = 31.0
#: Largest natural frequency of a guessed servo, as a share of 1 / physics step: Euler's method holds a critically
#: damped servo up to w dt = 1. Chosen: a quarter of that.
STABLE_SHARE = 0.25
#: Words in the names of bodies that are tracked, and of those that only show something.
_OBJECT = re.compile(r"obj|cube|block|box|ball|can\b|bottle|mug|tool|peg", re.IGNORECASE)
_MARKER = re.compile(r"target|goal|ghost|marker|hint|dummy|mocap", re.IGNORECASE)
#: Steps by which a ray goes on behind what nothing rests on [m], and how many of them.
_BEYOND_M, _MOST_HITS = 1e-4, 50


@dataclass(frozen=True)
class Proposal:
    """Roles that a model's parts may play, and what else there is to choose from.

    Attributes
    ----------
    joints, actuators, fingertips, fingertip_frames, object, support, groups, rate_hz
        As in a scene file. `object` may be the floating base of the robot, see `floating_base`.
    servos : dict of str to Servo
        Guessed gains of joints of a model without actuators.
    other_joints, other_tips, other_objects : tuple of str
        Joints that nothing drives, ends of chains that are hardly fingertips, further free bodies.
    rates_hz : tuple of float
        Rates at which a step holds a whole number of physics steps.
    timestep_s : float
        Physics step.
    floating_base : str
        Free body that carries driven joints and that nothing holds; empty where there is none.
    notes : tuple of str
        What could not be listed, and why.
    """

    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    servos: dict[str, Servo]
    fingertips: tuple[str, ...]
    fingertip_frames: tuple[str, ...]
    object: str | None
    support: str | None
    groups: dict[str, tuple[str, ...]]
    rate_hz: float
    rates_hz: tuple[float, ...]
    timestep_s: float
    other_joints: tuple[str, ...] = ()
    other_tips: tuple[str, ...] = ()
    other_objects: tuple[str, ...] = ()
    floating_base: str = ""
    notes: tuple[str, ...] = ()

    @property
    def free_bodies(self) -> tuple[str, ...]:
        """All bodies that may be the object, the likeliest first."""
        return ((self.object,) if self.object else ()) + self.other_objects

    @property
    def open_questions(self) -> tuple[str, ...]:
        """Lines for people on what to check first."""
        lines = list(self.notes)
        if self.servos:
            lines.append("the model has no actuators: the gains are guessed, fill in those of your drives")
        elif not self.actuators:
            lines.append("no actuator is listed: nothing is commanded")
        if self.other_objects:
            lines.append(f"several bodies are free, {', '.join(self.free_bodies)}: the object is taken to be the first")
        if self.floating_base and self.floating_base == self.object:
            lines.append(f"{self.floating_base} is the robot's own floating base: its pose has to be recorded")
        elif self.floating_base:
            lines.append(f"the robot's base {self.floating_base} floats: hold it in the model where yours is held")
        if not self.fingertips and self.joints:
            lines.append("no fingertips were found")
        return tuple(lines)


def propose(model: mujoco.MjModel) -> Proposal:
    """Return likely roles of the parts of a model, read off its kinematic tree, names and places."""
    scalar = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
    trees = _robots(model, scalar)
    robot_joints = [j for j in scalar if int(model.body_rootid[model.jnt_bodyid[j]]) in trees]
    if not robot_joints:  # an object with joints, tossed: its joints are all that there is
        robot_joints = scalar
    tips, other_tips = chains.fingertips(chains.chain_ends(model, trees))
    mimic_joints = _mimic_joints(model)
    servos = {} if model.nactuator else _guess_servos(model, [j for j in robot_joints if j not in mimic_joints], trees)
    driven_joints = (
        set(chains.actuator_of_joint(model))
        or {j for j in robot_joints if model.joint(j).name in servos}
        or set(robot_joints)
    )
    free, floating_base = _free_bodies(model, trees, tips)
    object_name = free[0] if free else floating_base or None
    if object_name == floating_base and not _names(model, robot_joints):
        tips = []  # an object that carries no joint is no hand
    rate_hz, rates_hz = _rates(float(model.opt.timestep))
    frames = tuple(tip.site for tip in tips)
    return Proposal(
        joints=_names(model, robot_joints),
        actuators=tuple(name for a in range(model.nactuator) if (name := model.actuator(a).name)),
        servos=servos,
        fingertips=tuple(tip.name for tip in tips),
        fingertip_frames=frames if all(frames) else (),
        object=object_name,
        support=_support(model, object_name) if object_name and object_name != floating_base else None,
        groups=chains.groups(model, tips, [j for j in robot_joints if j in driven_joints and model.joint(j).name]),
        rate_hz=rate_hz,
        rates_hz=rates_hz,
        timestep_s=float(model.opt.timestep),
        other_joints=_names(model, [j for j in scalar if j not in robot_joints]),
        other_tips=tuple(tip.name for tip in other_tips),
        other_objects=tuple(free[1:]),
        floating_base=floating_base,
        notes=_nameless(model, robot_joints),
    )


def _robots(model: mujoco.MjModel, scalar: Sequence[int]) -> set[int]:
    """Return the ids of the top bodies of robots: those that are driven, or else all with joints but free bodies."""
    if model.nactuator:
        return chains.driven_trees(model)
    roots = {int(model.body_rootid[model.jnt_bodyid[j]]) for j in scalar}
    return {root for root in roots if not _is_free(model, root)}


def _is_free(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body moves freely."""
    joint = int(model.body_jntadr[body])
    return joint >= 0 and int(model.body_jntnum[body]) == 1 and model.jnt_type[joint] == _FREE


def _names(model: mujoco.MjModel, joints: Sequence[int]) -> tuple[str, ...]:
    """Return the names of those joints that have one."""
    return tuple(name for joint in joints if (name := model.joint(joint).name))


def _mimic_joints(model: mujoco.MjModel) -> set[int]:
    """Return the ids of joints that an equality lets follow another, as mimic joints do."""
    of_joints = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)
    return set(model.eq_obj1id[of_joints].tolist())


def _guess_servos(model: mujoco.MjModel, joints: Sequence[int], trees: set[int]) -> dict[str, Servo]:
    """Return guessed servos of the joints of robots: critically damped, and as stiff as limit and step allow."""
    servos: dict[str, Servo] = {}
    for joint in joints:
        name = model.joint(joint).name
        if not name or int(model.body_rootid[model.jnt_bodyid[joint]]) not in trees:
            continue
        inertia = float(model.dof_M0[model.jnt_dofadr[joint]])
        limit = float(model.jnt_actfrcrange[joint, 1]) if model.jnt_actfrclimited[joint] else 0.0
        target_frequency = np.sqrt(limit / FULL_LOAD_ERROR / inertia) if limit > 0 else USUAL_FREQUENCY
        frequency = min(float(target_frequency), STABLE_SHARE / model.opt.timestep)
        kp, kv = _round_digits(inertia * frequency**2), _round_digits(2 * inertia * frequency)
        servos[name] = Servo(kp=kp, kv=kv, limit=_round_digits(limit) if limit > 0 else None)
    return servos


def _round_digits(number: float) -> float:
    """Return a number with two digits."""
    return float(f"{number:.2g}")


def _free_bodies(model: mujoco.MjModel, trees: set[int], tips: Sequence[chains.Tip]) -> tuple[list[str], str]:
    """Return the free bodies that may be the object, the likeliest first, and the floating base of a robot.

    One that collides comes before one that does not, one that is called an object before others, and one that is
    called a target last; then the nearest to the fingertips.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hand = data.xpos[[tip.link for tip in tips]].mean(0) if tips else np.zeros(3)
    free = [body for body in range(1, model.nbody) if _is_free(model, body) and model.body(body).name]

    def order(body: int) -> tuple[bool, bool, bool, float]:
        """Return the key of a body: the smallest is the likeliest object."""
        name = model.body(body).name
        is_marker, is_called_object = bool(_MARKER.search(name)), bool(_OBJECT.search(name))
        return (
            not _collides(model, body),
            is_marker,
            not is_called_object,
            float(np.linalg.norm(data.xpos[body] - hand)),
        )

    candidates = [model.body(b).name for b in sorted(free, key=order) if b not in trees and _collides(model, b)]
    return candidates, next((model.body(b).name for b in free if b in trees and chains.floats(model, b)), "")


def _collides(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body, or what it carries, has a geom that collides."""
    tree = subtree(model, body)
    return any(int(model.geom_bodyid[g]) in tree and chains.can_collide(model, g) for g in range(model.ngeom))


def _support(model: mujoco.MjModel, name: str) -> str | None:
    """Return the fixed geom below an object; None if there is none, or it has no name."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    body = model.body(name).id
    object_bodies, start = subtree(model, body), np.array(data.xipos[body])
    hit = np.zeros(1, np.int32)
    for _ in range(_MOST_HITS):
        distance = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, hit)
        geom = int(hit[0])
        if geom < 0:
            return None
        if int(model.geom_bodyid[geom]) not in object_bodies and chains.can_collide(model, geom):
            is_fixed = model.body_weldid[model.geom_bodyid[geom]] == 0
            return (model.geom(geom).name or None) if is_fixed else None
        start[2] -= distance + _BEYOND_M
    return None


def _rates(step_s: float) -> tuple[float, tuple[float, ...]]:
    """Return the rate to propose [Hz], and others at which a control step is a whole number of physics steps."""
    if not 0 < step_s < np.inf:
        return USUAL_RATE_HZ, ()
    fewest_steps, most_steps = max(1, round(1 / step_s / HIGHEST_RATE_HZ)), max(1, round(1 / step_s / LOWEST_RATE_HZ))
    rates = [float(f"{1 / step_s / steps:.6g}") for steps in range(fewest_steps, most_steps + 1)]
    round_rates = [rate for rate in rates if rate == round(rate)] or rates
    best_rate = min(round_rates, key=lambda rate: abs(np.log(rate / USUAL_RATE_HZ)))
    return best_rate, tuple(round_rates)


def _nameless(model: mujoco.MjModel, joints: Sequence[int]) -> tuple[str, ...]:
    """Return notes on the parts that have no name and so cannot be listed."""
    counts = {
        ("joint", "joints"): sum(not model.joint(j).name for j in joints),
        ("actuator", "actuators"): sum(not model.actuator(a).name for a in range(model.nactuator)),
        ("free body", "free bodies"): sum(_is_free(model, b) and not model.body(b).name for b in range(model.nbody)),
    }
    return tuple(
        f"{count} {kinds if count > 1 else kind} of the model without a name cannot be listed: name "
        f"{'them' if count > 1 else 'it'} there"
        for (kind, kinds), count in counts.items()
        if count
    )
