"""The option --effects of commands that also take a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from candata.schema.effect import EffectsFile


def note_other_scene(effects_file: EffectsFile, path: Path, digest: str) -> None:
    """Say that the effects were found in another scene, where that one can still be read."""
    from candata.effects import scene_of
    from candata.errors import CandataError
    from candata.scenes import load_scene
    from candata_cli.console import note

    if effects_file.scene is None:
        return
    try:
        is_same = load_scene(scene_of(effects_file, path)).digest == digest
    except CandataError:
        is_same = False
    if not is_same:
        note(f"{path.name} was made for another scene: {effects_file.scene}")
