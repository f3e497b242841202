"""A first scene file of a model: proposed, checked, and written."""

from __future__ import annotations

import os
from pathlib import Path

from candata.datasets.writing import write_text
from candata.errors import SceneError, UsageError, Where
from candata.scenes.assemble import Scene, assemble
from candata.scenes.model_file import compile_model, read_model
from candata.scenes.named_files import kind_of
from candata.scenes.proposal import Proposal, propose
from candata.scenes.scene_text import scene_text
from candata.schema.scene import SceneFile
from candata.schema.yaml_text import parse_yaml


def write_draft(model: Path, out: Path) -> tuple[Scene, Proposal]:
    """Return the scene that a drafted scene file at `out` describes, and the proposal that it is made of.

    The file is written last, once it has been read as any scene is.

    Raises
    ------
    UsageError
        When the model does not exist, or `out` does not end as scene files do.
    DataError
        When the model, or a file that it names, is a Git LFS pointer.
    SceneError
        When the model cannot be read or does not compile, or holds nothing that a scene can be made of.
    """
    if not model.is_file():
        kind_found = f"is {kind}, no file" if (kind := kind_of(model)) else "does not exist"
        raise UsageError(f"model {model} {kind_found}", expected="an MJCF or a URDF", where=Where(path=str(model)))
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{out} is no scene file", expected="a name that ends in .yaml", where=Where(path=str(out)))
    spec = read_model(model)
    # Links that are fixed to others are told apart: a fingertip is often one.
    spec.compiler.fusestatic = False
    proposal = propose(compile_model(spec, str(model)))
    if not proposal.joints and proposal.object is None:
        raise SceneError(
            f"model {model.name} holds nothing that is recorded",
            expected="hinge or slide joints with names, or a body with a free joint and a name",
            found="; ".join(proposal.notes) or "no such joint and no free body",
            where=Where(path=str(model)),
        )
    text = scene_text(proposal, _from(out, model))
    scene = assemble(str(out), SceneFile.parse(parse_yaml(text), out), read_model(model))
    write_text(out, text, "scene")
    return scene, proposal


def _from(out: Path, model: Path) -> str:
    """Return the path of a model as it is named from a scene file."""
    return os.path.relpath(model.parent.resolve() / model.name, out.parent.resolve())
