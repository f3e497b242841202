"""A cause planted in a random small scene: its world, and draws of a scene and values in which it matters."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from candata.effects import effect
from candata.gap.blind.draws import draw_setting
from candata.gap.blind.rigs.causes import CAUSES, Target, lift_of
from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.matter import matters
from candata.gap.blind.rigs.player import World
from candata.gap.blind.rigs.readings import Planted, ideal
from candata.gap.blind.rigs.recording import Drawn, logs, nominal, problem, sane_rig
from candata.scenes import Scene, load_scene
from candata.scenes.first_load import vouch
from candata.schema.effect import EffectSetting

#: Values drawn for a cause in one scene, and scenes tried, before it is given up.
VALUES, SCENES = 2, 60
#: Episodes on which it is checked that a cause matters.
CHECKED = 4


def planted(rig: Rig, given: EffectSetting) -> Planted:
    """Return the world of a rig with a cause in it, and its sensors."""
    model = nominal(rig).model
    cause, target = CAUSES[given.name], Target(rig, model)
    values = {name: np.atleast_1d(np.asarray(v, float)) for name, v in given.parameters.items()}
    command, read = cause.command, cause.read
    if cause.edit:
        cause.edit(target, values)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    world = World(model, lift_m=lift_of(rig, given.name, values))
    if command:
        world = World(model, lambda u: command(target, values, u))
    if read is None:
        return Planted(world, ideal)
    return Planted(world, lambda log: read(target, values, log, ideal(log)))


def drawn_cause(name: str, trait: str, seed: int, episodes: int, duration_s: float | None) -> tuple[int, EffectSetting]:
    """Return the seed of a scene in which a cause matters, and the cause with its values.

    Matters: in a plain replay without it, from the state that its first readings tell, some channel is off by
    `matter.CLEAR` times its noise. Where it does not for any of `VALUES` draws, the next scene is drawn.
    """
    rng = np.random.default_rng([seed, len(name)])
    for _ in range(SCENES):
        drawn = sane_rig(seed, trait, episodes, duration_s)
        if CAUSES[name].acts(drawn.rig):
            found = setting_that_matters(drawn, name, rng)
            if found is not None:
                return seed, found
        seed = int(rng.integers(2**62))
    raise RuntimeError(f"{name} matters in none of {SCENES} scenes of trait {trait}")


def setting_that_matters(drawn: Drawn, name: str, rng: np.random.Generator) -> EffectSetting | None:
    """Return a drawn setting of a cause that matters in a scene; None after `VALUES` draws that do not."""
    scene = scene_of_rig(drawn.rig)
    if not effect(name).possible(scene):
        return None
    for _ in range(VALUES):
        given = draw_setting(scene, name, rng)
        if is_clear(drawn, given):
            return given
    return None


def is_clear(drawn: Drawn, given: EffectSetting) -> bool:
    """Tell whether a cause matters in a scene, and leaves it sane."""
    world = planted(drawn.rig, given)
    few = drawn.outlines[:CHECKED]
    played = logs(world.world, drawn.rig, few)
    if played is None or problem(drawn.rig, few, played) or not matters(drawn.rig, world, few, played):
        return False
    played = logs(world.world, drawn.rig, drawn.outlines)
    return played is not None and not problem(drawn.rig, drawn.outlines, played)


def scene_of_rig(rig: Rig) -> Scene:
    """Return the scene as candata loads it: asked for the ranges of effects, never played."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "scene.xml").write_text(rig.xml)
        (Path(folder) / "scene.yaml").write_text(rig.yaml)
        vouch(Path(folder) / "scene.xml")
        return load_scene(Path(folder) / "scene.yaml")
