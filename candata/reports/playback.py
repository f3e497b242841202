"""Episodes to play in a page: thinned traces, and the poses of the scene's bodies, as JSON that one script reads."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, get_cloud
from candata.datasets.elements import fingertip_labels
from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.errors import UsageError, Where
from candata.reports.envelope import COLUMNS, envelope, runs
from candata.reports.joint_units import units_in
from candata.reports.lanes import lanes
from candata.reports.numbers import digits
from candata.reports.posed import PosedRows, ScenePoser, poser
from candata.reports.solids import solids
from candata.reports.traces import MOST_TRACES, masked
from candata.scenes import Scene, load_scene
from candata.scenes.recorded_names import builtin_scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Frames of what moves, between which a script fills in, and points of an object's cloud. Chosen.
MOST_FRAMES, FEWEST_FRAMES, CLOUD_POINTS = 600, 24, 400
#: Aim for one episode, and what all episodes of a page may take [bytes of text]. Chosen: a page that a mail takes.
EPISODE_BYTES, PAGE_BYTES = 180_000, 20_000_000
#: Largest whole number of a value, and the number that stands for no value.
LARGEST, NO_VALUE = 32_767, -32_768
#: Bytes of text that a byte of an array takes (base64).
TEXT_BYTES = 4 / 3
#: Room around what moves, and the least radius of the view [m].
VIEW_MARGIN_M, LEAST_VIEW_M = 0.06, 0.08


@dataclass
class Playbacks:
    """The episodes of a page that can be played, and the geometry that they share.

    Attributes
    ----------
    dataset : Dataset
        Holds the clouds of the objects.
    scene : str, optional
        Name, `SCENE+OBJECT` or `scene.yaml` that poses every episode; by default each episode's, where it is built in.
    geometries : dict of str to str
        JSON by the name that episodes refer to.
    episodes : dict of str to str
        JSON by the id of the episode.
    """

    dataset: Dataset
    scene: str | None = None
    geometries: dict[str, str] = field(default_factory=dict)
    episodes: dict[str, str] = field(default_factory=dict)
    _scenes: dict[str, Scene] = field(default_factory=dict)

    def add(self, episode: Episode) -> None:
        """Take in one episode, unless the page is full.

        Raises
        ------
        UsageError
            When the episode's joints are not those of the scene that was given.
        """
        if sum(map(len, (*self.episodes.values(), *self.geometries.values()))) > PAGE_BYTES:
            return
        scene_poser, why = self._poser(episode)
        units = None if scene_poser is None else units_in(scene_poser.scene)
        record: dict[str, Any] = {"id": episode.meta.id, "facts": facts_text(episode), "end": float(episode.time_s[-1])}
        record |= {"lanes": _lanes(episode, units), "touch": _touch(episode)}
        text_bytes = len(json.dumps(record))
        frames = _frames(episode, scene_poser, EPISODE_BYTES - text_bytes)
        if frames is not None:
            record |= {"frames": frames, "geometry": self._geometry(episode, scene_poser)}
        record["notes"] = list(_notes(episode, scene_poser, why, frames))
        self.episodes[episode.meta.id] = safe_json(record)

    def _poser(self, episode: Episode) -> tuple[ScenePoser | None, str]:
        """Return what poses the scene by the episode, or None and why nothing does."""
        where = Where(episode=episode.meta.id)
        if self.scene is not None:
            return poser(self._load(self.scene), episode), ""
        try:
            return poser(self._load(builtin_scene(episode.meta.scene, where)), episode), ""
        except UsageError as error:
            return None, f"{error.problem} ({error.fix})."

    def _load(self, name: str) -> Scene:
        """Return a scene; each is loaded once."""
        if name not in self._scenes:
            self._scenes[name] = load_scene(name)
        return self._scenes[name]

    def _geometry(self, episode: Episode, scene_poser: ScenePoser | None) -> str:
        """Return the name of the geometry that an episode's frames move, which is kept once."""
        cloud = episode.meta.point_cloud if scene_poser is None else None
        name = cloud or "axes" if scene_poser is None else f"{scene_poser.scene.name} {scene_poser.bodies}"
        if name not in self.geometries:
            points = None if cloud is None else get_cloud(self.dataset.path, cloud)
            record = _object_geometry(points) if scene_poser is None else _scene_geometry(scene_poser)
            self.geometries[name] = safe_json(record)
        return name


def facts_text(episode: Episode) -> str:
    """Return what an episode is, in one line."""
    meta = episode.meta
    seed = None if meta.seed is None else f"seed {meta.seed}"
    labels = ", ".join(filter(None, [meta.source, meta.task, meta.object, seed, meta.outcome]))
    rows = "1 row" if len(episode) == 1 else f"{len(episode):,} rows"
    return f"{labels}; {rows} in {digits(float(episode.time_s[-1]))} s at {digits(meta.rate_hz)} Hz."


def safe_json(value: Any) -> str:
    """Return JSON that can stand in a `<script>`: no text of it ends the element or begins another."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def whole_numbers(values: Array) -> tuple[str, float, float]:
    """Return values as 16-bit whole numbers in base64, with the least value and the step from number to number.

    Parameters
    ----------
    values : (...) float64
        NaN, where there is no value, becomes `NO_VALUE`.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    step = (high - low) / LARGEST or 1.0
    numbers = np.where(np.isfinite(values), np.round((values - low) / step), NO_VALUE).astype("<i2")
    return base64.b64encode(numbers.tobytes()).decode(), low, step


def _packed(values: Array) -> dict[str, Any]:
    """Return the record of `whole_numbers`."""
    data, low, step = whole_numbers(values)
    return {"data": data, "low": float(f"{low:.7g}"), "step": float(f"{step:.7g}")}


def _lanes(episode: Episode, units: Mapping[str, str] | None) -> list[dict[str, Any]]:
    """Return the lanes of an episode, each line thinned to its least and largest value in each column."""
    records = []
    for lane in lanes(episode, units=units):
        lines = []
        for name in list(lane.lines)[:MOST_TRACES]:
            pairs = [(lane.lines[name], False), *([(lane.commands[name], True)] if name in lane.commands else [])]
            for values, is_command in pairs:
                times, thinned = envelope(episode.time_s, values, COLUMNS)
                lines.append({"name": name, "command": is_command, **_packed(np.array(thinned, float))})
        hidden_count = max(len(lane.lines) - MOST_TRACES, 0)
        title = f"{lane.title} ({hidden_count} more are not drawn)" if hidden_count else lane.title
        unit = "" if lane.unit == "1" else lane.unit
        records.append({"title": title, "unit": unit, "time": [round(t, 4) for t in times], "lines": lines})
    return records


def _touch(episode: Episode) -> list[dict[str, Any]]:
    """Return when each fingertip touches, as pairs of begin and end [s]; a row counts until the next."""
    touch, time_s = touches(episode), episode.time_s
    names = [name for name in touch if name != ANY_FINGERTIP] or list(touch)
    ends = np.append(time_s[1:], time_s[-1])
    return [
        {
            "name": name or "any fingertip",
            "spans": [[round(float(time_s[a]), 4), round(float(ends[b - 1]), 4)] for a, b in runs(touch[name])],
        }
        for name in names[:MOST_TRACES]
    ]


def _frames(episode: Episode, scene_poser: ScenePoser | None, text_bytes: float) -> dict[str, Any] | None:
    """Return where everything is at a few rows, within so many bytes of text; None where nothing has a place."""
    if scene_poser is None:
        if "object_pose" not in episode:
            return None
        valid_rows = np.flatnonzero(episode.valid("object_pose"))
    else:
        valid_rows = scene_poser.valid_rows(episode)
    if not len(valid_rows):
        return None
    body_count = 1 if scene_poser is None else len(scene_poser.bodies)
    frame_bytes = 2 * TEXT_BYTES * (7 * body_count + 6 * (0 if scene_poser is None else scene_poser.tip_count))
    count = int(np.clip(text_bytes / frame_bytes, FEWEST_FRAMES, MOST_FRAMES))
    rows = np.unique(valid_rows[np.linspace(0, len(valid_rows) - 1, count).round().astype(int)])
    if scene_poser is None:
        pose = np.asarray(episode["object_pose"][rows], float)[:, None]
        posed = PosedRows(
            rows, pose[..., :3], pose[..., 3:], np.zeros((len(rows), 0, 3)), np.zeros((len(rows), 0, 3, 3))
        )
        moving = np.ones(1, bool)
    else:
        posed = scene_poser.pose(episode, rows)
        moving = scene_poser.scene.model.body_weldid[list(scene_poser.bodies)] != 0
    tips, forces = _forces(episode, posed)
    centre, radius = _view(posed.position[:, moving] if moving.any() else posed.position)
    return {
        "rows": len(rows),
        "of": len(episode),
        "time": [round(float(t), 4) for t in episode.time_s[rows]],
        "position": _packed(posed.position),
        "quaternion": _packed(posed.quaternion),
        "tips": _packed(tips),
        "forces": _packed(forces),
        "centre": [round(float(v), 4) for v in centre],
        "radius": round(radius, 4),
    }


def _forces(episode: Episode, posed: PosedRows) -> tuple[Array, Array]:
    """Return where the fingertips are and their forces in the world, `(K, F, 3)` each, NaN where not known."""
    count = posed.tip.shape[1]
    if "fingertip_force" not in episode or not count:
        return np.zeros((len(posed.rows), 0, 3)), np.zeros((len(posed.rows), 0, 3))
    count = min(count, len(fingertip_labels(episode.meta, episode["fingertip_force"].shape[1])))
    force = masked(episode, "fingertip_force")[posed.rows, :count]
    return posed.tip[:, :count], np.einsum("kfab,kfb->kfa", posed.frame[:, :count], force)


def _view(position: Array) -> tuple[Array, float]:
    """Return centre `(3,)` and radius [m] of a ball that holds the places `(K, B, 3)` of what moves."""
    places = position.reshape(-1, 3)
    low, high = places.min(axis=0), places.max(axis=0)
    return (low + high) / 2, max(LEAST_VIEW_M, float(np.linalg.norm(high - low)) / 2 + VIEW_MARGIN_M)


def _scene_geometry(scene_poser: ScenePoser) -> dict[str, Any]:
    """Return the solids of each shown body of a scene."""
    model = scene_poser.scene.model
    return {
        "bodies": [
            {
                "still": bool(model.body_weldid[body] == 0),
                "solids": [
                    {
                        "colour": solid.colour,
                        "closed": solid.is_closed,
                        "vertices": _packed(solid.vertices),
                        "faces": base64.b64encode(solid.faces.astype("<u2").tobytes()).decode(),
                    }
                    for solid in solids(model, body)
                ],
            }
            for body in scene_poser.bodies
        ]
    }


def _object_geometry(points: NDArray[np.float32] | None) -> dict[str, Any]:
    """Return an object alone: some points of its cloud; the script draws its axes in any case."""
    body: dict[str, Any] = {"still": False, "solids": [], "axes": True}
    if points is not None:
        chosen_points = points[np.linspace(0, len(points) - 1, min(CLOUD_POINTS, len(points))).round().astype(int)]
        body["points"] = _packed(np.asarray(chosen_points, float))
    return {"bodies": [body]}


def _notes(episode: Episode, scene_poser: ScenePoser | None, why: str, frames: dict[str, Any] | None) -> Iterable[str]:
    """Yield what to know of what is shown."""
    if frames is None:
        yield f"Nothing is drawn in space: {why or 'the episode has no valid pose.'}"
    elif why:
        yield f"The hand is not drawn: {why}"
    if frames is not None and frames["rows"] < frames["of"]:
        yield f"In space {frames['rows']} of {frames['of']:,} rows are kept; between them places are interpolated."
    if scene_poser is not None and scene_poser.missing_joints:
        yield f"Joints that were not recorded stay where the model has them: {', '.join(scene_poser.missing_joints)}."
    for channel in ("object_pose", "joint_position"):
        invalid_count = 0 if channel not in episode else int((~episode.valid(channel)).sum())
        if invalid_count:
            yield f"{channel} is not valid in {invalid_count:,} of {len(episode):,} rows."
