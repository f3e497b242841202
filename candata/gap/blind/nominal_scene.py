"""The simulator in which a case is diagnosed: a scene, with the noise of its sensors declared or not."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from candata.gap.verdict.findings import lasting
from candata.scenes import Scene, load_scene


class NominalScene(NamedTuple):
    """What a case says of its simulator, in plain words that hold in any process.

    Attributes
    ----------
    name : str
        What `load_scene` takes.
    noise_declared : bool
        Whether the diagnosis is told the noise that the scene declares.
    """

    name: str
    noise_declared: bool = True

    @property
    def anywhere(self) -> NominalScene:
        """The same with a scene file by its whole path."""
        return self._replace(name=lasting(self.name))

    def load(self) -> Scene:
        """Return the scene; its errors are those of `load_scene`."""
        scene = load_scene(self.name)
        return scene if self.noise_declared else replace(scene, file=scene.file.model_copy(update={"noise": None}))
