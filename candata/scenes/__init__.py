"""Scenes: a model plus the roles of its parts."""

from candata.scenes.assemble import Scene, load_scene

__all__ = ["Scene", "load_scene"]
