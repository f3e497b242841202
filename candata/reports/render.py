"""Pictures of a model in given positions, with a GL library or without one."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.datasets.writing import replacing
from candata.reports import camera as cameras
from candata.reports import offscreen, png, rays
from candata.reports.ghost import CLEARANCE_M, OPACITY, Ghost, ghost_model
from candata.reports.png import Image

Array = NDArray[np.float64]

#: GL libraries that need no display, in the order tried.
LIBRARIES = ("egl", "osmesa")
#: Longest time a child may take [s]; a software rasteriser needs well below a second a frame.
TIMEOUT_S = 60.0
#: Note on a page with pictures made without GL.
DRAWN_NOTE = "No GL library found: this is a drawn projection."


@dataclass(frozen=True)
class RenderedFrames:
    """Pictures (height, width, 3) uint8, and the GL library that made them (None: drawn)."""

    frames: tuple[Image, ...]
    library: str | None

    @property
    def note(self) -> str:
        """What to say beside the pictures; empty when a GL library made them."""
        return "" if self.library else DRAWN_NOTE


def render_poses(
    model: mujoco.MjModel,
    qpos: Array,
    camera: str | cameras.FreeCamera | None = None,
    width: int = 320,
    height: int = 240,
) -> list[Image]:
    """Return one picture (height, width, 3) uint8 of each row of `qpos`.

    Parameters
    ----------
    model : mujoco.MjModel
    qpos : (K, nq) float64
        Positions of the model.
    camera : str, FreeCamera or None
        Name of a model camera, a free camera, or None: the model's camera `report` when it has one,
        else a free camera fitted to what moves over `qpos`.
    width, height : int
        Size of a picture in pixels.
    """
    return list(render_frames(model, qpos, camera, width, height).frames)


def render_frames(
    model: mujoco.MjModel,
    qpos: Array,
    camera: str | cameras.FreeCamera | None = None,
    width: int = 320,
    height: int = 240,
    ghost: Ghost | None = None,
    libraries: Sequence[str] | None = None,
) -> RenderedFrames:
    """Return the pictures of `render_poses` and the GL library that made them; without one they are drawn.

    `ghost` is seen in them too. `libraries` are the GL libraries to try, by default those that the user's environment
    asks for.
    """
    qpos = np.atleast_2d(np.asarray(qpos, float))
    view = cameras.choose_camera(model, qpos, camera, width / height)
    for library in _libraries() if libraries is None else libraries:
        frames = _with_library(library, model, qpos, view, width, height, ghost)
        if frames is not None:
            return RenderedFrames(frames, library)
    return RenderedFrames(tuple(rays.draw(model, qpos, view, width, height, ghost)), None)


def render_png(model: mujoco.MjModel, qpos: Array | None, path: Path, width: int = 960, height: int = 720) -> bool:
    """Write one picture to `path`; True when a GL library made it, False when it was drawn.

    Parameters
    ----------
    model : mujoco.MjModel
    qpos : (nq,) float64 or None
        Positions; None takes the first keyframe, else the model's own.
    path : Path
        PNG file to write.
    width, height : int
        Size in pixels.
    """
    if qpos is None:
        qpos = model.key_qpos[0] if model.nkey else model.qpos0
    picture = render_frames(model, qpos, None, width, height)
    with replacing(path, "picture") as draft:
        draft.write_bytes(png.encode(picture.frames[0]))
    return picture.library is not None


def _libraries() -> tuple[str, ...]:
    """Return the GL libraries to try: the user's first (MUJOCO_GL; the command line keeps it as CANDATA_GL) or none."""
    preference = os.environ.get("CANDATA_GL", os.environ.get("MUJOCO_GL", "")).strip().lower()
    if preference in ("disable", "disabled", "off", "false", "0"):
        return ()
    other_library = (preference,) if preference and preference not in LIBRARIES else ()
    return other_library + tuple(sorted(LIBRARIES, key=lambda name: name != preference))


def _with_library(
    library: str,
    model: mujoco.MjModel,
    qpos: Array,
    view: str | cameras.FreeCamera,
    width: int,
    height: int,
    ghost: Ghost | None,
) -> tuple[Image, ...] | None:
    """Return the pictures made by one GL library in a child process, or None when it fails."""
    with tempfile.TemporaryDirectory(prefix="candata-render-") as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / offscreen.MODEL))
        np.save(folder / offscreen.POSES, qpos)
        if ghost is not None:
            mujoco.mj_saveModel(ghost_model(model, ghost), str(folder / offscreen.GHOST_MODEL))
            np.save(folder / offscreen.GHOST_POSES, ghost.qpos)
        request = {
            "width": width,
            "height": height,
            "camera": _as_json(view),
            "opacity": OPACITY,
            "clearance_m": CLEARANCE_M,
        }
        (folder / offscreen.REQUEST).write_text(json.dumps(request))
        if not _run_child(library, folder) or not (folder / offscreen.FRAMES).exists():
            return None
        return tuple(np.load(folder / offscreen.FRAMES))


def _run_child(library: str, folder: Path) -> bool:
    """Return whether the child ended well; its output is dropped."""
    root = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    try:
        process = subprocess.run(
            [sys.executable, "-m", offscreen.__name__, str(folder)],
            env={**os.environ, "MUJOCO_GL": library, "PYOPENGL_PLATFORM": library, "PYTHONPATH": paths},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return process.returncode == 0


def _as_json(view: str | cameras.FreeCamera) -> str | dict[str, object]:
    """Return the camera as the child reads it."""
    return view if isinstance(view, str) else dataclasses.asdict(view)
