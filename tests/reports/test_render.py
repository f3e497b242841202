"""Pictures: the encoder, the camera, with and without a GL library."""

from __future__ import annotations

import struct
import subprocess
import zlib

import mujoco
import numpy as np
import pytest

from candata import reports
from candata.reports import camera, png, render
from candata.reports.ghost import CLEARANCE_M, Ghost

BALL = """<mujoco><worldbody><light pos="0 0 2"/><geom type="plane" size="1 1 .1"/>{camera}
<body pos="0 0 .3"><freejoint/><geom size=".1" rgba="1 0 0 1"/></body></worldbody></mujoco>"""


def ball(camera_xml: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(BALL.format(camera=camera_xml))


def decode(data: bytes) -> np.ndarray:
    """Undo the five filters of PNG, byte by byte: an independent reading of the specification."""
    width, height = struct.unpack(">II", data[16:24])
    start = data.index(b"IDAT")
    size = struct.unpack(">I", data[start - 4 : start])[0]
    raw = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + size]), np.uint8).reshape(height, -1)
    out = np.zeros((height + 1, 3 * (width + 1)), int)
    for y, row in enumerate(raw):
        for x in range(3 * width):
            a, b, c = out[y + 1, x], out[y, x + 3], out[y, x]
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            out[y + 1, x + 3] = (int(row[x + 1]) + (0, a, b, (a + b) // 2, paeth)[row[0]]) % 256
    return out[1:, 3:].reshape(height, width, 3).astype(np.uint8)


def test_png_holds_the_image():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (9, 7, 3), dtype=np.uint8)
    image[3:6] = np.arange(7, dtype=np.uint8)[:, None]
    assert np.array_equal(decode(png.encode(image)), image)


def test_without_gl_the_ball_is_drawn_in_the_middle(no_gl):
    frame = reports.render_poses(ball(), ball().qpos0[None], None, 80, 60)[0]
    assert frame.shape == (60, 80, 3)
    assert frame.dtype == np.uint8
    red = (frame[..., 0] > 2.0 * frame[..., 1]) & (frame[..., 0] > 80)
    rows, columns = np.nonzero(red)
    # the box around the ball is centred; perspective moves the ball in it by up to an eighth of the picture
    assert abs(rows.mean() - 29.5) < 60 / 8
    assert abs(columns.mean() - 39.5) < 2
    # the fit leaves a margin of about a tenth on each side of the box around the ball
    assert 0.3 < np.ptp(rows) / 60 < 0.95


def test_the_note_says_how_the_pictures_were_made(no_gl):
    assert render.render_frames(ball(), ball().qpos0, None, 16, 12).note == render.DRAWN_NOTE


def test_render_png_says_that_it_drew(tmp_path, no_gl):
    assert reports.render_png(ball(), None, tmp_path / "a.png", 64, 48) is False
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_a_gl_library_that_fails_is_quiet(monkeypatch, capfd):
    monkeypatch.setattr(render, "LIBRARIES", ("no-such-library",))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    film = render.render_frames(ball(), ball().qpos0, None, 32, 24)
    assert film.library is None
    assert capfd.readouterr() == ("", "")


def test_a_child_that_hangs_is_given_up(monkeypatch):
    def hang(*args, **options):
        raise subprocess.TimeoutExpired("python", 60)

    monkeypatch.setattr(subprocess, "run", hang)
    assert render.render_frames(ball(), ball().qpos0, None, 16, 12).library is None


def test_with_gl_the_same_things_are_in_the_same_place(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("CANDATA_GL", raising=False)
    gl_frames = render.render_frames(ball(), ball().qpos0, None, 80, 60)
    if gl_frames.library is None:
        pytest.skip("no GL library here")
    monkeypatch.setenv("MUJOCO_GL", "off")
    ray_frames = render.render_frames(ball(), ball().qpos0, None, 80, 60)
    red = [(f.frames[0][..., 0].astype(int) > 2 * f.frames[0][..., 1].astype(int)) for f in (gl_frames, ray_frames)]
    # outlines agree but for shading at the silhouette's rim
    assert (red[0] & red[1]).sum() > 0.85 * (red[0] | red[1]).sum()


def test_the_models_own_report_camera_is_used():
    model = ball('<camera name="report" pos="0 -1 .3" xyaxes="1 0 0 0 0 1" fovy="30"/>')
    assert camera.choose_camera(model, model.qpos0[None], None, 1.5) == "report"
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pinhole = camera.pinhole(model, data, "report")
    assert pinhole.position == pytest.approx([0, -1, 0.3])
    assert pinhole.axes[:, 2] == pytest.approx([0, -1, 0], abs=1e-12)
    assert pinhole.fovy_rad == pytest.approx(np.pi / 6)


def test_a_fitted_camera_holds_everything_that_moves():
    model, aspect = ball(), 4 / 3
    qpos = np.tile(model.qpos0, (5, 1))
    qpos[:, 0] = np.linspace(-0.5, 0.7, 5)
    view = camera.fit_camera(model, qpos, aspect)
    pinhole = camera.pinhole(model, mujoco.MjData(model), view)
    corners = qpos[:, None, :3] + 0.1 * camera.SIGNS
    offsets = (corners.reshape(-1, 3) - pinhole.position) @ pinhole.axes
    reach = np.tan(pinhole.fovy_rad / 2)
    assert (np.abs(offsets[:, 0] / offsets[:, 2]) < reach * aspect).all()
    assert (np.abs(offsets[:, 1] / offsets[:, 2]) < reach).all()
    across = np.abs(offsets[:, 0] / offsets[:, 2]).max() / (reach * aspect)
    assert across > 0.8  # and it is no farther than the margin asks


WALL = '<geom type="box" size=".02 .6 .6" pos="{x} {y} .3" euler="0 0 {turn}" rgba=".5 .5 .5 1"/>'


def test_a_camera_is_chosen_that_sees_the_object():
    """A wall between the usual view and the object moves the camera; without the wall it stays."""
    usual = camera.fit_camera(ball(), ball().qpos0[None], 1.5)
    assert camera.choose_camera(ball(), ball().qpos0[None], None, 1.5) == usual
    x, y, _ = -0.3 * usual.direction
    model = ball(WALL.format(x=x, y=y, turn=usual.azimuth_deg))
    chosen = camera.choose_camera(model, model.qpos0[None], None, 1.5)
    assert (chosen.azimuth_deg, chosen.elevation_deg) != camera.VIEWS[0]
    assert (chosen.azimuth_deg, chosen.elevation_deg) in camera.VIEWS


def test_a_ghost_is_seen_only_where_it_stands_clear_of_what_is_solid(no_gl):
    model = ball()
    geoms = tuple(np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0).tolist())
    view = camera.choose_camera(model, model.qpos0[None], None, 40 / 30)
    plain = render.render_frames(model, model.qpos0, view, 40, 30).frames[0].astype(int)
    for towards_camera_m, is_seen in ((0.0, False), (0.5 * CLEARANCE_M, False), (0.05, True)):
        moved = model.qpos0.copy()
        moved[:3] -= towards_camera_m * view.direction
        picture = render.render_frames(model, model.qpos0, view, 40, 30, Ghost(geoms, moved[None])).frames[0]
        is_pink = np.abs(picture - plain).max(axis=2) > 40
        assert is_pink[15, 20] == is_seen


@pytest.mark.parametrize(("higher_m", "is_seen"), [(0.75 * CLEARANCE_M, False), (2 * CLEARANCE_M, True)])
def test_a_ghost_is_seen_where_its_geom_is_elsewhere_however_flat_the_view(no_gl, higher_m, is_seen):
    """The camera looks along the top of a box: a top that is 3 mm higher lies more than 4 mm nearer to it."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body pos="0 0 .1"><freejoint/>
      <geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>""")
    view = camera.fit_camera(model, model.qpos0[None], 40 / 30)
    moved = model.qpos0.copy()
    moved[2] += higher_m
    assert higher_m / -view.direction[2] > CLEARANCE_M
    plain, ghostly = (
        render.render_frames(model, model.qpos0, view, 40, 30, ghost).frames[0].astype(int)
        for ghost in (None, Ghost((0,), moved[None]))
    )
    assert (np.abs(ghostly - plain).max() > 40) == is_seen


def test_models_without_geoms_or_joints_can_be_drawn(no_gl):
    for xml in ("<mujoco/>", '<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>'):
        model = mujoco.MjModel.from_xml_string(xml)
        assert reports.render_poses(model, model.qpos0[None], None, 16, 12)[0].shape == (12, 16, 3)
