"""The filmstrip: recorded, nominal and repaired poses at the same moments, side by side."""

from __future__ import annotations

from html import escape

import mujoco
import numpy as np

from candata.gap.evidence import Example
from candata.reports.png import data_uri
from candata.reports.render import film

#: Pictures a row, and their size in pixels (shown at half of it or less).
COLUMNS, WIDTH, HEIGHT = 6, 264, 220


def filmstrip(model: mujoco.MjModel | None, example: Example, after: str) -> str:
    """Return the filmstrip as HTML with embedded pictures; empty without a model or positions.

    `after` is what the last row is called.
    """
    rows = [("recorded", "recorded", example.qpos_real), ("nominal", "nominal", example.qpos_before)]
    if example.qpos_after is not None:
        rows.append(("repaired", after, example.qpos_after))
    if model is None or any(np.shape(q) != (len(example.time_s), model.nq) for *_, q in rows):
        return ""
    steps = moments(example)
    if len(steps) == 0:
        return ""
    made = film(model, np.concatenate([np.asarray(q)[steps] for *_, q in rows]), None, WIDTH, HEIGHT)
    cells = ['<span class="corner"></span>']
    cells += [f'<span class="when">{example.time_s[k]:.2f} s</span>' for k in steps]
    for row, (kind, name, _) in enumerate(rows):
        cells.append(f'<span class="who {kind}">{escape(name)}</span>')
        for column, k in enumerate(steps):
            picture = made.frames[row * len(steps) + column]
            alt = escape(f"{name} at {example.time_s[k]:.2f} s")
            cells.append(f'<img width="{WIDTH}" height="{HEIGHT}" alt="{alt}" src="{data_uri(picture)}">')
    note = f'<p class="note">{escape(made.note)}</p>' if made.note else ""
    return f'<div class="scroll"><div class="film" style="--n:{len(steps)}">{"".join(cells)}</div></div>{note}'


def moments(example: Example) -> np.ndarray:
    """Return the rows to show, evenly spread over the rows in which all positions are finite."""
    shown = [q for q in (example.qpos_real, example.qpos_before, example.qpos_after) if q is not None]
    finite = np.flatnonzero(np.all([np.isfinite(q).all(axis=1) for q in shown], axis=0))
    return np.unique(finite[np.linspace(0, len(finite) - 1, COLUMNS).round().astype(int)]) if len(finite) else finite
