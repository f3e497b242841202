"""The only stepping loop: generation, replay under an observer and open-loop tosses all run through it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch
from numpy.typing import NDArray

from candata.effects import DriveStrength, DryFriction, Forces, Servos
from candata.errors import UsageError
from candata.rotation import conjugate, rotate
from candata.scenes import Scene
from candata.scenes.model_file import without_log
from candata.schema.effect import EffectSetting
from candata.simulate.closed_loop import ClosedLoop
from candata.simulate.contact_labels import row_labels
from candata.simulate.disturbances import Kicks
from candata.simulate.observer import Follower, Observer, Prescribed
from candata.simulate.servo_laws import DriveScales, ServoLaws, servo_laws, without_command_limits
from candata.simulate.timing import resample_control, retime_commands, steps_of
from candata.simulate.world import Filter, Worlds, build_worlds

Array = NDArray[np.float64]
#: Rows whose forces are read together where nothing acts on them. Chosen: one by one took a third of the loop's own
#: time (190 us a row of six simulations, 119 so).
ROWS = 16
#: State that positions and velocities do not hold: time, by which delays count, activations, past commands, plugins.
MEMORY = ("time", "act", "history", "plugin_state", "plastic")
#: Adds to the worlds of a batch what no effect is; it may bind the batch's live fields.
Alter = Callable[[mujoco_batch.Batch, Worlds], Worlds]
#: `(row, what the step begins with) -> (n, nv)` generalised forces to add, see `Hook` for forces.
Push = Callable[[int, Forces], Array]


@dataclass(frozen=True)
class Trajectory:
    """What n simulations read over T control steps.

    Attributes
    ----------
    readings : dict of str to ndarray
        `object_pose (n, T, 7)`, `joint_position (n, T, J)`, `fingertip_force (n, T, F, 3)` [N], as the sensors of
        the world report them; `joint_effort (n, T, J)` [N m; N of slides], what the actuators put on the joints, if
        asked for. Row 0 of forces and efforts is zero: they belong to the step before.
    touch : (n, T) bool
        Whether anything but the support touched the object in the step before the row.
    tip_force : (n, T, F) float64 [N]
        True size of the fingertips' forces, without sensing effects.
    failed : (n,) int64
        Row before which MuJoCo first warned of a simulation, T where it never did: from there on it means nothing (a
        state that is not finite begins anew from the model's own).
    qpos, qvel : (n, T, nq), (n, T, nv) float64
        True state; empty unless asked for.
    memory, first_memory : (n, M), (M,) float64
        What actuators and plugins remember at the last row, and as the model begins; empty unless the state was asked
        for.
    labels : dict of str to ndarray
        What a scene with labels tells, see `read_labels`: `(n, T, ...)` each.
    """

    readings: dict[str, Array]
    touch: NDArray[np.bool_]
    tip_force: Array
    failed: NDArray[np.int64]
    qpos: Array = field(default_factory=lambda: np.zeros(0))
    qvel: Array = field(default_factory=lambda: np.zeros(0))
    memory: Array = field(default_factory=lambda: np.zeros(0))
    first_memory: Array = field(default_factory=lambda: np.zeros(0))
    labels: dict[str, NDArray] = field(default_factory=dict)


def memory_size(model: mujoco.MjModel) -> int:
    """Return how many numbers M a model remembers beside positions and velocities; 0 where it remembers nothing."""
    size = model.na + model.nhistory + model.npluginstate + _plastic_size(model)
    return 1 + size if size else 0


def _plastic_size(model: mujoco.MjModel) -> int:
    """Return how many numbers of plastic deformation a model holds."""
    return int(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_PLASTIC))


def rollout(
    scene: Scene,
    commands: Array,
    qpos: Array,
    qvel: Array,
    effects: Sequence[Sequence[EffectSetting]],
    *,
    observer: Observer | Prescribed | Kicks | None = None,
    closed_loop: ClosedLoop | None = None,
    push: Push | None = None,
    instant_force: bool = False,
    keep_state: bool = False,
    read_effort: bool = False,
    settle: int = 0,
    threads: int = 1,
    alter: Alter | None = None,
    memory: Array | None = None,
    earlier_commands: Array | None = None,
    supply: Array | None = None,
) -> Trajectory:
    """Return the readings of n simulations that play recorded commands.

    Parameters
    ----------
    scene : Scene
        The nominal scene.
    commands : (n, T, A) float64
        Command held over each control step; `A` may be 0. A closed loop sets its own in place.
    qpos, qvel : (n, nq), (n, nv) float64
        State at row 0.
    effects : sequence of n sequences of EffectSetting
        Effects of each simulation.
    observer : Observer, Prescribed or Kicks, optional
        Pulls each state towards its recording, sets part of it, or kicks it; without it the simulations run free.
    closed_loop : ClosedLoop, optional
        Sets the commands row by row, in place, from what the sensors read.
    push : callable, optional
        Gives generalised forces to add over each control step, beside those of the effects.
    instant_force : bool
        Report the force of the last physics step instead of the mean over the control step.
    keep_state : bool
        Also keep qpos and qvel of each row.
    read_effort : bool
        Also read `joint_effort`.
    settle : int
        Rows before the recording begins: a clock that drifts does so from there.
    threads : int
        Threads of the pool; results do not depend on it.
    alter : callable, optional
        `(batch, worlds) -> worlds`, for stand-in real worlds that the effects cannot make.
    memory : (n, M) float64, optional
        What actuators and plugins remember at row 0, see `MEMORY`; by default what the model begins with.
    earlier_commands : (n, L, A) float64, optional
        Commands of the rows before row 0, which effects that delay commands remember; the first command by default.
    supply : (n, T, A) float64, optional
        Recorded supply of the actuators over its usual value, held over each control step; 1 by default.

    Raises
    ------
    UsageError
        When an effect cannot act in the scene, or not in a closed loop.
    """
    worlds, states = build_worlds(scene, effects), (np.asarray(qpos, float), np.asarray(qvel, float))
    run = _Run(scene, worlds, *states, threads, alter, push, read_effort)
    if memory is not None and memory.size:
        run.remember(memory)
    if earlier_commands is not None:
        run.hear(earlier_commands)
    run.supply = supply
    with without_log():  # warnings are counted
        return run.play(np.asarray(commands, float), observer, closed_loop, instant_force, keep_state, settle)


class _Run:
    """The state of one batch while it is played."""

    def __init__(
        self,
        scene: Scene,
        worlds: Worlds,
        qpos: Array,
        qvel: Array,
        threads: int,
        alter: Alter | None,
        push: Push | None,
        read_effort: bool,
    ) -> None:
        self.scene, self.push, self.n = scene, push, len(qpos)
        self.read_effort = read_effort
        self.batch = mujoco_batch.Batch(scene.model, self.n, threads)
        self.laws = servo_laws(scene, worlds.models) if worlds.servo else None
        if worlds.servo:
            worlds = replace(worlds, models=without_command_limits(worlds.models))
        self.batch.set_models(worlds.models)
        self.batch.bind("qpos")[:] = qpos
        self.batch.bind("qvel")[:] = qvel
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.object = scene.object_qpos if scene.object_id is not None else 0
        self.applied = self.batch.bind("qfrc_applied")
        self.worlds = worlds = alter(self.batch, worlds) if alter else worlds
        # Outputs are copied after every call: only where something reads them.
        needs_effort = worlds.force or worlds.friction or push or read_effort
        self.effort = self.batch.bind("qfrc_actuator") if needs_effort else np.zeros(0)
        self.supply: Array | None = None
        self.drive_scales = DriveScales(scene, worlds.models) if worlds.drive else None
        self.own_friction = np.array([model.dof_frictionloss for model in worlds.models])
        steps = steps_of(scene, worlds)
        self.groups = [(int(count), np.flatnonzero(steps == count)) for count in np.unique(steps)]
        kinds = ("command", "force", "friction", "drive", "servo", "reading")
        self.states = {kind: [f.state for f in getattr(worlds, kind)] for kind in kinds}
        parts = [self.batch.bind(name) for name in MEMORY] if memory_size(scene.model) else []
        self.memory = [part.reshape(self.n, -1) for part in parts]
        self.first_memory = self._remembered()[0] if parts and self.n else np.zeros(0)

    def remember(self, memory: Array) -> None:
        """Set what actuators and plugins remember `(n, M)`."""
        ends = np.cumsum([part.shape[1] for part in self.memory])
        for part, values in zip(self.memory, np.split(memory, ends[:-1], axis=1), strict=True):
            part[:] = values

    def hear(self, commands: Array) -> None:
        """Pass commands `(n, L, A)` of rows before the first through the effects that remember commands."""
        for row in range(commands.shape[1]):
            self._filter("command", np.repeat(commands[:, row][:, None], self.scene.substeps, axis=1))

    def _remembered(self) -> Array:
        """Return what actuators and plugins remember `(n, M)`."""
        return np.concatenate(self.memory, axis=1) if self.memory else np.zeros((self.n, 0))

    def play(
        self,
        commands: Array,
        observer: Observer | Prescribed | Kicks | None,
        closed_loop: ClosedLoop | None,
        instant: bool,
        keep: bool,
        settle: int,
    ) -> Trajectory:
        """Step through all rows and collect the readings."""
        scene, count, substeps = self.scene, commands.shape[1], self.scene.substeps
        drifting_ids = np.flatnonzero(self.worlds.pace != 1)
        if len(drifting_ids) and closed_loop is not None:
            raise UsageError("a clock that drifts cannot act in a closed loop", fix="leave clock_drift out")
        retimed_commands = retime_commands(commands[drifting_ids], self.worlds.pace[drifting_ids], substeps, settle)
        follower = Follower(scene, observer) if isinstance(observer, Observer) else observer
        rows_together = 1 if self.worlds.force or self.push or closed_loop else ROWS
        force = np.zeros((1, self.n, len(scene.force_sensors), 3))
        sensor_data, touch = self._nothing(), np.zeros(self.n, bool)
        unread_rows: list[tuple[dict[str, Array], list[Array]]] = []
        rows: dict[str, list[Array]] = {}
        labels: dict[str, list[NDArray]] = {}
        touches, sizes, states = [], [], []
        failed_row = np.full(self.n, count)
        for k in range(count):
            state = self._readings()
            unread_rows.append((state, sensor_data))
            if len(unread_rows) == rows_together or k + 1 == count:
                data_rows = [data for _, data in unread_rows]
                force = self._forces(data_rows, instant)
                for name, values in row_labels(scene, self.groups, data_rows, instant).items():
                    labels.setdefault(name, []).append(values)
                sizes.append(np.sqrt((force**2).sum(-1)))
                self._read(rows, [each for each, _ in unread_rows], force)
                unread_rows = []
            touches.append(touch)
            if keep:
                states.append((self.qpos.copy(), self.qvel.copy()))
            if follower is not None:
                follower.correct(k, state, touch, self.qpos, self.qvel)
            if closed_loop is not None:
                now = {name: values[-1] for name, values in rows.items()}
                closed_loop.set_commands(k, now, commands)
            if k + 1 < count:
                held_commands = np.repeat(commands[:, k][:, None], substeps, axis=1)
                held_commands[drifting_ids] = retimed_commands[:, k]
                self._apply_forces(k, force[-1], touch)
                self._apply_friction()
                self._apply_strength(k)
                sensor_data, touch = self._step(held_commands)
                failed_row[self.batch.warning[:, :, 1].any(1) & (failed_row == count)] = k + 1
        qpos, qvel = [np.stack(s, 1) for s in zip(*states, strict=True)] or [np.zeros(0), np.zeros(0)]
        readings = {n: np.stack(v, 1) for n, v in rows.items()}
        tip_force = np.concatenate(sizes).swapaxes(0, 1)
        joined = {name: np.concatenate(values).swapaxes(0, 1) for name, values in labels.items()}
        trajectory = Trajectory(readings, np.stack(touches, 1), tip_force, failed_row, qpos, qvel, labels=joined)
        return replace(trajectory, memory=self._remembered(), first_memory=self.first_memory) if keep else trajectory

    def _readings(self) -> dict[str, Array]:
        """Return what perfect sensors but those of force read now."""
        scene = self.scene
        out: dict[str, Array] = {}
        if scene.object_id is not None:
            out["object_pose"] = self.qpos[:, self.object : self.object + 7].copy()
        if len(scene.joint_qpos):
            out["joint_position"] = self.qpos[:, scene.joint_qpos]
            if self.read_effort:
                out["joint_effort"] = self.effort[:, scene.joint_dof]
        return out

    def _nothing(self) -> list[Array]:
        """Return what the sensors read before the first step, for each number of physics steps."""
        return [np.zeros((len(ids), steps, self.scene.model.nsensordata)) for steps, ids in self.groups]

    def _forces(self, sensor_data: Sequence[list[Array]], instant: bool) -> Array:
        """Return the forces `(R, n, F, 3)` on the fingertips in their frames, of R rows together: few at once cost as
        much as one.
        """
        scene = self.scene
        force = np.zeros((len(sensor_data), self.n, len(scene.force_sensors), 3))
        if not len(scene.force_sensors):
            return force
        for (_, ids), group_data in zip(self.groups, zip(*sensor_data, strict=True), strict=True):
            data = np.stack(group_data)
            net = data[..., scene.force_sensors]
            for tip, address in scene.internal_sensors.items():
                net[..., tip, :] -= data[..., address]
            local = rotate(conjugate(data[..., scene.frame_sensors]), net)
            force[:, ids] = local[:, :, -1] if instant else local.mean(2)
        return force

    def _read(self, rows: dict[str, list[Array]], states: Sequence[dict[str, Array]], forces: Array) -> None:
        """Add to `rows` what the sensors of the worlds read of states and forces `(R, n, F, 3)`."""
        for state, force in zip(states, forces, strict=True):
            x = {**state, "fingertip_force": force} if force.shape[1] else state
            for name, value in self._filter("reading", x).items():
                rows.setdefault(name, []).append(value)

    def _filter(self, kind: str, x):
        """Pass x through the hooks of one kind."""
        filters: tuple[Filter, ...] = getattr(self.worlds, kind)
        for i, f in enumerate(filters):
            self.states[kind][i], x = f.apply(self.states[kind][i], x)
        return x

    def _apply_forces(self, row: int, tip_force: Array, touch: NDArray[np.bool_]) -> None:
        """Set the generalised forces that are added over the next step."""
        if not self.worlds.force and self.push is None:
            return
        no_force = np.zeros((self.n, self.scene.model.nv))
        x = Forces(no_force, self.qpos.copy(), self.qvel.copy(), self.effort.copy(), tip_force, touch)
        x = self._filter("force", x)
        self.applied[:] = x.added if self.push is None else x.added + self.push(row, x)

    def _apply_friction(self) -> None:
        """Set the limits of dry friction over the next step, in the models, which are private then."""
        if not self.worlds.friction:
            return
        x = DryFriction(np.zeros_like(self.own_friction), self.qvel.copy(), self.effort.copy())
        limits = self.own_friction + self._filter("friction", x).added
        for model, row in zip(self.worlds.models, limits, strict=True):
            model.dof_frictionloss[:] = row

    def _apply_strength(self, row: int) -> None:
        """Set how strong the drives are over the next step, in the models, which are private then."""
        if self.drive_scales is None:
            return
        usual = np.ones((self.n, len(self.scene.actuator_ids)))
        x = DriveStrength(usual, usual if self.supply is None else self.supply[:, row])
        self.drive_scales.set(self._filter("drive", x).strength)

    def _step(self, commands: Array) -> tuple[list[Array], NDArray[np.bool_]]:
        """Advance one row under commands `(n, S, A)`; return what the sensors of the worlds read at each physics step
        `(n, steps, .)`, for each number of these, and touch `(n,)`.
        """
        scene = self.scene
        control = None
        if len(scene.actuator_ids):
            control = np.zeros((self.n, commands.shape[1], scene.model.nu))
            control[:, :, scene.actuator_ids] = self._filter("command", commands)
        sensor_data, touch = [], np.zeros(self.n, bool)
        for steps, ids in self.groups:
            group_control = None if control is None else resample_control(control[ids], steps)
            data = self._advance(steps, ids, group_control)
            sensor_data.append(data)
            if len(scene.touch_sensors):
                touch[ids] = (data[:, :, scene.touch_sensors] > 0).any((1, 2))
        return sensor_data, touch

    def _advance(self, steps: int, ids: NDArray[np.int64], control: Array | None) -> Array:
        """Advance the simulations `ids` by physics steps under controls `(m, steps, nu)`; return what sensors read.

        One by one where effects change what servos take: the same steps, to the bit.
        """
        group_ids = None if len(self.groups) == 1 else ids
        if self.laws is None or control is None:
            return self.batch.rollout(steps, control, record=("sensordata",), ids=group_ids)["sensordata"]
        data = []
        for k in range(steps):
            taken = self._taken(self.laws, ids, control[:, k])[:, None]
            data.append(self.batch.rollout(1, taken, record=("sensordata",), ids=group_ids)["sensordata"])
        return np.concatenate(data, axis=1)

    def _taken(self, laws: ServoLaws, ids: NDArray[np.int64], control: Array) -> Array:
        """Return what the servos of the simulations `ids` take of controls `(m, nu)` in one physics step."""
        actuators = self.scene.actuator_ids
        command = np.zeros((self.n, len(actuators)))
        command[ids] = control[:, actuators]
        x = Servos(np.clip(command, laws.lowest, laws.highest), laws.idle(self.qpos))
        taken = control.copy()
        taken[:, actuators] = self._filter("servo", x).command[ids]
        return taken


def at_rest(scene: Scene, n: int) -> tuple[Array, Array]:
    """Return `(qpos (n, nq), qvel (n, nv))` of the model's own start."""
    qpos = np.repeat(np.asarray(scene.model.qpos0, float)[None], n, axis=0)
    return qpos, np.zeros((n, scene.model.nv))
