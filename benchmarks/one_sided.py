"""Are parameters that are known from one side reported so? Stuck or saturated faults, played by plain MuJoCo.

Each case is a small random scene (a finger over a loose box, a link on its stop, or an arm of one or two joints) and
one fault of a random size. The recording is made by `mj_step` alone, in a loop of this file; the diagnosis searches for
that effect only. The end that a recording can tell is known beforehand: more friction than sticks moves nothing more.
Beside them are moderate faults, whose both ends can be told. Printed for both: how often the honest side is stated
(target of the first: 28 of 30), how often the stated range holds the truth (target: 85 to 95 %), and each case, with a
mark where one of the two is missed.

    python benchmarks/one_sided.py --cases 30 --controls 10 --jobs 1 --seed 1
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import CandataError
from candata.gap import diagnose
from candata.scenes import Scene, load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

TARGET, RATE_HZ, EPISODES, ROWS = 28 / 30, 100.0, 8, 120
JOINT_NOISE_RAD, FORCE_NOISE_N, POSE_NOISE = 0.001, 0.02, (0.0001, 0.001)
#: Least share of a servo's gain, and most damping in units of a servo's own and its joint's, that is searched.
LEAST_GAIN, MOST_DAMPING = 0.15, 15.0
ARM = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>{bodies}</worldbody>
  <actuator>{motors}</actuator></mujoco>"""
LINK = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .5"><joint name="j0" axis="0 -1 0" range="0 1.5" damping=".001" armature=".0005"
    solreflimit=".005 1" solimplimit=".99 .999 .001"/>
    <geom type="sphere" pos=".1 0 0" size=".02" mass="{mass}" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="j0" joint="j0" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/></actuator></mujoco>"""
ROLES = f"""model: scene.xml
rate_hz: {RATE_HZ}
joints: [{{names}}]
actuators: [{{names}}]
noise: {{{{joint_position: {JOINT_NOISE_RAD}}}}}
"""
FINGER = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/>
  <default><geom condim="4" friction="{mu} .005 .0001" solref="{soft} 1"/></default>
  <worldbody><geom name="table" type="plane" size="1 1 .1"/>
    <body pos="{reach} 0 {height}"><joint name="j0" axis="0 -1 0" range="-1 1" damping="{damping}" armature=".0005"/>
      <geom type="capsule" fromto="0 0 0 {back} 0 0" size=".006" mass=".02" contype="0" conaffinity="0"/>
      <geom name="tip" type="sphere" pos="{back} 0 0" size=".01" mass=".01"/></body>
    <body name="box" pos="0 0 .03"><freejoint/><geom name="box" type="box" size=".03 .03 .03" mass="{mass}"/></body>
  </worldbody>
  <actuator><position name="j0" joint="j0" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/></actuator>
  <sensor/></mujoco>"""


@dataclass(frozen=True)
class World:
    """A scene and how the real one differs from it.

    Attributes
    ----------
    kind, effect : str
        Name of the case, and of the effect that is its fault.
    truth : float
        Size of the fault.
    known : str
        Which ends of it the recording can tell: low, high or both.
    xml, roles : str
        Texts of the model and of `scene.yaml`.
    centre, swing : float
        Mean and amplitude of the commands [rad].
    change : callable
        Makes the fault in the model.
    play_rad, band_n : float
        Play of the gears and dead band of the fingertip, which no model has.
    """

    kind: str
    effect: str
    truth: float
    known: str
    xml: str
    roles: str
    centre: float
    swing: float
    change: Callable[[mujoco.MjModel], None] = lambda model: None
    play_rad: float = 0.0
    band_n: float = 0.0


def arm(rng: np.random.Generator) -> tuple[str, str, dict]:
    """Return an arm of one or two hinges that turn about the vertical, its roles, and its motors' numbers."""
    count = int(rng.integers(1, 3))
    limit, step = rng.uniform(0.5, 4.0), float(rng.choice([0.002, 0.0025]))
    kp, length, mass = limit * rng.uniform(3, 6), rng.uniform(0.15, 0.3), rng.uniform(0.02, 0.05) * limit
    # Nearly critically damped.
    kv = 1.4 * np.sqrt(kp * mass * length**2 * (1 if count == 1 else 3))
    bodies = ""
    for i in reversed(range(count)):
        bodies = (
            f'<body pos="{length * (i > 0):.4f} 0 {0.5 * (i == 0)}"><joint name="j{i}" axis="0 0 1" '
            f'damping="{0.05 * kv:.5f}"/><geom type="capsule" fromto="0 0 0 {length:.4f} 0 0" size=".02" '
            f'mass="{mass:.4f}" contype="0" conaffinity="0"/>{bodies}</body>'
        )
    motors = "".join(
        f'<position name="j{i}" joint="j{i}" kp="{kp:.4f}" kv="{kv:.5f}" forcerange="-{limit:.4f} {limit:.4f}"/>'
        for i in range(count)
    )
    names = ", ".join(f"j{i}" for i in range(count))
    return (
        ARM.format(step=step, bodies=bodies, motors=motors),
        ROLES.format(names=names),
        {"limit": limit, "kp": kp, "kv": kv},
    )


def finger(rng: np.random.Generator) -> tuple[str, str, dict]:
    """Return a finger that presses on a loose box, its roles, and its numbers."""
    own = {
        "limit": rng.uniform(0.2, 0.4),
        "kp": rng.uniform(1, 1.8),
        "kv": 0.04,
        "damping": 0.01,
        "mu": rng.uniform(0.6, 1),
        "soft": rng.uniform(0.012, 0.03),
        "mass": rng.uniform(0.1, 0.3),
        "reach": 0.09,
        "back": -0.09,
        "height": 0.078,
    }
    roles = (
        f"model: scene.xml\nrate_hz: {RATE_HZ}\nobject: box\njoints: [j0]\nactuators: [j0]\nfingertips: [tip]\n"
        f"support: table\nnoise: {{joint_position: {JOINT_NOISE_RAD}, object_pose: [{POSE_NOISE[0]}, {POSE_NOISE[1]}], "
        f"fingertip_force: {FORCE_NOISE_N}}}\n"
    )
    return FINGER.format(**own), roles, own


def stuck(rng: np.random.Generator, moderate: bool) -> World:
    """Dry friction above all that the motors ask for: joints creep alike; a moderate one lets them move."""
    xml, roles, own = arm(rng)
    swing = rng.uniform(0.3, 0.5) * own["limit"] / own["kp"]
    most = own["kp"] * swing
    truth = rng.uniform(0.1, 0.35) * most if moderate else rng.uniform(1.05 * most, 0.57 * own["limit"])

    def change(model):
        model.dof_frictionloss[:] += truth

    return World("stuck", "joint_dry_friction", truth, "both" if moderate else "low", xml, roles, 0.0, swing, change)


def small_motions(rng: np.random.Generator, moderate: bool) -> World:
    """The same of motions of some hundredths of a radian, which do not move a dry joint at all."""
    xml, roles, own = arm(rng)
    swing = rng.uniform(0.008, 0.013)
    most = own["kp"] * swing
    truth = (
        most * rng.uniform(0.1, 0.4) if moderate else np.exp(rng.uniform(*np.log([1.2 * most, 0.57 * own["limit"]])))
    )

    def change(model):
        model.dof_frictionloss[:] += truth

    known = "both" if moderate else "low"
    return World("small motions", "joint_dry_friction", truth, known, xml, roles, 0.0, swing, change)


def weak_motor(rng: np.random.Generator, moderate: bool) -> World:
    """A torque limit below what lifts a link off its stop; a moderate one slows an arm now and then."""
    if moderate:
        xml, roles, own = arm(rng)
        world = World("weak motor", "torque_limit", 0.0, "both", xml, roles, 0.0, rng.uniform(0.5, 0.8))
        limit = most_torque(world, rng)
        xml = xml.replace(f'"-{own["limit"]:.4f} {own["limit"]:.4f}"', f'"-{limit:.5f} {limit:.5f}"')
        truth = rng.uniform(0.3, 0.6) * limit
    else:
        swing, weight = rng.uniform(0.01, 0.012), rng.uniform(0.02, 0.2)
        kp = 2 * weight / swing
        limit, truth = weight * rng.uniform(4, 10), weight * rng.uniform(0.25, 0.85)
        xml = LINK.format(mass=weight / 9.81 / 0.1, kp=kp, kv=1.4 * np.sqrt(kp * weight / 98), limit=limit)
        roles = ROLES.format(names="j0")
        world = World("weak motor", "torque_limit", 0.0, "high", xml, roles, swing, swing)

    def change(model):
        model.actuator_forcerange[:] = (-truth, truth)

    return replace(world, truth=truth, xml=xml, change=change)


def loose_gears(rng: np.random.Generator, moderate: bool) -> World:
    """Play that no motion crosses: the joints stay where they are; a moderate one is crossed each time."""
    xml, roles, _ = arm(rng)
    gap = rng.uniform(0.03, 0.1) if moderate else rng.uniform(0.035, 0.28)
    swing = rng.uniform(0.2, 0.4) if moderate else rng.uniform(0.007, 0.013)
    return World("loose gears", "backlash", gap, "both" if moderate else "low", xml, roles, 0.0, swing, play_rad=gap)


def numb_tip(rng: np.random.Generator, moderate: bool) -> World:
    """A fingertip that feels no force at all; a moderate band swallows the small ones."""
    xml, roles, _ = finger(rng)
    band = rng.uniform(0.2, 0.5) if moderate else rng.uniform(2.5, 2.95)
    known = "both" if moderate else "low"
    return World("numb tip", "tactile_dead_band", band, known, xml, roles, 0.1, 0.1, band_n=band)


def hard_contact(rng: np.random.Generator, moderate: bool) -> World:
    """Contacts as hard as MuJoCo has them, two physics steps, whatever less is asked for; moderate ones are softer."""
    xml, roles, _ = finger(rng)
    truth = rng.uniform(0.04, 0.08) if moderate else rng.uniform(0.001, 0.005)

    def change(model):
        model.geom_solref[:, 0] = truth

    known = "both" if moderate else "high"
    return World("hard contact", "contact_compliance", truth, known, xml, roles, 0.1, 0.1, change)


def heavy_damping(rng: np.random.Generator, moderate: bool) -> World:
    """Damping beyond all that is searched; a moderate one lies well inside."""
    xml, roles, own = arm(rng)
    truth = 1.05 * own["kv"] * (rng.uniform(1.0, 4.0) if moderate else MOST_DAMPING * rng.uniform(1.2, 2))

    def change(model):
        model.dof_damping[:] += truth

    known, swing = "both" if moderate else "low", 0.6 * own["limit"] / own["kp"]
    return World("heavy damping", "joint_damping", truth, known, xml, roles, 0.0, swing, change)


def weak_servo(rng: np.random.Generator, moderate: bool) -> World:
    """Servos weaker than all that is searched; moderate ones lie well inside."""
    xml, roles, own = arm(rng)
    truth = rng.uniform(0.5, 0.8) if moderate else LEAST_GAIN * rng.uniform(0.5, 0.9)

    def change(model):
        model.actuator_gainprm[:, 0] *= truth
        model.actuator_biasprm[:, 1] *= truth

    known, swing = "both" if moderate else "high", 0.6 * own["limit"] / own["kp"]
    return World("weak servo", "servo_gain", truth, known, xml, roles, 0.0, swing, change)


KINDS = (stuck, small_motions, weak_motor, loose_gears, numb_tip, hard_contact, heavy_damping, weak_servo)


def most_torque(world: World, rng: np.random.Generator) -> float:
    """Return the largest torque that a world's motors give on a few of its motions [N m], unlimited."""
    model = mujoco.MjModel.from_xml_string(world.xml)
    model.actuator_forcelimited[:] = False
    most = 0.0
    for _ in range(4):
        data = mujoco.MjData(model)
        for target in commands(rng, world, model.nu):
            data.ctrl[:] = target
            for _ in range(round(1 / RATE_HZ / model.opt.timestep)):
                mujoco.mj_step(model, data)
                most = max(most, float(np.abs(data.actuator_force).max()))
    return most


def commands(rng: np.random.Generator, world: World, width: int) -> np.ndarray:
    """Return targets `(ROWS, A)`: sines that rise from rest and quicken, held still for a while at the end."""
    t = (np.arange(ROWS) / RATE_HZ)[:, None]
    rate, phase = rng.uniform(0.6, 1.4, (1, width)), rng.choice([-1.0, 1.0], (1, width))
    size = world.swing * rng.uniform(0.75, 1.0, (1, width))
    ramp = np.clip((t - 0.1) / 0.2, 0, 1)
    return ramp * (world.centre + size * phase * np.sin(2 * np.pi * rate * np.maximum(t - 0.1, 0) * (1 + 0.3 * t)))


def played(model: mujoco.MjModel, scene: Scene, targets: np.ndarray, world: World, rng: np.random.Generator) -> dict:
    """Return the noisy channels of one episode, stepped by MuJoCo alone."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    steps = round(1 / RATE_HZ / model.opt.timestep)
    names = scene.file.joints
    at = [model.joint(n).qposadr[0] for n in names]
    motors = [model.actuator(n).id for n in scene.file.actuator_names]
    tips = [model.geom(n).id for n in scene.file.fingertips]
    output = targets[0].copy()
    joints, poses, forces = [], [], [np.zeros((len(tips), 3))]
    for target in targets:
        joints.append(data.qpos[at].copy())
        if tips:
            poses.append(data.body("box").xpos.tolist() + data.body("box").xquat.tolist())
        felt = np.zeros((len(tips), 3))
        for _ in range(steps):
            output = np.clip(output, target - world.play_rad / 2, target + world.play_rad / 2)
            data.ctrl[motors] = output
            mujoco.mj_step(model, data)
            felt += [pressed(model, data, tip) for tip in tips] if tips else 0.0
        forces.append(felt / steps)
    q = np.array(joints)
    out = {
        "time_ns": np.arange(len(q)) * round(1e9 / RATE_HZ),
        "action": targets,
        "joint_position": q + JOINT_NOISE_RAD * rng.standard_normal(q.shape),
    }
    if tips:
        force = np.array(forces[: len(q)])
        force = np.where(np.abs(force) < world.band_n, 0.0, force)
        out["fingertip_force"] = force + FORCE_NOISE_N * rng.standard_normal(force.shape)
        out["object_pose"] = np.array([shaken(np.array(p), rng) for p in poses])
    return out


def pressed(model: mujoco.MjModel, data: mujoco.MjData, tip: int) -> np.ndarray:
    """Return the force `(3,)` on a geom in its body's frame [N]."""
    total, local = np.zeros(3), np.zeros(6)
    for i, contact in enumerate(data.contact):
        if tip in contact.geom:
            mujoco.mj_contactForce(model, data, i, local)
            sign = 1.0 if contact.geom[1] == tip else -1.0
            total += sign * contact.frame.reshape(3, 3).T @ local[:3]
    return data.xmat[model.geom_bodyid[tip]].reshape(3, 3).T @ total


def shaken(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a pose `(7,)` as a tracker reads it."""
    turn = np.concatenate([[1.0], POSE_NOISE[1] / 2 * rng.standard_normal(3)])
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, pose[3:], turn / np.linalg.norm(turn))
    return np.concatenate([pose[:3] + POSE_NOISE[0] * rng.standard_normal(3), quat])


def recorded(folder: Path, world: World, rng: np.random.Generator) -> Scene:
    """Write scene and recordings into a folder and return the scene."""
    (folder / "scene.xml").write_text(world.xml)
    (folder / "scene.yaml").write_text(world.roles)
    scene = load_scene(folder / "scene.yaml")
    model = mujoco.MjModel.from_xml_string(world.xml)
    world.change(model)
    meta = EpisodeMeta(
        id="",
        source="real",
        rate_hz=RATE_HZ,
        joint_names=scene.file.joints,
        actuator_names=scene.file.actuator_names,
        fingertip_names=scene.file.fingertips,
    )
    episodes = [
        Episode(
            meta.model_copy(update={"id": f"e{i}"}),
            played(model, scene, commands(rng, world, len(scene.file.joints)), world, rng),
        )
        for i in range(EPISODES)
    ]
    create_dataset(folder / "real")
    append(folder / "real", episodes, Lineage(operation="benchmark"))
    return scene


def judged(world: World, jobs: int, rng: np.random.Generator) -> tuple[bool, bool, str]:
    """Return whether the honest side is stated, whether the range holds the truth, and what was said."""
    with tempfile.TemporaryDirectory() as name:
        scene = recorded(Path(name), world, rng)
        try:
            report = diagnose(open_dataset(Path(name) / "real"), scene, only=(world.effect,), jobs=jobs).report
        except CandataError as error:
            return False, False, str(error).splitlines()[0]
    if not report.effects:
        return False, False, report.verdict
    ((_, estimate),) = report.effects[0].parameters.items()
    low = -np.inf if estimate.low is None else estimate.low
    high = np.inf if estimate.high is None else estimate.high
    text = f"{estimate.value:.4g} [{low:.4g}, {high:.4g}] {report.effects[0].element or ''}"
    return estimate.bounded == world.known, low <= world.truth <= high, text


def main() -> None:
    """Play, diagnose and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=30, help="stuck or saturated faults")
    parser.add_argument("--controls", type=int, default=10, help="moderate faults")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for word, count, moderate in (("one-sided", args.cases, False), ("two-sided", args.controls, True)):
        sides, holds = [], []
        for i in range(count):
            rng = np.random.default_rng([args.seed, i, int(moderate)])
            world, begin = KINDS[i % len(KINDS)](rng, moderate), time.process_time()
            side, inside, text = judged(world, args.jobs, rng)
            sides.append(side)
            holds.append(inside)
            mark = "  " if side and inside else "! "
            print(
                f"{mark}{word} {i:2d} {world.kind:12s} {world.effect} {world.truth:.4g}, known {world.known}: {text} "
                f"({time.process_time() - begin:.0f} CPU s)",
                flush=True,
            )
        print(f"{word}: honest side stated in {sum(sides)} of {count}, truth in the range in {sum(holds)}", flush=True)


if __name__ == "__main__":
    main()
