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
#: Least ambient light, and the background where a model has no sky of its own.
AMBIENT, SKY = 0.35, (237, 240, 242)


def main(folder: Path) -> None:
    """Read model, positions and camera from `folder` and write the frames there."""
    import mujoco
    import numpy as np

    model = mujoco.MjModel.from_binary_path(str(folder / MODEL))
    request = json.loads((folder / REQUEST).read_text())
    width, height = 2 * request["width"], 2 * request["height"]
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples = 0  # smoothing is by the 2 x 2 mean below, background included
    model.vis.headlight.ambient[:] = np.maximum(model.vis.headlight.ambient, AMBIENT)
    has_no_sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX not in model.tex_type
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, height, width)
    frames = []
    for pose in np.load(folder / POSES):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, camera=_camera(request["camera"]))
        picture = renderer.render().copy()
        if has_no_sky:
            renderer.enable_segmentation_rendering()
            picture[renderer.render()[..., 0] < 0] = SKY
            renderer.disable_segmentation_rendering()
        frames.append(picture.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3)).round())
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
