"""An episode as pictures: its scene in the recorded state, marks of contact, the time, another episode as a ghost."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.datasets.elements import fingertip_labels
from candata.datasets.summary import touches
from candata.errors import UnknownNameError, UsageError, Where
from candata.reports.camera import SHOWN_GROUPS, Pinhole, choose_camera, pinhole
from candata.reports.ghost import Ghost
from candata.reports.overlay import Colour, draw_disc, draw_text
from candata.reports.posed import ScenePoser, poser
from candata.reports.render import RenderedFrames, render_frames
from candata.reports.traces import masked
from candata.scenes import Scene, load_scene
from candata.scenes.assemble import subtree
from candata.scenes.recorded_names import builtin_scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Pictures that one call of the renderer makes: what bounds memory, and how often progress is told.
CHUNK = 24
#: Most pictures of a film whose number is not given; a longer episode is played faster. Chosen: half a minute at 20 a
#: second.
MOST_FRAMES = 600
#: Radius of a mark over the picture's height: in touch without force, and what the root of a force [N] adds; the
#: largest. Chosen: 1 N and 4 N can be told apart, and 10 N does not hide the finger.
MARK_SHARE, MARK_SHARE_PER_ROOT_N, LARGEST_MARK_SHARE = 0.012, 0.009, 0.045
#: Least radius of a mark [pixels], and distance beyond which a fingertip in touch is not near the object [m]. Chosen.
LEAST_MARK_PX, FARTHEST_M = 1.5, 0.05
#: Colours of a mark without force and from this force [N] on; between them it is mixed. Chosen.
LIGHT_TOUCH, FIRM_TOUCH, FIRM_N = (250, 200, 60), (215, 40, 40), 10.0


@dataclass(frozen=True)
class Moments:
    """Which moments of an episode are shown.

    Attributes
    ----------
    count : int, optional
        So many, evenly spread from the first to the last valid row.
    fps : float
        Without a count: so many a second of the episode.
    """

    count: int | None = None
    fps: float = 20.0


@dataclass(frozen=True)
class Footage:
    """What the pictures of an episode show, K of them.

    Attributes
    ----------
    scene : Scene
    time_s : (K,) float64 [s]
        Time of each picture, from the episode's first row.
    qpos : (K, nq) float64
        Positions of the model.
    touch : (K, F) bool
        Which of the scene's fingertips the episode says are in contact.
    force_n : (K, F) float64 [N]
        Size of their forces, 0 where it is not known.
    ghost : Ghost or None
        The object of another episode.
    notes : tuple of str
        What to know of the pictures, a line each.
    """

    scene: Scene
    time_s: Array
    qpos: Array
    touch: NDArray[np.bool_]
    force_n: Array
    ghost: Ghost | None
    notes: tuple[str, ...]


def footage(
    dataset: Dataset,
    episode_id: str,
    moments: Moments,
    scene: str | None = None,
    over: tuple[Dataset, str] | None = None,
) -> Footage:
    """Return what the pictures of an episode show.

    Parameters
    ----------
    dataset : Dataset
    episode_id : str
        Its id in the dataset.
    moments : Moments
        Which moments are shown.
    scene : str, optional
        Name, `SCENE+OBJECT` or `scene.yaml`; by default the episode's, where that is built in.
    over : (Dataset, str), optional
        Dataset and id of the episode whose object is shown as a ghost at the same times.

    Raises
    ------
    UnknownNameError
        When there is no such episode or scene.
    UsageError
        When no scene is given and the episode's is not built in, the scene does not fit the episode, no row is valid,
        or the ghost's episode has no object pose.
    """
    episode = dataset.episode(episode_id)
    name = scene or builtin_scene(episode.meta.scene, Where(episode=episode.meta.id))
    scene_poser = poser(load_scene(name), episode)
    _refuse_unposed(scene_poser, episode, name)
    rows = _rows(scene_poser, episode, moments)
    time_s, qpos = episode.time_s[rows], scene_poser.qpos(episode, rows)
    touch, force_n = _contact(episode, scene_poser.scene, rows)
    notes, ghost = list(_notes(scene_poser, episode, moments, len(rows))), None
    if over is not None:
        other = over[0].episode(over[1])
        ghost = _ghost(scene_poser.scene, other, time_s, qpos)
        if other.meta.object != episode.meta.object:
            notes.append(f"the ghost is {other.meta.object}, drawn in the shape of {episode.meta.object}")
    return Footage(scene_poser.scene, time_s, qpos, touch, force_n, ghost, tuple(notes))


def pictures(shown: Footage, width: int, height: int, camera: str | None = None) -> Iterator[RenderedFrames]:
    """Yield the pictures of an episode, some at a time, with marks of contact and the time drawn in.

    Parameters
    ----------
    shown : Footage
    width, height : int
        Size of a picture [pixels].
    camera : str, optional
        Camera of the model; by default its camera `report`, else one fitted to all that moves.

    Raises
    ------
    UnknownNameError
        When the model has no such camera.
    """
    model = shown.scene.model
    camera_names = [model.camera(i).name for i in range(model.ncam)]
    if camera is not None and camera not in camera_names:
        raise UnknownNameError("camera", camera, filter(None, camera_names))
    ghost_qpos = np.empty((0, model.nq)) if shown.ghost is None else shown.ghost.qpos
    is_placed = np.isfinite(ghost_qpos).all(axis=1)
    view = choose_camera(model, np.concatenate([shown.qpos, ghost_qpos[is_placed]]), camera, width / height)
    data, libraries = mujoco.MjData(model), None
    for start in range(0, len(shown.qpos), CHUNK):
        part = slice(start, start + CHUNK)
        ghost = None if shown.ghost is None else shown.ghost.part(part)
        rendered = render_frames(model, shown.qpos[part], view, width, height, ghost, libraries)
        libraries = (rendered.library,) if rendered.library else ()
        frames = tuple(frame.copy() for frame in rendered.frames)
        for row, frame in enumerate(frames, start):
            data.qpos[:] = shown.qpos[row]
            mujoco.mj_forward(model, data)
            _mark(
                frame,
                pinhole(model, data, view),
                _touch_points(shown.scene, data, shown.touch[row]),
                shown.force_n[row],
            )
            draw_text(frame, f"{shown.time_s[row]:.2f} s")
        yield RenderedFrames(frames, rendered.library)


def _refuse_unposed(scene_poser: ScenePoser, episode: Episode, name: str) -> None:
    """Refuse a scene in which the episode moves nothing."""
    if not scene_poser.joints and not scene_poser.with_object:
        raise UsageError(
            f"the scene {name} does not fit the episode",
            expected="joints or an object whose positions the episode holds",
            found=", ".join(episode.arrays),
            where=Where(episode=episode.meta.id),
            fix="give the scene of this recording: --scene NAME or scene.yaml",
        )


def _rows(scene_poser: ScenePoser, episode: Episode, moments: Moments) -> NDArray[np.int64]:
    """Return the rows to show: at each moment the last valid one."""
    valid_rows = scene_poser.valid_rows(episode)
    if not len(valid_rows):
        raise UsageError("no row of the episode is valid", where=Where(episode=episode.meta.id))
    time_s = episode.time_s[valid_rows]
    count = moments.count or min(1 + int((time_s[-1] - time_s[0]) * moments.fps + 1e-6), MOST_FRAMES)
    is_sampled = moments.count is None and count < MOST_FRAMES
    last_s = time_s[0] + (count - 1) / moments.fps if is_sampled else time_s[-1]
    return valid_rows[_last_before(time_s, np.linspace(time_s[0], last_s, count))]


def _last_before(time_s: Array, moments_s: Array) -> NDArray[np.int64]:
    """Return the index of the last of `time_s` at or before each moment; -1 before the first."""
    return np.searchsorted(time_s, moments_s + 1e-9, side="right") - 1


def _contact(episode: Episode, scene: Scene, rows: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Array]:
    """Return contact `(K, F)` and force `(K, F)` [N] of the scene's fingertips in some rows."""
    tips = scene.file.fingertips
    touch, force_n = np.zeros((len(rows), len(tips)), bool), np.zeros((len(rows), len(tips)))
    touch_by_label = touches(episode)
    force = masked(episode, "fingertip_force") if _is_in_newton(episode) else np.zeros((len(episode), 0, 3))
    count = max(force.shape[1], episode["fingertip_contact"].shape[1] if "fingertip_contact" in episode else 0)
    labels = fingertip_labels(episode.meta, count)
    for i, tip in enumerate(tips):
        column = labels.index(tip) if tip in labels else i if not episode.meta.fingertip_names else len(labels)
        if column < len(labels) and labels[column] in touch_by_label:
            touch[:, i] = touch_by_label[labels[column]][rows]
        if column < force.shape[1]:
            force_n[:, i] = np.nan_to_num(np.linalg.norm(force[rows, column], axis=1))
    return touch, force_n


def _is_in_newton(episode: Episode) -> bool:
    """Tell whether the episode holds forces in newtons."""
    return "fingertip_force" in episode and "fingertip_force" not in episode.meta.unscaled


def _ghost(scene: Scene, episode: Episode, time_s: Array, qpos: Array) -> Ghost:
    """Return the object of another episode at the same times; none after its end."""
    if scene.object_id is None or "object_pose" not in episode or not episode.valid("object_pose").any():
        raise UsageError(
            "there is no object to show as a ghost",
            expected="a scene with an object, and an episode with valid object_pose",
            where=Where(episode=episode.meta.id),
        )
    rows = np.flatnonzero(episode.valid("object_pose"))
    latest = _last_before(episode.time_s[rows], time_s)
    ghost_qpos = qpos.copy()
    part = slice(scene.object_qpos, scene.object_qpos + 7)
    ghost_qpos[:, part] = episode["object_pose"][rows[latest]]
    ghost_qpos[(latest < 0) | (time_s > episode.time_s[-1] + 1 / episode.meta.rate_hz)] = np.nan
    bodies = list(subtree(scene.model, scene.object_id))
    is_shown = np.isin(scene.model.geom_bodyid, bodies) & (scene.model.geom_group < SHOWN_GROUPS)
    return Ghost(tuple(np.flatnonzero(is_shown).tolist()), ghost_qpos)


def _notes(scene_poser: ScenePoser, episode: Episode, moments: Moments, count: int) -> Iterator[str]:
    """Yield what to know of the pictures."""
    if scene_poser.missing_joints:
        yield f"joints not in the episode, left where the model has them: {', '.join(scene_poser.missing_joints)}"
    if scene_poser.scene.object_id is not None and not scene_poser.with_object:
        yield "no object_pose in the episode: the object is left where the model has it"
    if scene_poser.unknown_joints:
        yield f"joints that the scene lacks, not shown: {', '.join(scene_poser.unknown_joints)}"
    digest = str(episode.meta.labels.get("scene_digest", scene_poser.scene.digest))
    if digest != scene_poser.scene.digest:
        yield f"the scene is not that of the episode (digest {digest[:12]}): shapes may differ"
    if moments.count is None and count == MOST_FRAMES:
        yield f"a long episode: {MOST_FRAMES} pictures of it, played faster (--frames for another number)"


def _touch_points(scene: Scene, data: mujoco.MjData, touch: NDArray[np.bool_]) -> dict[int, Array]:
    """Return where fingertips in touch are nearest to the object `(3,)` [m], by fingertip; their middle without one."""
    points = {}
    for tip in np.flatnonzero(touch).tolist():
        nearest_m, segment = FARTHEST_M, np.zeros(6)
        points[tip] = data.geom_xpos[scene.fingertip_geoms[tip]].mean(axis=0)
        for geom, other in itertools.product(scene.fingertip_geoms[tip], scene.object_geoms):
            distance_m = mujoco.mj_geomDistance(scene.model, data, geom, other, nearest_m, segment)
            if distance_m < nearest_m:
                nearest_m, points[tip] = distance_m, segment[:3].copy()
    return points


def _mark(frame: NDArray[np.uint8], eye: Pinhole, points: dict[int, Array], force_n: Array) -> None:
    """Mark points (3,) [m] of fingertips in touch, by fingertip, each as its force (F,) [N] says; the nearest last."""
    height, width = frame.shape[:2]
    pixels_per_slope = height / 2 / np.tan(eye.fovy_rad / 2)
    offsets = {tip: (point - eye.position) @ eye.axes for tip, point in points.items()}
    for tip in sorted(offsets, key=lambda tip: float(offsets[tip][2])):
        right_m, up_m, back_m = offsets[tip]
        if back_m < 0:
            x, y = width / 2 - pixels_per_slope * right_m / back_m, height / 2 + pixels_per_slope * up_m / back_m
            share = min(MARK_SHARE + MARK_SHARE_PER_ROOT_N * np.sqrt(force_n[tip]), LARGEST_MARK_SHARE)
            draw_disc(frame, x, y, max(LEAST_MARK_PX, share * height), _touch_colour(force_n[tip]))


def _touch_colour(force_n: float) -> Colour:
    """Return the colour of a mark."""
    firmness = min(force_n / FIRM_N, 1.0)
    red, green, blue = (round(a + firmness * (b - a)) for a, b in zip(LIGHT_TOUCH, FIRM_TOUCH, strict=True))
    return red, green, blue
