"""The command file: motions as a Parquet table that a simulation, and a robot, can play."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from candata.align import grid, period_ns, resample
from candata.datasets.writing import replacing
from candata.errors import DataError, UsageError, Where
from candata.formats._columns import numbers, read_columns
from candata.policies._contract import Array, Motion, Plan
from candata.policies._drive import command_range
from candata.policies._postures import finish
from candata.scenes import Scene
from candata.scenes.motors import affine_law
from candata.schema.json_text import parse_json

#: Columns beside the actuators': time from the start of the motion, and its name where there are several.
TIME, MOTION = "time_s", "motion"
#: Key of the metadata of the table (JSON), and of a column's unit.
_KEY, _UNIT = b"candata", b"unit"
#: The stamps of a file at the scene's rate lie this close to the beat [share of a period].
_ON_BEAT_SHARE = 0.01
#: A command passes a limit when it does so by more than this share of the range: text and float32 round.
_ROUNDING_SHARE = 1e-6


@dataclass(frozen=True)
class MotionFile:
    """What a command file holds.

    Attributes
    ----------
    motions : tuple of Motion
        At the scene's rate, within its limits.
    scene_digest : str or None
        Of the scene that the motions were made for.
    digest : str
        SHA-256 over the motions: the same commands have the same, however they were written.
    """

    motions: tuple[Motion, ...]
    scene_digest: str | None
    digest: str


def write_motions(path: str | Path, scene: Scene, motions: Sequence[Motion]) -> Path:
    """Return the path of the command file, written whole or not at all.

    Parameters
    ----------
    path : str or Path
        A `.parquet` file: `time_s` from the start of each motion, one column an actuator with its unit in the
        column's metadata, and `motion` where there are several.
    scene : Scene
        For names, units, rate and digest.
    motions : sequence of Motion

    Raises
    ------
    SetupError
        When it cannot be written.
    """
    path = Path(path)
    lengths = [len(m.commands) for m in motions]
    all_commands = np.concatenate([m.commands for m in motions])
    columns = {TIME: np.concatenate([np.arange(n) for n in lengths]) / scene.file.rate_hz}
    if len(motions) > 1:
        columns[MOTION] = np.repeat([m.name for m in motions], lengths)
    columns |= {name: all_commands[:, i] for i, name in enumerate(scene.file.actuator_names)}
    units = {TIME: "s"} | dict(zip(scene.file.actuator_names, command_units(scene), strict=True))
    arrays = [pa.array(v) for v in columns.values()]
    fields = [
        pa.field(n, a.type, metadata={_UNIT: units[n]} if n in units else None)
        for n, a in zip(columns, arrays, strict=True)
    ]
    metadata = {
        "names": [m.name for m in motions],
        "scene": scene.name,
        "scene_digest": scene.digest,
        "rate_hz": scene.file.rate_hz,
        "object_shift_m": [[float(v) for v in m.object_shift_m] for m in motions],
    }
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={_KEY: json.dumps(metadata)}))
    with replacing(path, "motion") as draft:
        pq.write_table(table, draft, compression="zstd")
    return path


def read_motions(path: str | Path, scene: Scene) -> MotionFile:
    """Return the motions of a command file, at the scene's rate and within its limits.

    A file of another rate is resampled: each command holds until the next. Columns that are neither time nor an
    actuator are left alone; a file without metadata counts as written for this scene, in its units.

    Raises
    ------
    UsageError
        When the scene has no actuators, or the file is no Parquet table.
    DataError
        When the file is missing or damaged, lacks an actuator, or holds what cannot be played: no number, time that
        does not rise, gaps, a command beyond its limits, another unit.
    """
    path = Path(path)
    if not len(scene.actuator_ids):
        raise UsageError(f"scene {scene.name} has no actuators to play a policy file", where=Where(path=str(path)))
    if path.suffix.lower() != ".parquet":
        raise UsageError("a policy file is a Parquet table", expected="a .parquet file", found=path.name)
    if not path.is_file():
        raise DataError("the policy file does not exist", found="no such file", where=Where(path=str(path)))
    names = scene.file.actuator_names
    columns = read_columns(path, [TIME, *names])
    schema = pq.read_schema(path)
    _check_units(schema, scene, path)
    metadata = _metadata(schema)
    values = np.stack([numbers(columns[n], n, path) for n in names], axis=1)
    time_s = numbers(columns[TIME], TIME, path)
    _check_finite(np.c_[time_s, values], (TIME, *names), path)
    parts = _parts(path, schema, len(time_s), metadata)
    shifts = _shifts(metadata, len(parts))
    motions = []
    for (name, rows), shift in zip(parts, shifts, strict=True):
        commands = _on_beat(scene, time_s[rows], values[rows], rows, path)
        motions.append(Motion(name, commands, shift))
    _check_limits(scene, motions, path)
    return MotionFile(tuple(motions), metadata.get("scene_digest"), motions_digest(motions))


def motion_plan(scene: Scene, motion: Motion, rng: np.random.Generator) -> Plan:
    """Return the plan of a motion: its commands as they are, the object placed at random about where it belongs."""
    return finish(scene, motion.commands, rng, shift=motion.object_shift_m, dither=False)


def motions_digest(motions: Sequence[Motion]) -> str:
    """Return the SHA-256 over names, commands and places of motions."""
    sha256 = hashlib.sha256()
    for m in motions:
        sha256.update(m.name.encode() + m.commands.tobytes() + np.asarray(m.object_shift_m, float).tobytes())
    return sha256.hexdigest()


def command_units(scene: Scene) -> tuple[str, ...]:
    """Return the unit of each actuator's command: of its joint for a position servo, else of its force, else 1."""
    return tuple(_unit(scene, int(a)) for a in scene.actuator_ids)


def _unit(scene: Scene, actuator: int) -> str:
    """Return the unit of one actuator's command."""
    model = scene.model
    if actuator not in scene.driven_joints:
        return "1"
    slide = model.jnt_type[scene.driven_joints[actuator]] == mujoco.mjtJoint.mjJNT_SLIDE
    if _is_position_servo(model, actuator):
        return "m" if slide else "rad"
    return "N" if slide else "N m"


def _is_position_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Tell whether an actuator's command is the position of its joint: gain and bias cancel there (MuJoCo manual)."""
    (gain,), bias = affine_law(model, [actuator])
    return bool(gain != 0 and np.isclose(-bias[0, 1], gain))


def command_limits(scene: Scene) -> Array:
    """Return `(A, 2)` what a command may be: the control range, for a position servo within its joint's range."""
    limits, model = command_range(scene).copy(), scene.model
    for i, actuator in enumerate(scene.actuator_ids.tolist()):
        joint = scene.driven_joints.get(actuator)
        if joint is not None and model.jnt_limited[joint] and _is_position_servo(model, actuator):
            low, high = model.jnt_range[joint]
            limits[i] = max(limits[i, 0], low), min(limits[i, 1], high)
    return limits


def _metadata(schema: pa.Schema) -> dict:
    """Return the metadata that candata writes; empty in a file of another's."""
    try:
        metadata = parse_json((schema.metadata or {}).get(_KEY, b"{}"))
    except ValueError:
        return {}
    return metadata if isinstance(metadata, dict) else {}


def _shifts(metadata: dict, count: int) -> list[Array]:
    """Return where the object stands in each motion; its own place where the file does not say."""
    shifts = np.zeros((count, 3))
    try:
        stored_shifts = np.asarray(metadata.get("object_shift_m", shifts), float)
    except (TypeError, ValueError):
        return list(shifts)
    return list(stored_shifts if stored_shifts.shape == shifts.shape and np.isfinite(stored_shifts).all() else shifts)


def _parts(path: Path, schema: pa.Schema, count: int, metadata: dict) -> list[tuple[str, NDArray[np.int64]]]:
    """Return the name and rows of each motion, in the file's order."""
    if MOTION not in schema.names:
        names = metadata.get("names")
        return [(str(names[0]) if names else path.stem, np.arange(count))]
    labels = read_columns(path, [MOTION])[MOTION].astype(str)
    return [(str(n), np.flatnonzero(labels == n)) for n in dict.fromkeys(labels.tolist())]


def _check_units(schema: pa.Schema, scene: Scene, path: Path) -> None:
    """Refuse a column whose unit is said, and another than the scene's."""
    for name, unit in zip(scene.file.actuator_names, command_units(scene), strict=True):
        stored_unit = (schema.field(name).metadata or {}).get(_UNIT, unit.encode()).decode()
        if stored_unit != unit:
            raise DataError(
                f"commands of {name} are in another unit",
                expected=unit,
                found=stored_unit,
                where=Where(path=str(path), channel=name),
                fix=f"convert the column to {unit}",
            )


def _check_finite(values: Array, names: Sequence[str], path: Path) -> None:
    """Refuse what is no number."""
    bad_places = np.argwhere(~np.isfinite(values))
    if len(bad_places):
        row, column = (int(i) for i in bad_places[0])
        raise DataError(
            "a command is no number" if column else "a time is no number",
            expected="finite numbers",
            found=f"{values[row, column]} ({len(bad_places)} such values)",
            where=Where(path=str(path), channel=names[column], index=row),
        )


def _on_beat(scene: Scene, time_s: Array, values: Array, rows: NDArray[np.int64], path: Path) -> Array:
    """Return `(T, A)` commands at the scene's rate."""
    if len(time_s) < 2:
        raise DataError(
            "a motion is too short", expected="at least 2 rows", found=str(len(time_s)), where=Where(path=str(path))
        )
    falling_rows = np.flatnonzero(np.diff(time_s) <= 0)
    if len(falling_rows):
        raise DataError(
            "time does not rise",
            expected=f"more than {time_s[falling_rows[0]]:g} s",
            found=f"{time_s[falling_rows[0] + 1]:g} s",
            where=Where(path=str(path), channel=TIME, index=int(rows[falling_rows[0] + 1])),
        )
    rate_hz = scene.file.rate_hz
    if np.abs((time_s - time_s[0]) * rate_hz - np.arange(len(time_s))).max() < _ON_BEAT_SHARE:
        return values
    stamps = np.round((time_s - time_s[0]) * 1e9).astype(np.int64)
    beat_ns = grid(0, int(stamps[-1]), rate_hz)
    resampled_commands = resample(stamps, values, beat_ns, "command")
    if len(beat_ns) < 2 or not resampled_commands.valid.all():
        gap = int(np.argmax(np.diff(stamps)))
        raise DataError(
            "a motion has a gap",
            expected=f"a command every {1e-9 * period_ns(stamps):g} s",
            found=f"{1e-9 * float(stamps[gap + 1] - stamps[gap]):g} s without",
            where=Where(path=str(path), channel=TIME, index=int(rows[gap + 1])),
            fix="write every command, also where it does not change",
        )
    return np.asarray(resampled_commands.values, float)


def _check_limits(scene: Scene, motions: Sequence[Motion], path: Path) -> None:
    """Refuse a command beyond its limits."""
    low, high = command_limits(scene).T
    slack = _ROUNDING_SHARE * (high - low)
    for m in motions:
        bad_places = np.argwhere((m.commands < low - slack) | (m.commands > high + slack))
        if len(bad_places):
            row, i = (int(v) for v in bad_places[0])
            unit = command_units(scene)[i]
            raise DataError(
                f"motion {m.name!r} goes beyond a limit",
                expected=f"{low[i]:g} to {high[i]:g} {unit}",
                found=f"{m.commands[row, i]:g} {unit} at {row / scene.file.rate_hz:g} s",
                where=Where(path=str(path), channel=scene.file.actuator_names[i]),
                fix="is the unit right? rad and m, not deg and mm",
            )
