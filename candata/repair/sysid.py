"""The diagnosis handed to mujoco.sysid: a model, free parameters with bounds, and the recorded sequences."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.datasets.drafts import place
from candata.effects import effect
from candata.errors import DataError, Where
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.replay.memory import ACT
from candata.gap.replay.starts import Starts, starts
from candata.repair.affine import FreeParameter, free_parameters
from candata.repair.copies import Copy, copy_scene
from candata.repair.mjcf import Change, apply_effects, fresh_folder
from candata.repair.parts import HeldEffect, OmittedEffect, omitted_effect
from candata.repair.script import IDENTIFY
from candata.scenes import Scene
from candata.scenes.model_file import compile_model, parse_model
from candata.schema.effect import EffectSetting
from candata.schema.record import ResultRecord
from candata.simulate.world import build_worlds

Array = NDArray[np.float64]
SENSOR, CONTROL = 0, 5  # `SignalType` of the toolbox (MuJoCo 4.0): MjSensor, MjCtrl
#: Names of the object's sensors in the exported model.
POSITION, ROTATION = "object_position", "object_rotation"
#: Time stamps are this much early, as the toolbox rounds their number up.
STAMP_ADVANCE = 1e-12
_COMMAND = "filter the controls in custom_rollout (a delay: also the actuator's own `delay` and `nsample`)"
_READING = "modify_residual, with signal_modifier.apply_delay, apply_bias or apply_gain"


class SysidExport(ResultRecord):
    """What an export for mujoco.sysid wrote."""

    folder: str
    model: str
    parameters: tuple[FreeParameter, ...]
    fixed: tuple[HeldEffect, ...]
    left: tuple[OmittedEffect, ...]
    sequences: int
    sensors: tuple[str, ...]
    changes: tuple[Change, ...] = ()

    @property
    def headline(self) -> str:
        """One line for people."""
        names = ", ".join(f"{p.name} {p.start[0]:.4g}" + (" ..." if p.start[1:] else "") for p in self.parameters)
        fixed_text = f"; fixed in the model: {', '.join(h.label for h in self.fixed)}" if self.fixed else ""
        return f"{self.model}: {self.sequences} sequences; free: {names or 'nothing'}{fixed_text}"


def export_sysid(scene: Scene, effects: Sequence[EffectSetting], dataset: Dataset, out: Path) -> SysidExport:
    """Return what was written to `out` for the toolbox mujoco.sysid, and what it cannot represent.

    `model.xml` holds the effects at their diagnosed values, `parameters.yaml` (as `ParameterDict.load_from_disk`
    reads it) starts there, `targets.json` says which numbers of the model each parameter sets, `sequences/` holds one
    file an episode (as `SystemTrajectory.load_from_disk` reads it), and `identify.py` puts them together.

    Raises
    ------
    UsageError
        When `out` exists, or an effect cannot act in the scene.
    DataError
        When the dataset is empty or does not fit the scene.
    """
    build_worlds(scene, [effects])
    if len(dataset) == 0:
        raise DataError("the dataset is empty", expected="recorded episodes", where=Where(path=str(dataset.path)))
    recs = recordings(scene, dataset.episodes())
    model_effects = [s for s in effects if _in_model(s)]
    with fresh_folder(out) as draft:
        copy = copy_scene(scene, "whole", draft / "out")
        sensors = _write_sensors(copy, scene, recs)
        changes = apply_effects(copy, scene, model_effects)
        model = compile_model(parse_model(copy.model), scene.name)
        free = _free(scene, model_effects, model)
        free_names = {p.effect for p in free}
        export = SysidExport(
            folder=str(out),
            model=str(copy.model.relative_to(copy.folder)),
            parameters=tuple(free),
            fixed=tuple(_held_effect(s) for s in model_effects if s.name not in free_names),
            left=tuple(_omitted_effect(s) for s in effects if s not in model_effects),
            sequences=len(recs),
            sensors=sensors,
            changes=tuple(changes),
        )
        _write(export, copy, scene, recs, model)
        place(copy.folder, out)
    return export


def _in_model(s: EffectSetting) -> bool:
    """Tell whether an effect is in the model alone: nothing of it in commands, readings, forces or the clock."""
    kind = effect(s.name)
    outside = (kind.command, kind.reading, kind.force, kind.friction, kind.drive, kind.servo, kind.pace)
    return kind.edit is not None and not any(outside)


def _held_effect(s: EffectSetting) -> HeldEffect:
    """Return an effect that the model holds."""
    return HeldEffect(name=s.name, element=s.element, parameters=s.parameters)


def _omitted_effect(s: EffectSetting) -> OmittedEffect:
    """Return an effect that the toolbox has no parameter for, and where its code takes it."""
    kind = effect(s.name)
    hook_texts = [text for hook, text in ((kind.command, _COMMAND), (kind.reading, _READING)) if hook is not None]
    apply = "; ".join(hook_texts) or omitted_effect(s, "").apply  # type: ignore[union-attr]
    reason = f"it is no number of the model: {kind.about}"
    return OmittedEffect(name=s.name, element=s.element, parameters=s.parameters, whole=True, why=reason, apply=apply)


def _free(scene: Scene, effects: Sequence[EffectSetting], model: mujoco.MjModel) -> list[FreeParameter]:
    """Return the parameters of all effects; of two that set the same number, the first."""
    out: list[FreeParameter] = []
    used_slots: set[tuple[str, str, str, int | None]] = set()
    for number in range(len(effects)):
        parameters = free_parameters(scene, effects, number, model)
        slots = {(p.kind, p.name, p.attribute, p.index) for f in parameters for part in f.places for p in part}
        if not slots & used_slots:
            out += parameters
            used_slots |= slots
    return out


def _write_sensors(copy: Copy, scene: Scene, recs: Recordings) -> tuple[str, ...]:
    """Write a model whose only sensors are what was recorded, all of whose elements have names; return the sensors."""
    spec = parse_model(copy.model)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for kind, elements in (("geom", spec.geoms), ("pair", spec.pairs), ("body", spec.bodies), ("joint", spec.joints)):
        used_names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                element.name = next(n for n in (f"{kind}_{number}{'_' * k}" for k in range(9)) if n not in used_names)
    kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
    names: list[str] = []
    if "joint_position" in recs.readings:
        for joint in scene.file.joints:
            spec.add_sensor(name=joint, type=kinds.mjSENS_JOINTPOS, objtype=objects.mjOBJ_JOINT, objname=joint)
            names.append(joint)
    if "object_pose" in recs.readings:
        for name, kind in ((POSITION, kinds.mjSENS_FRAMEPOS), (ROTATION, kinds.mjSENS_FRAMEQUAT)):
            spec.add_sensor(name=name, type=kind, objtype=objects.mjOBJ_XBODY, objname=scene.file.object)
            names.append(name)
    compile_model(spec, scene.name)
    copy.model.write_text(spec.to_xml())
    return tuple(names)


def _write(export: SysidExport, copy: Copy, scene: Scene, recs: Recordings, model: mujoco.MjModel) -> None:
    """Write parameters, targets, sequences, program and listing."""
    states = {
        p.name: {
            "name": p.name,
            "nominal": list(p.own),
            "min_value": list(p.low),
            "max_value": list(p.high),
            "value": list(p.start),
            "frozen": False,
        }
        for p in export.parameters
    }
    folder = copy.folder
    (folder / "parameters.yaml").write_text(yaml.safe_dump(states, default_flow_style=False))
    targets = {p.name: [[place.model_dump() for place in part] for part in p.places] for p in export.parameters}
    (folder / "targets.json").write_text(json.dumps(targets, indent=1) + "\n")
    (folder / "identify.py").write_text(IDENTIFY.replace("MODEL", export.model))
    (folder / "export.json").write_text(export.model_dump_json(indent=2) + "\n")
    (folder / "sequences").mkdir()
    begin = starts(scene, recs)
    for e, name in enumerate(recs.ids):
        np.savez(folder / "sequences" / f"{name}.npz", **_sequence(scene, recs, begin, e, model))


def _sequence(scene: Scene, recs: Recordings, begin: Starts, e: int, model: mujoco.MjModel) -> dict[str, Any]:
    """Return the arrays of one episode: controls at every physics step, readings where all are valid, the start.

    Forces ride along for the user's own residual; the toolbox does not read them.
    """
    first_row, stop_row = int(begin.rows[e]), int(recs.lengths[e])
    step, rate = float(model.opt.timestep), scene.file.rate_hz
    steps = max(1, round(1 / rate / step))
    control = np.zeros(((stop_row - first_row) * steps, model.nu))
    control[:, scene.actuator_ids] = np.repeat(recs.commands[e, first_row:stop_row], steps, axis=0)
    columns = [recs.readings[c][e, first_row:stop_row] for c in ("joint_position", "object_pose") if c in recs.readings]
    data = np.concatenate(columns, axis=1)
    is_read = np.isfinite(data).all(1)
    # The toolbox stamps what a step began with by the time at its end: readings have to come one physics step late.
    times = np.arange(stop_row - first_row) / rate + step
    out = {
        "control_times": np.arange(len(control)) * step * (1 - STAMP_ADVANCE),
        "control_data": control,
        "control_signal_mapping": _mapping([f"{model.actuator(a).name}_ctrl" for a in range(model.nu)], CONTROL, {}),
        "sensordata_times": times[is_read],
        "sensordata_data": data[is_read],
        "sensordata_signal_mapping": _sensor_mapping(model),
        "initial_state": _state(model, begin.take(np.array([e]))),
    }
    if "fingertip_force" in recs.readings:
        out["fingertip_force"] = recs.readings["fingertip_force"][e, first_row:stop_row][is_read]
    return out


def _sensor_mapping(model: mujoco.MjModel) -> Array:
    """Return the toolbox's mapping of all sensors."""
    sensors = [model.sensor(i) for i in range(model.nsensor)]
    return _mapping([s.name for s in sensors], SENSOR, {s.name: int(s.dim[0]) for s in sensors})


def _mapping(names: Sequence[str], kind: int, widths: dict[str, int]) -> Array:
    """Return names with their columns, as JSON in an array: how the toolbox stores what it measured."""
    out, start = {}, 0
    for name in names:
        width = widths.get(name, 1)
        out[name] = [kind, list(range(start, start + width))]
        start += width
    return np.asarray(json.dumps(out))


def _state(model: mujoco.MjModel, begin: Starts) -> Array:
    """Return the state of the model at the start of one episode as MuJoCo's rollout takes it."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = begin.qpos[0], begin.qvel[0]
    if begin.memory.size:
        data.act[:] = begin.memory[0, ACT : ACT + model.na]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state
