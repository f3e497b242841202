"""A scene for a robot whose model is not at hand: one hinge and one position servo a joint, each on its own.

Nothing couples the joints: no gravity, no links, no contact. What remains is the servo's own law, and that is enough to
tell lag, gain and friction of each joint from its commands and positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yaml
from numpy.typing import NDArray

from candata.datasets.writing import write_text
from candata.errors import DataError, UsageError, Where
from candata.scenes.first_load import vouch
from candata.schema.episode import Episode
from candata.schema.scene import Noise, SceneFile

Array = NDArray[np.float64]
#: Inertia of each joint [kg m^2]: gains scale with it, motion does not depend on it.
INERTIA_KGM2 = 1e-3
#: Natural frequency of a servo as a share of the recorded rate: fast for the recording, and still seen by it.
NATURAL_SHARE = 1 / 6
#: Physics steps in a recorded row.
SUBSTEPS = 8
#: Room beyond the recorded range, as a share of it.
ROOM = 0.1


def servo_joints(episodes: Iterable[Episode]) -> tuple[tuple[str, ...], Array, float]:
    """Return names, ranges `(J, 2) float64 [rad]` and rate [Hz] of the joints that episodes move by commands.

    Raises
    ------
    DataError
        When positions or commands are missing, or do not go by the same names.
    """
    names: tuple[str, ...] = ()
    low, high, rate_hz = np.array(np.inf), np.array(-np.inf), 0.0
    for episode in episodes:
        meta = episode.meta
        missing_channels = [c for c in ("joint_position", "action") if c not in episode]
        if missing_channels or meta.joint_names != meta.actuator_names or (names and names != meta.joint_names):
            raise DataError(
                "joints and commands do not match",
                expected=f"joint_position and action of {', '.join(names) or 'the same names'}",
                found=f"no {missing_channels[0]}"
                if missing_channels
                else f"{meta.joint_names} and {meta.actuator_names}",
                where=Where(episode=meta.id),
                fix="give both the same names in the map, or write a scene of your own",
            )
        values = np.concatenate([episode[c][episode.valid(c)] for c in ("joint_position", "action")])
        low, high = np.fmin(low, values.min(0)), np.fmax(high, values.max(0))
        names, rate_hz = meta.joint_names, meta.rate_hz
    if not names:
        raise DataError("the joints have no names", expected="episodes with named joints", found="none")
    return names, np.stack([low, high], axis=1), rate_hz


def write_servo_scene(
    folder: Path,
    names: Sequence[str],
    ranges: Array,
    rate_hz: float,
    natural_hz: float | None = None,
    noise: float | None = None,
) -> Path:
    """Return the `scene.yaml` of independent servo joints, written beside its `scene.xml`.

    Parameters
    ----------
    folder : Path
        Where both files go; made if it is missing.
    names : sequence of J str
        Joints, in the order of `joint_position`; actuators bear the same names.
    ranges : (J, 2) float64 [rad]
        Smallest and largest position and command.
    rate_hz : float
        Rate of commands and recording.
    natural_hz : float, optional
        Natural frequency of every servo; a sixth of the rate when omitted.
    noise : float, optional
        Noise of the positions to declare, 1 sd [rad].

    Raises
    ------
    UsageError
        When the folder holds a scene already.
    DataError
        When there are no joints, names are empty or come twice, or ranges are not finite.
    """
    _check(names, ranges)
    target = folder / "scene.yaml"
    if target.exists():
        raise UsageError("a scene stands there", where=Where(path=str(target)), fix="choose another --out")
    model = servo_model(names, ranges, rate_hz, natural_hz or NATURAL_SHARE * rate_hz)
    write_text(folder / "scene.xml", model, "model")
    vouch(folder / "scene.xml")
    file = SceneFile(
        model="scene.xml",
        rate_hz=rate_hz,
        joints=tuple(names),
        actuators=tuple(names),
        noise=Noise(joint_position=noise) if noise else None,
    )
    return write_text(
        target, yaml.safe_dump(file.model_dump(mode="json", exclude_defaults=True), sort_keys=False), "scene"
    )


def _check(names: Sequence[str], ranges: Array) -> None:
    """Refuse joints that make no scene."""
    if not names or not all(names) or len(set(names)) < len(names):
        names_text = ", ".join(names) or "none"
        raise DataError("joints have no names of their own", expected="a name a joint", found=names_text)
    if np.shape(ranges) != (len(names), 2) or not np.isfinite(ranges).all():
        raise DataError("joint ranges are not finite", expected=f"{len(names)} pairs", found=str(np.shape(ranges)))


def servo_model(names: Sequence[str], ranges: Array, rate_hz: float, natural_hz: float) -> str:
    """Return the MJCF of independent, critically damped servo joints: kp = I w^2, kv = 2 I w."""
    root = ElementTree.Element("mujoco", model="servo_joints")
    step = 1 / (rate_hz * SUBSTEPS)
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", timestep=f"{step:.12g}", gravity="0 0 0", integrator="implicitfast")
    world, drives = ElementTree.SubElement(root, "worldbody"), ElementTree.SubElement(root, "actuator")
    natural = 2 * np.pi * natural_hz
    gains = {"kp": f"{INERTIA_KGM2 * natural**2:.9g}", "kv": f"{2 * INERTIA_KGM2 * natural:.9g}"}
    inertia = " ".join([f"{INERTIA_KGM2:g}"] * 3)
    for index, (name, (low, high)) in enumerate(zip(names, ranges, strict=True)):
        room = ROOM * max(high - low, 0.1)
        body = ElementTree.SubElement(world, "body", name=f"{name}_link", pos=f"{0.1 * index:g} 0 0")
        span = f"{low - room:.6g} {high + room:.6g}"
        ElementTree.SubElement(body, "joint", name=name, type="hinge", axis="0 0 1", range=span, limited="false")
        ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="0.1", diaginertia=inertia)
        ElementTree.SubElement(drives, "position", {"name": name, "joint": name, "ctrllimited": "false", **gains})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
