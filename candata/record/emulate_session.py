"""What the devices beside an emulated hand send: an arm, a tracker, a wrist sensor, a fingertip and a home-made board.

All of it comes from the rows of one script, so that the streams of a session agree. Each device has a clock of its own
where its wire carries one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import UnknownNameError, UsageError
from candata.record.devices import Link, Signal, StreamDevice, stream
from candata.record.devices._cobs_frames import Hello, hello_of
from candata.record.devices._wire import wire_time_ns
from candata.record.devices.cobs import RATE_HZ
from candata.record.emulate_script import Script
from candata.scenes import Scene
from candata.schema.episode import Episode

#: A tracker's pose is of an image: it comes so long after it, with the time of the image [s]. Chosen.
TRACKER_DELAY_S = 0.03
#: The home-made board says hello once a second, as its format asks.
HELLO_PERIOD_S = 1.0
#: Clocks count from when a device was switched on, and drift as crystals do: (seconds, parts per million). Chosen.
CLOCKS = {"arm": (1234.5, 20.0), "pose": (0.0, 0.0), "board": (17.25, -40.0)}


Write = Callable[[Mapping[str, NDArray], int, int], bytes]


@dataclass(frozen=True)
class SentStream:
    """What one device sends, again and again.

    Attributes
    ----------
    name : str
        Of the stream in a log.
    device_name : str
        Registered name of the device.
    link : str
        `serial`, `tcp` or `udp`.
    rate_hz : float
        Frames a second.
    delay_s : float
        How long after the moment that it describes the first byte of a frame is sent.
    wire_s : float
        How long a frame is on a serial wire; 0 on a socket.
    values : dict of str to (n, ...) float64
        Signals in SI, a row for each row of the script.
    script_hz : float
        Rows of the script a second.
    write : callable
        `({signal: value}, number, device_time_ns) -> bytes` of one frame.
    held : tuple of str
        Signals that say the row before a moment, not what lies between two rows.
    clock : (float, float)
        The device's time at the start [s], and its drift [ppm].
    """

    name: str
    device_name: str
    link: Link
    rate_hz: float
    values: Mapping[str, NDArray[np.float64]]
    script_hz: float
    write: Write
    delay_s: float = 0.0
    wire_s: float = 0.0
    clock: tuple[float, float] = (0.0, 0.0)
    held: tuple[str, ...] = ()

    @property
    def pass_s(self) -> float:
        """Length of one pass of the script [s]."""
        return len(next(iter(self.values.values()))) / self.script_hz

    def value_at(self, at_s: float) -> dict[str, NDArray[np.float64]]:
        """Return the signals `at_s` after the start, passes of the script one after another."""
        place = at_s % self.pass_s * self.script_hz
        # A moment that is a row's but for rounding is that row's.
        before = int(place + 1e-6)
        weight = max(place - before, 0.0)
        values: dict[str, NDArray[np.float64]] = {}
        for name, block in self.values.items():
            first, last = block[min(before, len(block) - 1)], block[min(before + 1, len(block) - 1)]
            values[name] = first if name in self.held else first * (1 - weight) + last * weight
        return values

    def device_time_ns(self, at_s: float) -> int:
        """Return what the device's clock shows `at_s` after the start [ns]."""
        start_s, drift_ppm = self.clock
        return round(1e9 * (start_s + at_s * (1 + 1e-6 * drift_ppm)))


@dataclass(frozen=True)
class _Board:
    """Writes frames of the home-made board, a hello before the first and once a second."""

    hello: Hello
    rate_hz: float

    def write(self, row: Mapping[str, NDArray], number: int, time_ns: int) -> bytes:
        """Return one frame, with the hello before it when it is time."""
        values = np.concatenate([np.ravel(row[signal.name]) for signal in self.hello.signals])
        data = self.hello.data_frame(number, time_ns // 1000, values)
        is_hello_due = number % round(HELLO_PERIOD_S * self.rate_hz) == 0
        return self.hello.frame() + data if is_hello_due else data


def write_session(script: Script, episode: Episode, scene: Scene, names: Sequence[str] = ()) -> tuple[SentStream, ...]:
    """Return the streams of a session that is played from a script.

    Parameters
    ----------
    script : Script
        What the hand sends.
    episode : Episode
        The episode of the script.
    scene : Scene
        In which it was simulated: says where the fingertips are, for the wrist's wrench.
    names : sequence of str
        `arm`, `pose`, `wrench`, `finger`, `board`; by default all.

    Raises
    ------
    UsageError
        When the episode has no arm or no object pose.
    UnknownNameError
        When a name is none of these.
    """
    makers: dict[str, Callable[[], SentStream]] = {
        "arm": lambda: _arm(script),
        "pose": lambda: _pose(script),
        "wrench": lambda: _wrench(script, episode, scene),
        "finger": lambda: _finger(script),
        "board": lambda: _board(script),
    }
    for name in names:
        if name not in makers:
            raise UnknownNameError("stream", name, tuple(makers))
    return tuple(make() for name, make in makers.items() if not names or name in names)


def _arm(script: Script) -> SentStream:
    """Return the arm: joints and targets, in the order of the device."""
    joints = next(signal.names for signal in stream("xarm").signals if signal.name == "joint_position")
    absent = [name for name in joints if name not in script.unwired_joints or name not in script.unwired_actuators]
    if absent:
        raise UsageError(
            "the episode has no arm",
            expected=", ".join(joints),
            found=", ".join(script.unwired_joints) or "no joint besides the hand's",
            fix="take a scene with an arm, such as --scene xarm7_xhand, or leave the arm out: --streams pose,wrench",
        )
    position = script.unwired_channels["joint_position"][:, [script.unwired_joints.index(name) for name in joints]]
    target = script.unwired_channels["action"][:, [script.unwired_actuators.index(name) for name in joints]]
    velocity = np.gradient(position, 1 / script.rate_hz, axis=0)
    values = {"joint_position": position, "joint_target": target, "joint_velocity": velocity}
    return _of("arm", "xarm", script, values, held=("joint_target",))


def _pose(script: Script) -> SentStream:
    """Return the tracker."""
    if "object_pose" not in script.unwired_channels:
        raise UsageError("the episode has no object pose", fix="take a scene with an object, or leave out pose")
    # A tracker gives what one image shows, not a mean: the row at or before it.
    values = {"object_pose": script.unwired_channels["object_pose"]}
    return _of("pose", "pose_lines", script, values, held=("object_pose",), delay_s=TRACKER_DELAY_S)


def _wrench(script: Script, episode: Episode, scene: Scene) -> SentStream:
    """Return the wrist sensor."""
    wrench = wrist_wrench(scene, episode["joint_position"][script.row], script)
    return _of("wrench", "ft300", script, {"wrench": wrench})


def _finger(script: Script) -> SentStream:
    """Return a fingertip on a wire of its own: the first of the hand."""
    return _of("finger", "paxini", script, {"taxels": script.taxel_counts[:, :1].astype(np.float64)}, held=("taxels",))


def _board(script: Script) -> SentStream:
    """Return a home-made board that reads the joints of the hand."""
    names = script.device.joint_names
    board = _Board(hello_of([Signal("joint_position", (len(names),), "rad", names)], RATE_HZ), RATE_HZ)
    values = {"joint_position": script.joint_position.astype(np.float64)}
    return _of("board", "cobs", script, values, write=board.write)


def _of(
    name: str,
    device_name: str,
    script: Script,
    values: Mapping[str, NDArray],
    *,
    write: Write | None = None,
    held: tuple[str, ...] = (),
    delay_s: float = 0.0,
) -> SentStream:
    """Return the stream of a device; its own encoder writes the frames unless `write` does."""
    device = stream(device_name)
    write = write or _encoder(device_name, device)
    # Not frame 0, before which a board says hello.
    frame = write({signal: block[0] for signal, block in values.items()}, 1, 0)
    return SentStream(
        name=name,
        device_name=device_name,
        link=device.link,
        rate_hz=device.rate_hz,
        values=values,
        script_hz=script.rate_hz,
        write=write,
        delay_s=delay_s,
        wire_s=wire_time_ns(len(frame), device.baud) * 1e-9,
        clock=CLOCKS.get(name, (0.0, 0.0)),
        held=held,
    )


def _encoder(device_name: str, device: StreamDevice) -> Write:
    """Return what writes one frame of a device."""
    encode, clock = device.encode, device.device_time
    if encode is None:
        raise UsageError(f"{device_name} cannot be emulated", expected="a device with an encoder")

    def write(values: Mapping[str, NDArray], _number: int, time_ns: int) -> bytes:
        rows = {signal: np.asarray(value)[None] for signal, value in values.items()}
        return encode({**rows, clock: np.array([time_ns])} if clock else rows)[0]

    return write


def wrist_wrench(scene: Scene, joint_position: NDArray, script: Script) -> NDArray[np.float64]:
    """Return `(n, 6) float64 [N, N m]`: the force and torque of the fingertips on the body that carries them.

    The sum of the forces and of their moments about that body's origin, in its axes; gravity and inertia of the hand
    are left out.

    Parameters
    ----------
    scene : Scene
        With fingertips in the order of the device.
    joint_position : ndarray
        `(n, J) float [rad]` of all joints of the scene.
    script : Script
        Gives the forces in the fingertips' frames.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    tips = [scene.file.fingertips.index(name) for name in script.device.fingertip_names]
    base = int(model.body_parentid[model.joint(script.device.joint_names[0]).bodyid[0]])
    out = np.zeros((len(joint_position), 6))
    posed: NDArray | None = None
    for k, position in enumerate(joint_position):
        if posed is None or (position != posed).any():
            data.qpos[scene.joint_qpos] = position
            mujoco.mj_kinematics(model, data)
            posed = position
        to_base = data.xmat[base].reshape(3, 3).T
        for tip, force in zip(tips, script.force[k], strict=True):
            place, axes = _fingertip(scene, data, tip)
            world_force = axes @ force
            out[k, :3] += to_base @ world_force
            out[k, 3:] += to_base @ np.cross(place - data.xpos[base], world_force)
    return out


def _fingertip(scene: Scene, data: mujoco.MjData, tip: int) -> tuple[NDArray, NDArray]:
    """Return where a fingertip is, and the axes of its force."""
    if scene.file.fingertip_frames:
        site = data.site(scene.file.fingertip_frames[tip])
        return site.xpos, site.xmat.reshape(3, 3)
    body = int(scene.fingertip_bodies[tip])
    return data.xpos[body], data.xmat[body].reshape(3, 3)
