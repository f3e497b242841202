"""Commands on scenes: scene list, scene show, scene init, scene servo, scene export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.repair import MjcfExport, SysidExport
    from candata.scenes import Scene
    from candata.scenes.roles import JointRole, Roles
    from candata.schema.effect import EffectsFile

TARGETS = ("mjcf", "mujoco-sysid")
_EXPORT = "Example: candata scene export --effects out/report/effects.yaml --out out/repaired"
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
_INIT_EXAMPLE = """\b
Example:
  candata scene init hand/hand.xml          then edit hand/scene.yaml
  candata scene show hand/scene.yaml
"""
_SERVO_EXAMPLE = """\b
Example:
  candata scene servo --dataset out/g1_pick --out out/g1_scene
"""


def register(app: typer.Typer) -> None:
    """Add the group `scene` to the application."""
    group = console.group(app, "scene", console.SCENE)
    group.command("list", epilog="Example: candata scene list")(list_)
    group.command("show", epilog="Example: candata scene show cube_toss")(show)
    group.command("init", epilog=_INIT_EXAMPLE)(init)
    group.command("servo", epilog=_SERVO_EXAMPLE)(servo)
    group.command("export", epilog=_EXPORT)(export)


def list_(json: Json = False) -> None:
    """List the built-in scenes."""
    from candata.scenes.roles import builtin_scenes
    from candata_cli.console import out_json, out_table

    scenes = builtin_scenes()
    if json:
        out_json([entry.model_dump(mode="json") for entry in scenes])
        return
    header = ("name", "joints", "actuators", "fingertips", "rate", "about")
    rows = [(e.name, e.joints, e.actuators, e.fingertips, f"{e.rate_hz:g} Hz", e.about) for e in scenes]
    out_table(header, rows)


def show(
    name: Annotated[str, typer.Argument(metavar="SCENE", help="Name, or path of a scene.yaml.")],
    picture: Annotated[Path | None, typer.Option("--out", metavar="PNG", help="Picture to write.")] = None,
    json: Json = False,
) -> None:
    """Print the roles of a scene's parts; with --out, write a picture of it."""
    if picture is not None:
        check_output(picture, "file")
    from candata.scenes import load_scene
    from candata.scenes.roles import roles
    from candata_cli.console import note, out_json

    scene = load_scene(name)
    if json:
        out_json(roles(scene).model_dump(mode="json"))
    else:
        _print(roles(scene))
    if picture is not None:
        from candata.reports import render_png

        picture.parent.mkdir(parents=True, exist_ok=True)
        by_library = render_png(scene.model, None, picture)
        note(f"{picture}{'' if by_library else ' (no GL library found: a drawn projection)'}")


def init(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF (.xml) or URDF (.urdf).")],
    scene: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Scene file to write [scene.yaml beside the model].")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a scene file that stands there.")] = False,
) -> None:
    """Write a scene.yaml for a model, to edit: joints, actuators, fingertips, fingers, object and support as they seem.

    Every key has a comment that says what it means, in which unit, and what else there is to choose from.
    """
    from candata.scenes.draft import write_draft
    from candata_cli.console import note
    from candata_cli.console import out as say

    path = scene or model.parent / "scene.yaml"
    check_output(path, "file" if force else "new", fix="name another --out, or overwrite it with --force")
    draft, proposal = write_draft(model, path)
    roles = draft.file
    counts = f"joints {len(roles.joints)}, actuators {len(roles.actuator_names)}, fingertips {len(roles.fingertips)}"
    say(f"{path}: {counts}, object {roles.object or 'none'}, {roles.rate_hz:g} Hz")
    for line in proposal.open_questions:
        note(f"check: {line}")
    note(f"edit it, then: candata scene show {path}")


def servo(
    dataset: Annotated[Path, typer.Option("--dataset", metavar="DATASET", help="Recorded joints and commands.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for scene.xml and scene.yaml.")],
    natural_hz: Annotated[
        float | None, typer.Option("--natural", metavar="HZ", min=0.01, help="Natural frequency [a sixth of the rate].")
    ] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", metavar="RAD", min=0, help="Noise of the positions to declare, 1 sd.")
    ] = None,
) -> None:
    """Write a scene for a robot without a model: one servo a joint, each on its own, from names and ranges."""
    check_output(out, "folder")
    from candata.datasets import open_dataset
    from candata.scenes.servo import servo_joints, write_servo_scene
    from candata_cli.console import out as say

    names, ranges, rate_hz = servo_joints(open_dataset(dataset).episodes())
    scene_path = write_servo_scene(out, names, ranges, rate_hz, natural_hz, noise)
    say(f"{scene_path}: {len(names)} joints, {rate_hz:g} Hz")


def export(
    effects: Annotated[Path, typer.Option("--effects", metavar="FILE", help="The repaired simulator: effects.yaml.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write; it must not exist.")],
    scene: Annotated[
        str | None, typer.Option("--scene", metavar="SCENE", help="Name or scene.yaml; else that of --effects.")
    ] = None,
    target: Annotated[str, typer.Option("--to", help=f"What to write: {', '.join(TARGETS)}.")] = "mjcf",
    dataset: Annotated[
        Path | None, typer.Option("--dataset", metavar="DATASET", help="Recordings, for mujoco-sysid.")
    ] = None,
    json: Json = False,
) -> None:
    """Write the repaired simulator as MJCF, or parameters and sequences for mujoco.sysid.

    Of your own MJCF only the attributes that an effect changes are touched; changes.diff shows them. What MJCF
    cannot hold is listed with where to apply it instead.
    """
    from candata.effects import read_effects, scene_of
    from candata.errors import UnknownNameError, UsageError
    from candata.scenes import load_scene
    from candata_cli.console import note, out_json
    from candata_cli.effects_option import note_other_scene

    if target not in TARGETS:
        raise UnknownNameError("target", target, TARGETS)
    if (dataset is not None) != (target == "mujoco-sysid"):
        raise UsageError("--dataset and --to mujoco-sysid go together", fix="give both, or neither")
    check_output(out, "new")
    effects_file = read_effects(effects)
    world = load_scene(scene or scene_of(effects_file, effects))
    if scene is not None:
        note_other_scene(effects_file, effects, world.digest)
    export_result = _export(effects_file, world, dataset, out)
    if json:
        out_json(export_result.model_dump(mode="json"))
    else:
        _print_export(export_result)
    note(f"written: {out}")


def _export(effects_file: EffectsFile, world: Scene, dataset: Path | None, out: Path) -> MjcfExport | SysidExport:
    """Write what was asked for."""
    from candata.datasets import open_dataset
    from candata.repair import export_mjcf, export_sysid

    if dataset is None:
        return export_mjcf(world, effects_file.effects, out)
    return export_sysid(world, effects_file.effects, open_dataset(dataset), out)


def _print_export(result: MjcfExport | SysidExport) -> None:
    """Print an export for people."""
    from candata_cli.console import out, out_table

    out(result.headline)
    if result.changes:
        out("")
        out_table(("where", "element", "attribute", "before", "after"), [c.cells for c in result.changes])
    if result.left:
        out("")
        out("not in it:")
        for entry in result.left:
            out(f"  {entry.label}: {entry.why}")
            out(f"    {entry.apply}")


def _print(roles: Roles) -> None:
    """Print the roles for people."""
    from candata_cli.console import out, out_table

    out(f"{roles.name}  (digest {roles.digest[:12]})")
    step_ms = f"{roles.timestep_s * 1e3:.4g} ms"
    physics = f"{roles.integrator}, {roles.cone} cone, {roles.solver} solver"
    out(f"control   {roles.rate_hz:g} Hz, {roles.substeps} physics steps of {step_ms}; {physics}")
    mass = "" if roles.object_mass_kg is None else f", {roles.object_mass_kg:.4g} kg"
    out(f"object    {roles.object or 'none'}{mass}; support {roles.support or 'none'}")
    out(f"noise     {_noise(roles)}")
    out(f"policies  {', '.join(roles.policies) or 'all that can act'}")
    if roles.joints:
        out("")
        header = ("joint", "type", "unit", "range", "actuator", "drive", "kp", "kv", "limit", "group")
        out_table(header, [_joint(joint) for joint in roles.joints])
    if roles.fingertips:
        out("")
        out_table(("fingertip", "body", "force frame"), [(f.name, f.body, f.frame) for f in roles.fingertips])
    if roles.notes:
        out("")
    for line in roles.notes:
        out(f"note: {line}")


def _joint(joint: JointRole) -> tuple[str, ...]:
    """Return the cells of one joint."""
    span = "-" if joint.low is None or joint.high is None else f"{joint.low:.3g} .. {joint.high:.3g}"
    quantities = (joint.kp, joint.kp_unit), (joint.kv, joint.kv_unit), (joint.limit, joint.limit_unit)
    numbers = ("-" if value is None else f"{value:.4g} {unit}" for value, unit in quantities)
    return (joint.name, joint.type, joint.unit, span, joint.actuator or "-", joint.drive or "-", *numbers, joint.group)


def _noise(roles: Roles) -> str:
    """Return the declared noise, one standard deviation each."""
    noise = roles.noise
    if noise is None:
        return "none declared"
    position, turn = noise.object_pose
    by_joint = noise.joint_position if isinstance(noise.joint_position, tuple) else (noise.joint_position,)
    return (
        f"pose {position:.2g} m, {turn:.2g} rad; joints {', '.join(f'{size:.2g}' for size in by_joint)}; "
        f"force {noise.fingertip_force:.2g} N in steps of {noise.force_step:.2g} N"
    )
