"""Tiny scenes of a user's: an MJCF and a scene.yaml beside it."""

from __future__ import annotations

import pytest

from candata.scenes import load_scene


@pytest.fixture
def user_scene(tmp_path):
    """Make a scene of an MJCF body and roles."""

    def make(body: str, roles: str, option: str = 'timestep="0.002"'):
        folder = tmp_path / f"scene{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        text = f"<mujoco><option {option}/><worldbody>{body}</worldbody></mujoco>"
        (folder / "scene.xml").write_text(text)
        (folder / "scene.yaml").write_text(f"model: scene.xml\n{roles}")
        return load_scene(folder / "scene.yaml")

    return make


@pytest.fixture
def ball_over_plate(user_scene):
    """Make a scene with a 50 g ball over a plate that is a fingertip; its force frame may be turned [deg]."""

    def make(rate_hz: float = 100.0, euler: str = "0 0 0", gap_m: float = 0.0):
        body = (
            '<body name="tip" pos="0 0 0.5"><geom name="plate" type="box" size="0.05 0.05 0.01"/>'
            f'<site name="frame" euler="{euler}"/></body>'
            f'<body name="ball" pos="0 0 {0.53 + gap_m}"><freejoint/>'
            '<geom type="sphere" size="0.02" mass="0.05"/></body>'
        )
        roles = f"rate_hz: {rate_hz:g}\nobject: ball\nfingertips: [tip]\nfingertip_frames: [frame]\n"
        return user_scene(body, roles)

    return make
