"""Scenes whose simulations also tell labels of contact; the motion is that of the scene, bit for bit."""

from __future__ import annotations

from dataclasses import replace

from candata.errors import UsageError
from candata.scenes import sensors
from candata.scenes.assemble import Scene
from candata.scenes.model_file import compile_model


def with_labels(scene: Scene, taxels: bool = False) -> Scene:
    """Return a scene whose simulations also tell which fingertips meet the object: the same motion, more sensors.

    Its digest is that of the scene. One without fingertips, or with neither an object nor `taxels`, stays as it is.

    Parameters
    ----------
    scene : Scene
        As `load_scene` returns it.
    taxels : bool
        Tell each contact of the fingertips too.

    Raises
    ------
    UsageError
        When effects belong to the scene, or it has labels already.
    """
    tips = scene.file.fingertips
    if not tips or not (scene.file.object or taxels):
        return scene
    if scene.spec is None:
        raise UsageError(f"scene {scene.name} cannot be labelled", expected="a scene as load_scene returns it")
    spec = scene.spec.copy()
    for index, tip in enumerate(tips):
        if scene.file.object is not None:
            sensors.add_collision(spec, scene.file, index, tip)
        if taxels:
            sensors.add_contacts(spec, index, tip)
    return replace(scene, model=compile_model(spec, scene.name), spec=None, unlabelled=scene)
