"""Filmstrips of an evaluation: an episode as recorded, as simulated and as forecast, at the same moments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.reports import filmstrip
from candata.reports.document import render
from candata.reports.png import data_uri
from candata.reports.posed import poser
from candata.reports.render import render_frames
from candata.reports.standing import best_model
from candata.scenes import Scene
from candata.schema.episode import Episode
from candata.training.results import SIMULATOR, Evaluation, Track

#: Pictures a row.
COLUMNS = 5


def films(evaluation: Evaluation, dataset: Dataset, tracks: Sequence[Track]) -> dict[str, Markup]:
    """Return filmstrips by episode, HTML with embedded pictures; none of an episode whose scene is not known.

    Parameters
    ----------
    evaluation : Evaluation
        Says which model is shown: the best one.
    dataset : Dataset
        Holds the recorded joints.
    tracks : sequence of Track
        Episodes that may be shown: the first and the last are, the worst and the best of those drawn.
    """
    chosen = {track.id: (track, track.scene) for track in (*tracks[:1], *tracks[1:][-1:])}
    strips = {
        name: _strip(evaluation, scene, dataset.episode(name), track)
        for name, (track, scene) in chosen.items()
        if scene is not None
    }
    return {name: strip for name, strip in strips.items() if strip}


def _strip(evaluation: Evaluation, scene: Scene, episode: Episode, track: Track) -> Markup:
    """Return the filmstrip of an episode; empty where the scene has no object, or positions are not finite."""
    scene_poser = poser(scene, episode)
    if not scene_poser.with_object:
        return Markup("")
    steps = np.unique(np.linspace(0, len(track.time_s) - 1, COLUMNS).round().astype(int))
    recorded = scene_poser.qpos(episode, np.round(track.time_s[steps] * episode.meta.rate_hz).astype(int))
    place = slice(scene.object_qpos, scene.object_qpos + 7)
    shown, qpos = _shown(evaluation, track), [recorded]
    for poses in shown.values():
        forecast = recorded.copy()
        forecast[:, place] = poses[steps]
        qpos.append(forecast)
    if not np.isfinite(np.concatenate(qpos)).all():
        return Markup("")
    pictures = render_frames(scene.model, np.concatenate(qpos), None, filmstrip.WIDTH, filmstrip.HEIGHT)
    frames, count = [data_uri(frame) for frame in pictures.frames], len(steps)
    names = [("recorded", "recorded"), *(("nominal" if name == SIMULATOR else "repaired", name) for name in shown)]
    return render(
        "filmstrip",
        times=[f"{track.time_s[k]:.2f} s" for k in steps],
        rows=[(css, name, frames[r * count : (r + 1) * count]) for r, (css, name) in enumerate(names)],
        width=filmstrip.WIDTH,
        height=filmstrip.HEIGHT,
        note=pictures.note,
    )


def _shown(evaluation: Evaluation, track: Track) -> Mapping[str, NDArray]:
    """Return the poses of the simulator and of the best model, by name."""
    names = dict.fromkeys(name for name in (SIMULATOR, best_model(evaluation)) if name in track.poses)
    return {name: track.poses[name] for name in names}
