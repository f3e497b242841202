"""Defects that real recordings have, made on purpose: what `candata validate` must find.

Each is a pure function of stored arrays: nothing is checked, so it makes what an `Episode` refuses, as a foreign
writer might. `inject` damages a share of a dataset's episodes and gives them as stored episodes; `write` stores them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from candata.checks._sensor_defects import (
    contact_inverted,
    encoder_spiked,
    fall_scaled,
    finger_dead,
    force_drift,
    force_in_grams,
    force_late,
    force_nan,
    force_saturated,
    joint_beyond_limits,
    joint_stuck,
    object_far,
    object_sunk,
    pose_in_millimetres,
    quaternion_not_unit,
    quaternion_swapped,
    supply_sagged,
    torque_off,
)
from candata.checks._time_defects import (
    Damage,
    action_shifted,
    clock_drift,
    joint_dead,
    rows_dropped,
    rows_dropped_unseen,
    rows_late,
    stamps_scaled,
    time_jump,
)
from candata.checks._unit_defects import (
    all_in_degrees,
    commands_in_degrees,
    exchange_columns,
    force_divided,
    force_instant,
    force_mirrored,
    force_negated,
    force_turned,
    joint_in_degrees,
    pose_lost,
    quaternion_conjugated,
    tip_divided,
    world_exchanged,
    world_mirrored,
)
from candata.datasets import Dataset, RawEpisode, append, create_dataset
from candata.datasets.encode import hash_columns, meta_json
from candata.errors import DataError, UnknownNameError
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage

#: Gram-force a newton (standard gravity, CGPM 1901).
GRAM_FORCE = 1 / 9.80665e-3


@dataclass(frozen=True)
class Defect:
    """One way in which recordings are wrong.

    Attributes
    ----------
    meaning : str
        One line for people.
    channels : tuple of str
        Channels without which an episode cannot have it.
    rules : tuple of str
        Rules of `candata validate` of which at least one must find it.
    severity : float
        The usual size, in `unit`.
    unit : str
        What the size is measured in; "1" where it makes no difference.
    milder : tuple of float
        Smaller sizes, down to what nobody can find.
    damage : callable
        Makes it.
    """

    meaning: str
    channels: tuple[str, ...]
    rules: tuple[str, ...]
    damage: Damage
    severity: float = 1.0
    unit: str = "1"
    milder: tuple[float, ...] = ()


_FORCE, _POSE, _DRIVE = ("fingertip_force",), ("object_pose",), ("joint_position", "action")
_MATCH = ("scene_match",)
#: Name of a defect to what it is; the first ten are those of other validators' test.
DEFECTS: Mapping[str, Defect] = MappingProxyType(
    {
        "contact_inverted": Defect(
            "contact flags inverted", ("contact",), ("contact_flags", "contact_motion"), contact_inverted
        ),
        "force_in_grams": Defect(
            "forces in gram-force",
            _FORCE,
            ("force_unit", "scale"),
            force_in_grams,
            GRAM_FORCE,
            "1",
            (30.0, 10.0, 3.0, 1.3),
        ),
        "force_late": Defect(
            "forces late", _FORCE, ("force_delay", "contact_flags"), force_late, 0.2, "s", (0.1, 0.05, 0.025, 0.0125)
        ),
        "force_drift": Defect(
            "tare of the forces drifts", _FORCE, ("force_drift",), force_drift, 2.0, "N", (1.0, 0.5, 0.25, 0.1)
        ),
        "finger_dead": Defect("one fingertip reads nothing", _FORCE, ("dead_finger",), finger_dead),
        "force_saturated": Defect(
            "forces end at a limit", _FORCE, ("saturation",), force_saturated, 2.0, "N", (3.0, 4.0, 6.0, 8.0)
        ),
        "force_nan": Defect("NaN in forces", _FORCE, ("finite",), force_nan, 0.05, "1", (0.0,)),
        "pose_in_millimetres": Defect(
            "poses in millimetres",
            _POSE,
            ("pose_unit", "scale", "free_fall"),
            pose_in_millimetres,
            1000.0,
            "1",
            (100.0, 10.0, 3.0),
        ),
        "quaternion_not_unit": Defect(
            "quaternions not unit", _POSE, ("quaternions",), quaternion_not_unit, 0.1, "1", (0.01, 0.002, 0.0005)
        ),
        "quaternion_swapped": Defect("quaternions x y z w", _POSE, ("quaternion_order",), quaternion_swapped),
        "joint_dead": Defect("a joint never follows", _DRIVE, ("dead_joint",), joint_dead),
        "rows_dropped": Defect("rows dropped", ("time_ns",), ("time",), rows_dropped, 0.05, "1", (0.02, 0.01, 0.0)),
        "rows_dropped_unseen": Defect(
            "rows dropped, stamps made even", _DRIVE, ("jumps",), rows_dropped_unseen, 0.3, "s", (0.1, 0.05)
        ),
        "time_jump": Defect("the clock jumps ahead", ("time_ns",), ("time",), time_jump, 0.5, "s", (0.1, 0.03)),
        "clock_drift": Defect("streams drift apart", _DRIVE, ("stream_drift",), clock_drift, 0.2, "s", (0.1, 0.05)),
        "action_shifted": Defect(
            "commands logged late", _DRIVE, ("command_lag",), action_shifted, 5.0, "rows", (2.0, 1.0)
        ),
        "joint_beyond_limits": Defect(
            "joints beyond their limits",
            ("joint_position",),
            ("joint_limits",),
            joint_beyond_limits,
            0.5,
            "rad",
            (0.2, 0.1),
        ),
        "object_sunk": Defect(
            "the object sinks into its support", _POSE, ("penetration",), object_sunk, 0.03, "m", (0.015, 0.008)
        ),
        "object_far": Defect(
            "contact far from the object",
            ("object_pose", "fingertip_force"),
            ("proximity",),
            object_far,
            0.2,
            "m",
            (0.1, 0.05),
        ),
        "fall_scaled": Defect(
            "free flight is no free fall", _POSE, ("free_fall",), fall_scaled, 0.5, "1", (0.2, 0.1, 0.05)
        ),
        "all_in_degrees": Defect("joints and commands in degrees", _DRIVE, _MATCH, all_in_degrees),
        "commands_in_degrees": Defect("commands in degrees", _DRIVE, _MATCH, commands_in_degrees),
        "force_in_kilograms": Defect("forces in kilogram-force", _FORCE, _MATCH, force_divided, 9.80665, "1"),
        "tips_exchanged": Defect(
            "two fingertips exchanged", _FORCE, _MATCH, exchange_columns("fingertip_force"), 1.0, "columns"
        ),
        "joints_exchanged": Defect(
            "two joints exchanged", _DRIVE, _MATCH, exchange_columns("joint_position"), 1.0, "columns"
        ),
        "commands_exchanged": Defect(
            "two commands exchanged", _DRIVE, _MATCH, exchange_columns("action"), 1.0, "columns"
        ),
        "pairs_exchanged": Defect(
            "two joints exchanged, and their commands",
            _DRIVE,
            _MATCH,
            exchange_columns("joint_position", "action"),
            1.0,
            "columns",
        ),
        "tip_in_kilograms": Defect("one fingertip in kilogram-force", _FORCE, _MATCH, tip_divided, 9.80665, "1"),
        "force_negated": Defect("forces that fingertips exert", _FORCE, _MATCH, force_negated),
        "force_turned": Defect("axes of the forces in another order", _FORCE, _MATCH, force_turned),
        "force_mirrored": Defect("one axis of the forces reversed", _FORCE, _MATCH, force_mirrored),
        "force_rows_late": Defect(
            "forces some rows late", _FORCE, _MATCH, rows_late("fingertip_force"), 3.0, "rows", (2.0, 1.0)
        ),
        "pose_rows_late": Defect(
            "poses some rows late", _POSE, _MATCH, rows_late("object_pose"), 3.0, "rows", (2.0, 1.0)
        ),
        "quaternion_conjugated": Defect("quaternions from world to body", _POSE, _MATCH, quaternion_conjugated),
        "world_mirrored": Defect("poses in a left-handed world, y reversed", _POSE, _MATCH, world_mirrored),
        "world_exchanged": Defect("poses in a left-handed world, x and y exchanged", _POSE, _MATCH, world_exchanged),
        "action_previous": Defect("rows hold the command before", _DRIVE, _MATCH, rows_late("action"), 1.0, "rows"),
        "force_instant": Defect("forces of one instant, not of the step", _FORCE, _MATCH, force_instant),
        "pose_lost": Defect("poses at the origin", _POSE, ("lost_poses",), pose_lost, 0.02, "1", (0.01,)),
        "stamps_scaled": Defect(
            "stamps twice as far apart", ("time_ns",), ("time", "scene_match"), stamps_scaled, 2.0, "1", (0.5,)
        ),
        "encoder_spiked": Defect(
            "joint readings jump out for one row",
            ("joint_position",),
            ("encoder_spikes",),
            encoder_spiked,
            float(np.pi),
            "rad",
            (0.5, 0.2, 0.1),
        ),
        "joint_stuck": Defect(
            "a joint reading is repeated within a motion",
            ("joint_position",),
            ("stuck_readings",),
            joint_stuck,
            6.0,
            "rows",
            (5.0, 4.0),
        ),
        "supply_sagged": Defect(
            "the supply sags under load", ("action",), ("supply_sag",), supply_sagged, 0.3, "1", (0.2, 0.15, 0.05)
        ),
        "torque_off": Defect(
            "a servo is switched off", ("action",), ("torque_off",), torque_off, 0.3, "1", (0.1, 0.02)
        ),
        "joint_in_degrees": Defect("joints in degrees", ("joint_position",), ("scale", "joint_unit"), joint_in_degrees),
    }
)


def names() -> tuple[str, ...]:
    """Return the names of all defects."""
    return tuple(DEFECTS)


def defect(name: str) -> Defect:
    """Return a defect.

    Raises
    ------
    UnknownNameError
        When there is none of this name.
    """
    if name not in DEFECTS:
        raise UnknownNameError("defect", name, DEFECTS)
    return DEFECTS[name]


def with_defect(
    episode: Episode | RawEpisode, name: str, rng: np.random.Generator, severity: float | None = None
) -> RawEpisode:
    """Return an episode as it would be stored with a defect; its hash is that of what is stored.

    Parameters
    ----------
    episode : Episode or RawEpisode
        What to damage; left as it is.
    name : str
        The defect.
    rng : numpy.random.Generator
        Where chance has a say.
    severity : float, optional
        Its size, in the defect's unit; the usual one when omitted.

    Raises
    ------
    UnknownNameError
        When there is no such defect.
    DataError
        When the episode lacks a channel that the defect is in.
    """
    kind, raw = defect(name), as_stored(episode)
    missing_channels = [channel for channel in kind.channels if channel not in raw.arrays]
    if missing_channels:
        raise DataError(
            f"{name} cannot be injected", expected=", ".join(kind.channels), found=f"no {missing_channels[0]}"
        )
    arrays = kind.damage(dict(raw.arrays), raw.meta().rate_hz, kind.severity if severity is None else severity, rng)
    return with_arrays(raw, arrays)


def with_derived_flags(raw: RawEpisode) -> RawEpisode:
    """Return the episode with its contact flags derived from its forces as they are, as an import does."""
    if "fingertip_force" not in raw.arrays:
        return raw
    tips = fingertip_contact(raw.arrays["fingertip_force"])
    return with_arrays(raw, dict(raw.arrays) | {"fingertip_contact": tips, "contact": np.asarray(tips.any(axis=1))})


def with_arrays(raw: RawEpisode, arrays: Mapping[str, NDArray], record: str | None = None) -> RawEpisode:
    """Return the episode with other columns, and another record if one is given, hashed as it is then."""
    text = record or raw.meta_json
    rows = len(arrays.get("time_ns", ()))
    return replace(raw, meta_json=text, arrays=dict(arrays), stored_hash=hash_columns(text, arrays), rows=rows)


def as_stored(episode: Episode | RawEpisode) -> RawEpisode:
    """Return an episode as it would be stored, sound."""
    if isinstance(episode, RawEpisode):
        return episode
    text = meta_json(episode.meta)
    digest = hash_columns(text, episode.arrays)
    return RawEpisode(episode.meta.id, text, dict(episode.arrays), digest, 0, len(episode))


def inject(
    dataset: Dataset | Sequence[Episode],
    name: str,
    rng: np.random.Generator,
    share: float = 1.0,
    severity: float | None = None,
) -> Iterator[RawEpisode]:
    """Yield all episodes as stored, a share of them damaged.

    Parameters
    ----------
    dataset : Dataset or sequence of Episode
        What to damage; it is only read.
    name : str
        The defect.
    rng : numpy.random.Generator
        Chooses the episodes, and what the defect leaves to chance.
    share : float
        Share of the episodes to damage, at least one.
    severity : float, optional
        As for `damaged`.

    Raises
    ------
    UnknownNameError
        When there is no such defect.
    DataError
        When a chosen episode lacks a channel that the defect is in.
    """
    total = len(dataset)
    chosen_indices = set(rng.choice(total, max(1, round(share * total)), replace=False).tolist()) if total else set()
    defect(name)
    for index, episode in enumerate(dataset):
        yield with_defect(episode, name, rng, severity) if index in chosen_indices else as_stored(episode)


def write(path: str | Path, episodes: Iterator[RawEpisode] | Sequence[RawEpisode], part_size: int = 16) -> Path:
    """Return the folder of a new dataset that holds stored episodes, whatever is wrong with them.

    Raises
    ------
    UsageError
        When the folder holds something already.
    """
    root = create_dataset(path)
    append(root, (unchecked_episode(raw) for raw in episodes), Lineage(operation="defects"), part_size)
    return root


def unchecked_episode(raw: RawEpisode) -> Episode:
    """Return an Episode of stored arrays that was never checked: for writers only. Its point cloud stays behind.

    Raises
    ------
    ValueError, UsageError
        When its record cannot be read.
    """
    episode = object.__new__(Episode)
    known_arrays = {n: a for n, a in raw.arrays.items() if n.removesuffix(VALID_SUFFIX) in CHANNELS}
    object.__setattr__(episode, "meta", raw.meta().model_copy(update={"point_cloud": None}))
    object.__setattr__(episode, "arrays", MappingProxyType(known_arrays))
    return episode


def with_other_id(raw: RawEpisode, name: str) -> RawEpisode:
    """Return the same episode under another id: a duplicate."""
    fields = json.loads(raw.meta_json) | {"id": name}
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return replace(raw, id=name, meta_json=text, stored_hash=hash_columns(text, raw.arrays))
