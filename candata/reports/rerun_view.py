"""An episode in Rerun: the hand and the object in motion, contacts and forces at the fingertips, traces beside them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, get_cloud
from candata.datasets.elements import fingertip_labels, joint_labels
from candata.datasets.summary import touches
from candata.datasets.writing import replacing
from candata.errors import MissingExtraError, SetupError
from candata.reports.posed import PosedRows, ScenePoser, poser, shown_geoms
from candata.reports.rerun_shapes import shape, xyzw
from candata.reports.traces import command_joints, masked
from candata.scenes import Scene, load_scene
from candata.scenes.contract import SCENES
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Timeline on which everything lies: seconds from the first row.
TIMELINE = "time"
#: Length of a force's arrow [m/N], of the axes of a pose, radius of a contact's mark and of a cloud's point [m].
ARROW_M_PER_N, AXIS_M, MARK_M, POINT_M = 0.01, 0.04, 0.006, 0.0008
RED, GREEN, BLUE, AMBER, GREY = [220, 70, 60], [80, 160, 70], [70, 120, 220], [235, 160, 50], [150, 155, 160]


def view(dataset: Dataset, id: str, scene: str | None = None, out: Path | None = None) -> tuple[str, ...]:
    """Show an episode in Rerun's viewer, or write it to `out`; return what to know of it, a line each.

    Parameters
    ----------
    dataset : Dataset
        Where the episode and its object's point cloud are.
    id : str
        Episode.
    scene : str, optional
        Name or `scene.yaml` of the scene that poses the hand; by default the episode's, where that is built in.
    out : Path, optional
        `.rrd` file to write, whole or not at all, instead of opening a window.

    Raises
    ------
    MissingExtraError
        When rerun-sdk is not installed.
    UnknownNameError
        When there is no such episode or scene.
    UsageError
        When the episode's joints are not the scene's.
    SetupError
        When there is no display to open a window on, or the file cannot be written.
    """
    rr = _rerun()
    episode = dataset.episode(id)
    scene_poser = _poser(episode, scene)
    if out is None:
        _need_display()
    recording = rr.RecordingStream("candata", recording_id=f"{dataset.digest[:12]}-{id}")
    if out is None:
        rr.spawn(recording=recording, default_blueprint=_blueprint(episode))
        return tuple(_fill(rr, recording, dataset, episode, scene_poser))
    return _write(rr, recording, dataset, episode, scene_poser, out)


def _rerun() -> Any:
    """Return Rerun's module."""
    try:
        import rerun
    except ImportError:
        raise MissingExtraError("rerun-sdk", "view") from None
    return rerun


def _poser(episode: Episode, scene: str | None) -> ScenePoser | None:
    """Return what poses the scene by the episode; None where no scene is given and its own is not built in."""
    name = scene or (episode.meta.scene if episode.meta.scene and episode.meta.scene in SCENES else None)
    return None if name is None else poser(load_scene(name), episode)


def has_display() -> bool:
    """Tell whether there is a display to open a window on."""
    is_linux = sys.platform.startswith("linux")
    return not is_linux or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _need_display() -> None:
    """Refuse to open a window where there is nowhere to open it."""
    if not has_display():
        raise SetupError(
            "there is no display to open a window on", fix="write a file: --out episode.rrd; open it with `rerun` there"
        )


def _write(
    rr: Any, recording: Any, dataset: Dataset, episode: Episode, scene_poser: ScenePoser | None, out: Path
) -> tuple[str, ...]:
    """Write the recording whole or not at all."""
    with replacing(out, "recording") as draft:
        draft.touch()
        recording.save(draft, default_blueprint=_blueprint(episode))
        notes = tuple(_fill(rr, recording, dataset, episode, scene_poser))
        recording.flush()
        recording.disconnect()
    return notes


def _blueprint(episode: Episode) -> Any:
    """Return the arrangement: space at the left, traces at the right."""
    import rerun.blueprint as rrb

    kinds = [("joints", "joint_position"), ("forces", "fingertip_force"), ("contact", "fingertip_contact")]
    charts = [rrb.TimeSeriesView(origin=f"traces/{kind}", name=kind) for kind, channel in kinds if channel in episode]
    space = rrb.Spatial3DView(origin="world", name=episode.meta.id)
    return rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(*charts), column_shares=[3, 2]) if charts else space)


def _fill(rr: Any, recording: Any, dataset: Dataset, episode: Episode, scene_poser: ScenePoser | None) -> Iterator[str]:
    """Log everything; yield what to know of it."""
    recording.send_recording_name(episode.meta.id)
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _object(rr, recording, dataset, episode, in_scene=scene_poser is not None and scene_poser.with_object)
    if scene_poser is None:
        yield "no scene: the hand, contact marks and force arrows are left out (give --scene)"
    else:
        _bodies(rr, recording, scene_poser)
        for chunk in scene_poser.chunks(episode):
            _motion(rr, recording, scene_poser, chunk, episode)
        if scene_poser.missing_joints:
            yield f"joints not in the episode, left where the model has them: {', '.join(scene_poser.missing_joints)}"
    _joints(rr, recording, episode)
    _forces(rr, recording, episode)
    _contact(rr, recording, episode)
    for channel in ("object_pose", "joint_position"):
        invalid_count = 0 if channel not in episode else int((~episode.valid(channel)).sum())
        if invalid_count:
            yield f"{channel} is not valid in {invalid_count} of {len(episode)} rows: the view holds the last valid one"


def _times(rr: Any, episode: Episode, rows: NDArray[np.int64] | slice = slice(None)) -> list[Any]:
    """Return the times of some rows."""
    return [rr.TimeColumn(TIMELINE, duration=episode.time_s[rows])]


def _object(rr: Any, recording: Any, dataset: Dataset, episode: Episode, in_scene: bool) -> None:
    """Log the object's frame, its path, and its point cloud; its mesh comes with the scene."""
    if "object_pose" not in episode:
        return
    rows = np.flatnonzero(episode.valid("object_pose"))
    pose = np.asarray(episode["object_pose"][rows], float)
    if not len(rows):
        return
    transforms = rr.Transform3D.columns(translation=pose[:, :3], quaternion=xyzw(pose[:, 3:]))
    recording.send_columns("world/object", indexes=_times(rr, episode, rows), columns=transforms)
    axes = rr.Arrows3D(vectors=AXIS_M * np.eye(3), colors=[RED, GREEN, BLUE])
    recording.log("world/object/axes", axes, static=True)
    if len(rows) > 1:
        recording.log("world/path", rr.LineStrips3D([pose[:, :3]], colors=[GREY]), static=True)
    if episode.meta.point_cloud is not None:
        points = get_cloud(dataset.path, episode.meta.point_cloud)
        colour = GREY if in_scene else AMBER
        recording.log("world/object/cloud", rr.Points3D(points, radii=[POINT_M], colors=[colour]), static=True)


def _bodies(rr: Any, recording: Any, scene_poser: ScenePoser) -> None:
    """Log the shapes of every shown body in its own frame."""
    for geom in shown_geoms(scene_poser.scene.model):
        body = int(scene_poser.scene.model.geom_bodyid[geom])
        geom_shape = shape(rr, scene_poser.scene.model, geom) if body in scene_poser.bodies else None
        if geom_shape is not None:
            recording.log(
                rr.new_entity_path([*_path(scene_poser.scene, body), f"geom {geom}"]), geom_shape, static=True
            )


def _path(scene: Scene, body: int) -> list[str]:
    """Return the place of a body among the entities."""
    return ["world", "scene", scene.model.body(body).name or f"body {body}"]


def _motion(rr: Any, recording: Any, scene_poser: ScenePoser, chunk: PosedRows, episode: Episode) -> None:
    """Log where bodies, contacts and forces are in some rows."""
    times = _times(rr, episode, chunk.rows)
    for i, body in enumerate(scene_poser.bodies):
        transforms = rr.Transform3D.columns(translation=chunk.position[:, i], quaternion=xyzw(chunk.quaternion[:, i]))
        recording.send_columns(rr.new_entity_path(_path(scene_poser.scene, body)), indexes=times, columns=transforms)
    touch = touches(episode)
    force = masked(episode, "fingertip_force")[chunk.rows] if "fingertip_force" in episode else None
    count = max((episode[c].shape[1] for c in ("fingertip_force", "fingertip_contact") if c in episode), default=0)
    for i, name in enumerate(fingertip_labels(episode.meta, count)[: chunk.tip.shape[1]]):
        if name in touch:
            in_contact = touch[name][chunk.rows]
            positions = chunk.tip[in_contact, i]
            marks = rr.Points3D.columns(positions=positions).partition(in_contact.astype(int))
            recording.log(rr.new_entity_path(["world", "contact", name]), _mark(rr), static=True)
            recording.send_columns(rr.new_entity_path(["world", "contact", name]), indexes=times, columns=marks)
        if force is not None:
            is_known = np.isfinite(force[:, i]).all(axis=1)
            vectors = ARROW_M_PER_N * np.einsum("kab,kb->ka", chunk.frame[is_known, i], force[is_known, i])
            arrows = rr.Arrows3D.columns(vectors=vectors, origins=chunk.tip[is_known, i]).partition(
                is_known.astype(int)
            )
            recording.send_columns(rr.new_entity_path(["world", "force", name]), indexes=times, columns=arrows)


def _mark(rr: Any) -> Any:
    """Return how a mark of contact looks."""
    return rr.Points3D.from_fields(radii=[MARK_M], colors=[AMBER])


def _joints(rr: Any, recording: Any, episode: Episode) -> None:
    """Log the position of each joint, beside it the command that bears its name."""
    if "joint_position" not in episode:
        return
    position = masked(episode, "joint_position")
    joints = joint_labels(episode.meta, position.shape[1])
    action = masked(episode, "action") if "action" in episode else np.zeros((len(episode), 0))
    drivers = command_joints(episode, joints, action.shape[1]) if action.shape[1] else ()
    for i, name in enumerate(joints):
        lines = {"position": position[:, i]}
        lines |= {"command": action[:, drivers.index(name)]} if name in drivers else {}
        _trace(rr, recording, episode, ["traces", "joints", name], lines)


def _forces(rr: Any, recording: Any, episode: Episode) -> None:
    """Log the components of each fingertip's force."""
    if "fingertip_force" in episode:
        force = masked(episode, "fingertip_force")
        for i, name in enumerate(fingertip_labels(episode.meta, force.shape[1])):
            lines = {axis: force[:, i, k] for k, axis in enumerate("xyz")}
            _trace(rr, recording, episode, ["traces", "forces", name], lines)


def _contact(rr: Any, recording: Any, episode: Episode) -> None:
    """Log who touches."""
    for name, flags in touches(episode).items():
        label = name or "any fingertip"
        _trace(rr, recording, episode, ["traces", "contact", label], {label: flags.astype(float)})


def _trace(rr: Any, recording: Any, episode: Episode, path: list[str], lines: dict[str, Array]) -> None:
    """Log a few lines over time as one entity."""
    entity, values = rr.new_entity_path(path), np.stack(list(lines.values()), axis=1)
    recording.log(entity, rr.SeriesLines(names=[f"{path[-1]} {name}" for name in lines]), static=True)
    columns = rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
    recording.send_columns(entity, indexes=_times(rr, episode), columns=columns)
