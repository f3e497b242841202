"""The commands on objects that a scene may hold: scene object add."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.fetch import FetchedObjects, PublicDataset
    from candata.scenes.contract import SceneObject

_EXAMPLE = """\b
Examples:
  candata scene object add scans/mug.stl --mass 0.118 --out objects/mug
  candata scene object add scans/mug --mass 0.118 --out objects/mug      a folder: visual.obj, convex_0.stl, ...
  candata generate-sim --scene objects/mug/scene.yaml --episodes 8 --out tosses
"""


def register(app: typer.Typer) -> None:
    """Add the group `scene object` to the application."""
    objects = typer.Typer(help="Make objects that a scene may hold, from meshes.", no_args_is_help=True)
    objects.command("add", epilog=_EXAMPLE)(add)
    console.group(app, "scene", console.SCENE).add_typer(objects, name="object")


@console.stoppable()
def add(
    source: Annotated[
        Path, typer.Argument(metavar="MESH|FOLDER", help="Mesh [m]: .obj, .stl or .ply; or a folder with visual.obj.")
    ],
    mass: Annotated[float, typer.Option("--mass", metavar="KG", help="Mass of the object.")],
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder to write; it must not exist.")],
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="Its name [that of --out].")] = None,
    scale: Annotated[
        float, typer.Option("--scale", metavar="X", help="Factor to metres: 0.001 of a mesh in millimetres.")
    ] = 1.0,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Make an object from a mesh: convex pieces, inertia, the poses in which it rests, and a scene of it on a plane.

    Convex pieces lie in the folder as convex_0.stl, convex_1.stl and so on; else CoACD makes them where the mesh is
    hollow and the extra `objects` is installed, and the convex hull touches where it is not.
    """
    check_output(out, "new")
    from candata.datasets.drafts import draft_beside, place
    from candata.scenes.object_making import ObjectSource, make_object

    mesh_source = ObjectSource(source, out.resolve().name if name is None else name, mass, scale)
    with draft_beside(out) as draft:
        made = make_object(mesh_source, draft / "object", console.note)
        place(draft / "object", out)
    for warning in made.warnings:
        console.note(f"warning: {warning}")
    if json:
        console.out_json(made.scene_object.file.model_dump(mode="json"))
    else:
        _print(made.scene_object, out)


def _print(scene_object: SceneObject, folder: Path) -> None:
    """Print what an object is and how it rests."""
    file = scene_object.file
    inertia = "its closed mesh" if file.inertia == "exact" else "its convex hull"
    console.out(f"{folder}: {file.about}; convex pieces {len(file.pieces)}, inertia of {inertia}")
    rows = [(f"{r.probability:.1%}", f"{degrees(r.tilt_rad):.1f}", f"{r.height_m * 1e3:.1f}") for r in file.rests]
    console.out_table(("rests in", "tilt [deg]", "height [mm]"), rows)


def write_objects(out: Path, append: bool, source: PublicDataset, public_objects: FetchedObjects) -> None:
    """Write fetched objects as folders of one folder, with the licence; it appears whole or not at all.

    Raises
    ------
    UsageError
        When they are to be added to something.
    DataError
        When a file is not the published one.
    """
    from candata.datasets.drafts import draft_beside, place
    from candata.errors import UsageError
    from candata.scenes.object_making import ObjectSource, make_object

    if append:
        raise UsageError(f"{source.name} is a set of objects, no dataset", fix="leave out --append")
    with (
        console.stoppable(lambda: console.written_clause(out)),
        draft_beside(out) as draft,
        console.progress("objects", public_objects.count) as advance,
    ):
        objects = draft / "objects"
        for public_object in public_objects.objects:
            name, folder, mass_kg = public_object.name, public_object.folder, public_object.mass_kg
            mesh_source = ObjectSource(folder, name, mass_kg, origin=source.origin, licence=source.licence)
            for warning in make_object(mesh_source, objects / name).warnings:
                console.note(f"warning: {warning}")
            advance(1)
        (objects / "LICENSE.txt").write_text(public_objects.notice, encoding="utf-8")
        place(objects, out)
    console.out(f"{out}: {public_objects.count} objects")
