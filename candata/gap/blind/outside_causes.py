"""Causes that are in no library: they exist in blind cases only, so that a diagnosis has to say that it does not know.

Forces are held over a control step. All sizes are measured against the scene: the weight of the object, the median
torque of the motors, the stiffness of the wrist.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from candata.effects._select import drive_torque
from candata.scenes import Scene
from candata.schema.bench import OutsideCause

Array = NDArray[np.float64]
Values = dict[str, float]
#: Force at which a fingertip counts as touching [N], and how long a pull lasts after it let go [s].
TOUCHING_N, SUCTION_S = 0.3, 0.08


@dataclass(frozen=True)
class _Cause:
    """One kind of outside cause.

    Attributes
    ----------
    acts_on : str
        Truth of where it acts.
    kind : str
        Which list of filters it joins: command, force or reading.
    possible, draw : callable
        `scene -> bool` and `(scene, rng) -> (element, values)`.
    start, apply : callable
        `(scene, cause, batch) -> state` and `(state, x) -> (state, x)`.
    """

    acts_on: Literal["joint", "fingertip", "object", "wrist"]
    kind: Literal["command", "force", "reading"]
    possible: Callable[[Scene], bool]
    draw: Callable[[Scene, np.random.Generator], tuple[str | None, Values]]
    start: Callable[[Scene, OutsideCause, Batch], Any]
    apply: Callable[[Any, Any], tuple[Any, Any]]


def _weight(scene: Scene) -> float:
    """Return the weight of the object [N]."""
    return float(scene.model.body_subtreemass[scene.object_id] * np.linalg.norm(scene.model.opt.gravity))


def _hinges(scene: Scene) -> list[str]:
    """Return the names of the driven hinges."""
    return [scene.file.joints[i] for i in scene.driven_hinges]


def _dof(scene: Scene, joint: str) -> int:
    """Return a joint's address in qvel."""
    return int(scene.model.jnt_dofadr[scene.model.joint(joint).id])


def _qpos(scene: Scene, joint: str) -> int:
    """Return a joint's address in qpos."""
    return int(scene.model.jnt_qposadr[scene.model.joint(joint).id])


def _driven_slides(scene: Scene) -> list[str]:
    """Return the names of the slides that have an actuator: a wrist on rails."""
    driven, slide = set(scene.driven_joints.values()), mujoco.mjtJoint.mjJNT_SLIDE
    ids = zip(scene.file.joints, scene.joint_ids, strict=True)
    return [name for name, i in ids if i in driven and scene.model.jnt_type[i] == slide]


def _has_object(scene: Scene) -> bool:
    return scene.object_id is not None


def _has_hinges(scene: Scene) -> bool:
    return len(scene.driven_hinges) > 0


def _has_forces(scene: Scene) -> bool:
    return len(scene.force_sensors) > 0


# A constant push on the object.
def _draw_wind(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    size, turn = rng.uniform(0.08, 0.2) * _weight(scene), rng.uniform(0, 2 * np.pi)
    return None, {"x_N": size * np.cos(turn), "y_N": size * np.sin(turn)}


def _start_wind(scene: Scene, outside: OutsideCause, batch: Batch) -> tuple[int, Array]:
    return scene.object_dof, np.array([outside.values["x_N"], outside.values["y_N"]])


def _apply_wind(state: tuple[int, Array], x: Array) -> tuple[tuple[int, Array], Array]:
    at, push = state
    x[:, at : at + 2] += push
    return state, x


# A pull towards the support that fades with height.
def _draw_magnet(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    return None, {"pull_N": rng.uniform(0.5, 1.5) * _weight(scene), "range_m": rng.uniform(0.01, 0.03)}


def _start_magnet(scene: Scene, outside: OutsideCause, batch: Batch) -> tuple[Array, int, int, float, Values]:
    height = scene.object_qpos + 2
    rest = float(scene.model.qpos0[height])
    return batch.bind("qpos"), height, scene.object_dof + 2, rest, outside.values


def _apply_magnet(state: Any, x: Array) -> tuple[Any, Array]:
    qpos, height, dof, rest, values = state
    x[:, dof] -= values["pull_N"] * np.exp(-np.maximum(qpos[:, height] - rest, 0) / values["range_m"])
    return state, x


# A tendon that couples two joints like a spring.
def _draw_coupling(scene: Scene, rng: np.random.Generator) -> tuple[str, Values]:
    first, second = rng.choice(_hinges(scene), 2, replace=False)
    other = float(scene.file.joints.index(str(second)))
    return str(first), {"stiffness_Nm_rad": rng.uniform(0.3, 0.8) * drive_torque(scene), "other": other}


def _start_coupling(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    pair = [str(outside.element), scene.file.joints[int(outside.values["other"])]]
    places = [[_qpos(scene, j) for j in pair], [_dof(scene, j) for j in pair]]
    return batch.bind("qpos"), places, outside.values["stiffness_Nm_rad"]


def _apply_coupling(state: Any, x: Array) -> tuple[Any, Array]:
    qpos, (at, dof), stiffness = state
    torque = stiffness * (qpos[:, at[0]] - qpos[:, at[1]])
    x[:, dof[0]] -= torque
    x[:, dof[1]] += torque
    return state, x


# A torque that waves with the angle, as of a motor with strong magnets.
def _draw_cogging(scene: Scene, rng: np.random.Generator) -> tuple[str, Values]:
    values = {"torque_Nm": rng.uniform(0.15, 0.35) * drive_torque(scene), "waves_rad": float(rng.integers(6, 15))}
    return str(rng.choice(_hinges(scene))), values | {"phase_rad": rng.uniform(0, 2 * np.pi)}


def _start_cogging(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    joint = str(outside.element)
    return batch.bind("qpos"), _qpos(scene, joint), _dof(scene, joint), outside.values


def _apply_cogging(state: Any, x: Array) -> tuple[Any, Array]:
    qpos, at, dof, v = state
    x[:, dof] += v["torque_Nm"] * np.sin(v["waves_rad"] * qpos[:, at] + v["phase_rad"])
    return state, x


# Motors that warm up under load and lose gain.
def _draw_fading(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    return None, {"loss": rng.uniform(0.3, 0.5), "warming_s": rng.uniform(0.4, 0.8)}


def _start_fading(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    dofs = scene.joint_dof[scene.driven_hinges]
    rate = 1 / scene.file.rate_hz / outside.values["warming_s"]
    return (
        np.zeros((batch.nsim, len(dofs))),
        batch.bind("qfrc_actuator"),
        dofs,
        outside.values["loss"],
        rate,
        drive_torque(scene),
    )


def _apply_fading(state: Any, x: Array) -> tuple[Any, Array]:
    heat, motor, dofs, loss, rate, torque = state
    now = motor[:, dofs]
    # Heat follows the current's size; half the motors' torque warms them fully.
    heat = heat + rate * (np.minimum(np.abs(now) / (0.5 * torque), 1.0) - heat)
    x[:, dofs] -= loss * heat * now
    return (heat, motor, dofs, loss, rate, torque), x


# Commands that get lost on the bus in bursts.
def _draw_loss(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    values = {"often": rng.uniform(0.04, 0.1), "burst_rows": rng.uniform(3, 8)}
    return None, values | {"seed": float(rng.integers(2**31))}


def _start_loss(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    rng = np.random.default_rng(int(outside.values["seed"]))
    return None, np.zeros(batch.nsim, bool), rng, outside.values


def _apply_loss(state: Any, x: Array) -> tuple[Any, Array]:
    last, lost, rng, v = state
    chance = rng.random(len(x))
    lost = np.where(lost, chance > 1 / v["burst_rows"], chance < v["often"])
    held = x if last is None else np.where(lost[:, None, None], last[:, -1:], x)
    return (held, lost, rng, v), held


# A force sensor that sticks: it follows only once the force has changed by a width.
def _draw_sticky(scene: Scene, rng: np.random.Generator) -> tuple[str, Values]:
    return str(rng.choice(scene.file.fingertips)), {"width_N": rng.uniform(0.2, 0.5)}


def _start_sticky(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    tip = scene.file.fingertips.index(str(outside.element))
    return np.zeros((batch.nsim, 3)), tip, outside.values["width_N"]


def _apply_sticky(state: Any, x: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
    read, tip, width = state
    force = x["fingertip_force"].copy()
    force[:, tip] = read = np.clip(read, force[:, tip] - width, force[:, tip] + width)
    return (read, tip, width), x | {"fingertip_force": force}


# A force sensor that creeps after it was loaded: part of the past load stays in its reading.
def _draw_creep(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    return None, {"share": rng.uniform(0.3, 0.6), "memory_s": rng.uniform(0.4, 1.0)}


def _start_creep(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    rate = 1 / scene.file.rate_hz / outside.values["memory_s"]
    return np.zeros((batch.nsim, len(scene.file.fingertips), 3)), rate, outside.values["share"]


def _apply_creep(state: Any, x: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
    past, rate, share = state
    force = x["fingertip_force"]
    past = past + rate * (force - past)
    return (past, rate, share), x | {"fingertip_force": force + share * past}


# Fingertips that hold on to the object for a moment after they let go.
def _draw_suction(scene: Scene, rng: np.random.Generator) -> tuple[None, Values]:
    return None, {"pull_N": rng.uniform(0.3, 0.6) * _weight(scene)}


def _start_suction(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    fields = batch.bind("sensordata"), batch.bind("xpos")
    left = np.zeros((batch.nsim, len(scene.force_sensors)))
    return left, fields, scene, outside.values["pull_N"]


def _apply_suction(state: Any, x: Array) -> tuple[Any, Array]:
    left, (sensors, places), scene, pull = state
    touching = np.linalg.norm(sensors[:, scene.force_sensors], axis=-1) > TOUCHING_N
    left = np.where(touching, SUCTION_S, np.maximum(left - 1 / scene.file.rate_hz, 0))
    apart = places[:, scene.fingertip_bodies] - places[:, [scene.object_id]]
    way = apart / np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-9)
    at = scene.object_dof
    x[:, at : at + 3] += pull * (way * ((left > 0) & ~touching)[..., None]).sum(1)
    return (left, (sensors, places), scene, pull), x


# A taut cable at one rail of the wrist, tighter the farther the wrist goes.
def _draw_cable(scene: Scene, rng: np.random.Generator) -> tuple[str, Values]:
    joint = str(rng.choice(_driven_slides(scene)))
    servo = next(a for a, j in scene.driven_joints.items() if j == scene.model.joint(joint).id)
    kp = float(scene.model.actuator_gainprm[servo, 0])
    # The tension alone displaces the wrist by 4 to 10 mm.
    return joint, {"stiffness_N_m": rng.uniform(0.08, 0.2) * kp, "tension_N": rng.uniform(0.004, 0.01) * kp}


def _start_cable(scene: Scene, outside: OutsideCause, batch: Batch) -> Any:
    joint = str(outside.element)
    return batch.bind("qpos"), _qpos(scene, joint), _dof(scene, joint), outside.values


def _apply_cable(state: Any, x: Array) -> tuple[Any, Array]:
    qpos, at, dof, v = state
    x[:, dof] -= np.maximum(v["tension_N"] + v["stiffness_N_m"] * qpos[:, at], 0)
    return state, x


CAUSES: dict[str, _Cause] = {
    "wind": _Cause("object", "force", _has_object, _draw_wind, _start_wind, _apply_wind),
    "magnet": _Cause("object", "force", _has_object, _draw_magnet, _start_magnet, _apply_magnet),
    "suction": _Cause("object", "force", _has_forces, _draw_suction, _start_suction, _apply_suction),
    "coupling": _Cause(
        "joint", "force", lambda scene: len(scene.driven_hinges) > 1, _draw_coupling, _start_coupling, _apply_coupling
    ),
    "cogging": _Cause("joint", "force", _has_hinges, _draw_cogging, _start_cogging, _apply_cogging),
    "fading_gain": _Cause("joint", "force", _has_hinges, _draw_fading, _start_fading, _apply_fading),
    "command_loss": _Cause("joint", "command", _has_hinges, _draw_loss, _start_loss, _apply_loss),
    "sticky_sensor": _Cause("fingertip", "reading", _has_forces, _draw_sticky, _start_sticky, _apply_sticky),
    "sensor_creep": _Cause("fingertip", "reading", _has_forces, _draw_creep, _start_creep, _apply_creep),
    "cable": _Cause(
        "wrist", "force", lambda scene: bool(_driven_slides(scene)), _draw_cable, _start_cable, _apply_cable
    ),
}
