"""The repaired simulator as MJCF: the user's own files with a few attributes changed, and what they cannot hold."""

from __future__ import annotations

import difflib
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy as duplicate
from pathlib import Path

import mujoco
import numpy as np
import yaml

from candata.datasets.drafts import draft_beside, place
from candata.effects import effect, flatten
from candata.errors import SceneError, UsageError
from candata.repair.copies import Copy, Way, copy_scene, ways
from candata.repair.fields import INERTIA, differences
from candata.repair.markup import Edit, edited_files, merge_edits, parse
from candata.repair.parts import HeldEffect, OmittedEffect, effects_to_add, holds, omitted_effect
from candata.repair.writes import edits
from candata.scenes import Scene, load_scene
from candata.scenes.first_load import vouch
from candata.scenes.model_file import compile_model, parse_model
from candata.schema.effect import EffectSetting, EffectsFile
from candata.schema.record import ResultRecord
from candata.simulate.world import build_worlds

EFFECTS, DIFF, LISTING_FILE = "effects.yaml", "changes.diff", "export.json"
#: Agreement asked of the exported model: meshes are stored in single precision, MuJoCo saves a whole model with six
#: digits; an edit that went wrong is off by far more.
AGREEMENT: dict[Way, float] = {"patch": 1e-6, "whole": 2e-5}


class Change(ResultRecord):
    """One attribute that changed: null where there was none before, or is none after."""

    file: str
    line: int
    element: str
    attribute: str
    before: str | None = None
    after: str | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells of a table for people."""
        return (f"{self.file}:{self.line}", self.element, self.attribute, self.before or "-", self.after or "-")


class MjcfExport(ResultRecord):
    """What an export wrote.

    `way` is patch (the user's own files, byte by byte the same but for the attributes in `changes`) or whole (the
    model as MuJoCo saves it, with six digits).
    """

    folder: str
    scene: str
    model: str
    way: Way
    held: tuple[HeldEffect, ...] = ()
    left: tuple[OmittedEffect, ...] = ()
    changes: tuple[Change, ...] = ()
    diff: str | None = None
    effects: str | None = None

    @property
    def headline(self) -> str:
        """One line for people."""
        way_text = "your files, patched" if self.way == "patch" else "the whole model, as MuJoCo saves it"
        names = ", ".join(e.label for e in self.held) or "no effect"
        return f"{self.scene}: {way_text}; holds {names}"


def export_mjcf(scene: Scene, effects: Sequence[EffectSetting], out: Path) -> MjcfExport:
    """Return what was written to `out`: the scene's MJCF with the effects in it, a diff, and what MJCF cannot hold.

    What is written is loaded again and compared with the model that the effects make in candata; an effect for which
    the two differ is not written but listed.

    Raises
    ------
    UsageError
        When `out` exists, or an effect cannot act in the scene.
    SceneError
        When the scene's model cannot be written at all.
    """
    build_worlds(scene, [effects])
    with fresh_folder(out) as draft:
        way, held_effects, reasons = _best_way(scene, [s for s in effects if holds(s)], draft)
        copy = copy_scene(scene, way, draft / "out")
        original_bytes = {path: path.read_bytes() for path in copy.folder.rglob("*.xml")}
        changes = apply_effects(copy, scene, held_effects)
        diff = _diff(copy, original_bytes)
        rest = [e for e in (omitted_effect(s, reasons.get(s.model_dump_json())) for s in effects) if e is not None]
        export = MjcfExport(
            folder=str(out),
            scene=str(copy.scene.relative_to(copy.folder)),
            model=str(copy.model.relative_to(copy.folder)),
            way=way,
            held=tuple(HeldEffect(name=s.name, element=s.element, parameters=s.parameters) for s in held_effects),
            left=tuple(rest),
            changes=tuple(changes),
            diff=DIFF if diff else None,
            effects=EFFECTS if effects_to_add(rest) else None,
        )
        _write(export, copy, diff)
        place(copy.folder, out)
    return export


def mjcf_changes(scene: Scene, effects: Sequence[EffectSetting]) -> tuple[Change, ...]:
    """Return the attributes of a scene's MJCF that the effects change, as `export_mjcf` writes them; nothing is kept.

    Raises
    ------
    UsageError
        When an effect cannot act in the scene.
    SceneError
        When the scene's model cannot be written at all.
    """
    with tempfile.TemporaryDirectory(prefix="candata-mjcf-") as folder:
        return export_mjcf(scene, effects, Path(folder) / "model").changes


@contextmanager
def fresh_folder(out: Path) -> Iterator[Path]:
    """Yield an empty folder beside `out`, which goes when done: what is whole is moved to `out`.

    Raises
    ------
    UsageError
        When `out` exists.
    """
    if out.exists():
        raise UsageError("the folder to export to exists", found=str(out), fix="name another --out, or remove it")
    with draft_beside(out) as draft:
        yield draft


def _best_way(
    scene: Scene, effects: Sequence[EffectSetting], draft: Path
) -> tuple[Way, list[EffectSetting], dict[str, str]]:
    """Return the way that holds the most effects (a patch if it holds as many), those effects, and why not the others.

    Raises
    ------
    SceneError
        When the model cannot be written in any way.
    """
    attempts: list[tuple[Way, list[EffectSetting], dict[str, str]]] = []
    reason: str | None = None
    for way in ways(scene):
        if _refusal(scene, effects, way, draft) is None:
            return way, list(effects), {}
        reason = _refusal(scene, (), way, draft)
        if reason is None:
            attempts.append((way, *_writable_effects(scene, effects, way, draft)))
    if not attempts:
        raise SceneError(f"the model of scene {scene.name} cannot be written as MJCF", found=reason)
    return max(attempts, key=lambda entry: len(entry[1]))


def _writable_effects(
    scene: Scene, effects: Sequence[EffectSetting], way: Way, draft: Path
) -> tuple[list[EffectSetting], dict[str, str]]:
    """Return the effects that can be written, added one by one, and why the others cannot."""
    held_effects: list[EffectSetting] = []
    reasons: dict[str, str] = {}
    for s in effects:
        reason = _refusal(scene, [*held_effects, s], way, draft)
        if reason is None:
            held_effects.append(s)
        else:
            reasons[s.model_dump_json()] = reason
    return held_effects, reasons


def _refusal(scene: Scene, effects: Sequence[EffectSetting], way: Way, draft: Path) -> str | None:
    """Return why a model written with `effects` is not the one that candata simulates; None when it is."""
    folder = draft / "trial"
    try:
        copy = copy_scene(scene, way, folder)
        apply_effects(copy, scene, effects)
        written_model = load_scene(copy.scene).model
    except (SceneError, ValueError) as error:
        return str(error).splitlines()[0]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    target = target_model(scene, effects)
    is_fixed = target.body_weldid == 0
    differing_fields = [
        d.field
        for d in differences(written_model, target, AGREEMENT[way])
        # Inertia of what never moves is of no consequence.
        if d.field not in INERTIA or len(written_model.body_mass) != len(is_fixed) or not is_fixed[list(d.ids)].all()
    ]
    return f"the model written differs in {', '.join(differing_fields)}" if differing_fields else None


def target_model(scene: Scene, effects: Sequence[EffectSetting]) -> mujoco.MjModel:
    """Return the model that an export shall hold: what effects edit, and what MJCF has in place of their hooks.

    Raises
    ------
    SceneError
        When MJCF cannot hold one of them.
    """
    model = build_worlds(scene, [effects]).models[0]
    for s in effects:
        native, x = effect(s.name).native, flatten(s, scene)
        if native is not None and np.isfinite(x).all():
            model = duplicate(model)
            native(model, scene, x, s.element)
    return model


def apply_effects(copy: Copy, scene: Scene, effects: Sequence[EffectSetting]) -> list[Change]:
    """Return what changed when the effects were written into the files of a copy."""
    target = target_model(scene, effects)
    root = parse(copy.model)
    spec = parse_model(copy.model)
    compile_model(spec, scene.name)
    merged_edits = merge_edits(edits(scene.model, target, spec, root))
    for path, raw in edited_files(merged_edits).items():
        path.write_bytes(raw)
    vouch(copy.model)
    return [change for edit in merged_edits for change in _changes(edit, copy)]


def _changes(edit: Edit, copy: Copy) -> list[Change]:
    """Return the changes of one element."""
    node = edit.node
    file = str(node.file.relative_to(copy.folder))
    element = " ".join(filter(None, [node.tag, node.attributes.get("name")]))
    out = [
        Change(file=file, line=node.line, element=element, attribute=k, before=node.attributes.get(k), after=v)
        for k, v in edit.attributes.items()
        if v != node.attributes.get(k)
    ]
    if edit.tag:
        out.append(
            Change(file=file, line=node.line, element=element, attribute="(tag)", before=node.tag, after=edit.tag)
        )
    if edit.inner_text:
        out.append(
            Change(file=file, line=node.line, element=element, attribute="(child)", after=edit.inner_text.strip())
        )
    return out


def _diff(copy: Copy, original_bytes: dict[Path, bytes]) -> bytes:
    """Return the unified diff of all files that changed, paths from the copy's folder."""
    out = b""
    for path, raw in sorted(original_bytes.items()):
        name = path.relative_to(copy.folder).as_posix().encode()
        lines = difflib.diff_bytes(
            difflib.unified_diff, _lines(raw), _lines(path.read_bytes()), b"a/" + name, b"b/" + name
        )
        out += b"".join(lines)
    return out


def _lines(raw: bytes) -> list[bytes]:
    """Return lines with their ends; one that ends with the file says so, as diffs do."""
    *complete_lines, last_line = raw.split(b"\n")
    return [line + b"\n" for line in complete_lines] + (
        [last_line + b"\n\\ No newline at end of file\n"] if last_line else []
    )


def _write(export: MjcfExport, copy: Copy, diff: bytes) -> None:
    """Write the diff, the listing, and the effects that are left beside the model."""
    if export.diff:
        (copy.folder / export.diff).write_bytes(diff)
    if export.effects:
        file = EffectsFile(scene=os.path.relpath(copy.scene, copy.folder), effects=effects_to_add(export.left))
        (copy.folder / export.effects).write_text(yaml.safe_dump(file.model_dump(mode="json"), sort_keys=False))
    (copy.folder / LISTING_FILE).write_text(export.model_dump_json(indent=2) + "\n")
