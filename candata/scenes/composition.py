"""An arm that carries a hand, as one model: each a registered name, or a file of the user's."""

from __future__ import annotations

import mujoco

from candata.scenes.contract import ARMS, HANDS


def compose(
    arm: str,
    hand: str,
    *,
    world: mujoco.MjSpec,
    base_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> mujoco.MjSpec:
    a, h = ARMS.load(arm), HANDS.load(hand)
    a.add(world, world.worldbody, base_m, (1.0, 0.0, 0.0, 0.0))
    site = world.site(a.flange)
    mount = site.parent.add_body(name="mount", pos=site.pos, quat=site.quat)
    h.add(world, mount, (1.0, 0.0, 0.0, 0.0))
    return world
