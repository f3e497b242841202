"""The filmstrip: recorded, nominal and repaired poses at the same moments, side by side."""

from __future__ import annotations

import mujoco
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from candata.gap.verdict.figures import Example
from candata.reports.document import render
from candata.reports.ghost import Ghost
from candata.reports.png import data_uri
from candata.reports.render import render_frames

#: Pictures a row, and their size in pixels (shown at half of it or less).
COLUMNS, WIDTH, HEIGHT = 6, 264, 220


def filmstrip(model: mujoco.MjModel | None, example: Example, repair: str) -> Markup:
    """Return the filmstrip as HTML with embedded pictures; empty without a model or positions.

    `repair` names the repaired simulation.
    """
    rows = [("recorded", "recorded", example.qpos_real), ("nominal", "nominal", example.qpos_before)]
    if example.qpos_after is not None:
        rows.append(("repaired", repair, example.qpos_after))
    if model is None or any(np.shape(qpos) != (len(example.time_s), model.nq) for *_, qpos in rows):
        return Markup("")
    steps = moments(example)
    if len(steps) == 0:
        return Markup("")
    poses = np.concatenate([np.asarray(qpos)[steps] for *_, qpos in rows])
    pictures = render_frames(model, poses, None, WIDTH, HEIGHT, _recorded_ghost(model, poses, len(steps)))
    frames = [data_uri(frame) for frame in pictures.frames]
    count = len(steps)
    return render(
        "filmstrip",
        times=[f"{example.time_s[k]:.2f} s" for k in steps],
        rows=[(css, name, frames[r * count : (r + 1) * count]) for r, (css, name, _) in enumerate(rows)],
        width=WIDTH,
        height=HEIGHT,
        note=pictures.note,
    )


def _recorded_ghost(model: mujoco.MjModel, poses: NDArray[np.float64], count: int) -> Ghost:
    """Return what moves in the recording as a ghost over the simulations; the recorded row, the first, has none."""
    recorded = poses[:count]
    rows = len(poses) // count - 1
    is_moving = model.body_weldid[model.geom_bodyid] != 0
    return Ghost(
        tuple(np.flatnonzero(is_moving).tolist()), np.concatenate([np.full_like(recorded, np.nan), *[recorded] * rows])
    )


def moments(example: Example) -> np.ndarray:
    """Return the rows to show, evenly spread over the rows in which all positions are finite."""
    positions = [q for q in (example.qpos_real, example.qpos_before, example.qpos_after) if q is not None]
    finite = np.flatnonzero(np.all([np.isfinite(q).all(axis=1) for q in positions], axis=0))
    return np.unique(finite[np.linspace(0, len(finite) - 1, COLUMNS).round().astype(int)]) if len(finite) else finite
