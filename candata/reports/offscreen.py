"""The child process that renders with a GL library, so that a GL failure stays in it.

MuJoCo fixes its GL library when it is first imported, and some drivers write to stderr or end the
process; the parent (`candata.reports.render`) starts this module once for each library it tries.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

#: Files of the folder that parent and child share.
MODEL, POSES, REQUEST, FRAMES = "model.mjb", "qpos.npy", "request.json", "frames.npy"
GHOST_MODEL, GHOST_POSES = "ghost.mjb", "ghost.npy"
#: The only light: a lamp at the camera, so that every model is lit alike and no shadow hides the object. Chosen: no
#: surface turned towards the camera saturates, none turned away is black.
AMBIENT, DIFFUSE, SPECULAR = 0.6, 0.45, 0.1
#: Background where a model has no sky of its own.
SKY = (237, 240, 242)


def main(folder: Path) -> None:
    """Read model, positions and camera from `folder` and write the frames there."""
    import mujoco
    import numpy as np

    from candata.reports.ghost import ghost_geoms, show_parted

    model = mujoco.MjModel.from_binary_path(str(folder / MODEL))
    request = json.loads((folder / REQUEST).read_text())
    width, height = 2 * request["width"], 2 * request["height"]
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples = 0  # smoothing is by the 2 x 2 mean below, background included
    headlight = model.vis.headlight
    headlight.active, headlight.ambient[:], headlight.diffuse[:], headlight.specular[:] = 1, AMBIENT, DIFFUSE, SPECULAR
    model.light_active[:] = 0
    has_no_sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX not in model.tex_type
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, height, width)

    def picture() -> np.ndarray:
        """Return the renderer's scene, its background light where it has no sky of its own."""
        pixels = renderer.render().copy()
        if has_no_sky:
            renderer.enable_segmentation_rendering()
            pixels[renderer.render()[..., 0] < 0] = SKY
            renderer.disable_segmentation_rendering()
        return pixels

    def depth_m() -> np.ndarray:
        """Return how far away what the renderer's scene shows is, (H, W) [m]."""
        renderer.enable_depth_rendering()
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        return depth

    with_ghost = (folder / GHOST_MODEL).exists()
    if with_ghost:
        ghost_model = mujoco.MjModel.from_binary_path(str(folder / GHOST_MODEL))
        ghost_data, ghost_poses = mujoco.MjData(ghost_model), np.load(folder / GHOST_POSES)
        geoms = ghost_geoms(ghost_model)
        shown = mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_ALL
    frames = []
    for row, pose in enumerate(np.load(folder / POSES)):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, camera=_camera(request["camera"]))
        frame = picture()
        if with_ghost and np.isfinite(ghost_poses[row]).all():
            ghost_data.qpos[:] = ghost_poses[row]
            mujoco.mj_forward(ghost_model, ghost_data)
            show_parted(ghost_model, geoms, ghost_data, data)
            solid_depth_m = depth_m()
            mujoco.mjv_addGeoms(ghost_model, ghost_data, *shown, renderer.scene)
            is_ghost = depth_m() < solid_depth_m - request["clearance_m"]
            frame[is_ghost] = ((1 - request["opacity"]) * frame + request["opacity"] * picture())[is_ghost]
        frames.append(frame.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3)).round())
    np.save(folder / FRAMES, np.stack(frames).astype(np.uint8))


def _camera(request: str | dict):
    """Return the camera's name, or a free camera with the fields given."""
    if isinstance(request, str):
        return request
    import mujoco

    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = request["lookat"]
    camera.distance = request["distance_m"]
    camera.azimuth, camera.elevation = request["azimuth_deg"], request["elevation_deg"]
    return camera


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    sys.stdout.flush()
    os._exit(0)  # some GL drivers crash while the interpreter shuts down
