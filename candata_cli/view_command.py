"""The command that shows an episode in motion: view."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from candata_cli.outputs import check_output

_EXAMPLE = """\b
Examples:
  candata view sim --episode xhand_tabletop-s1-000000
  candata view recordings --episode grasp-003 --scene scene.yaml --out out/grasp.rrd
"""

#: Characters of an id that no file's name bears, and how much of an id a name holds.
_UNSAFE, _LONGEST_NAME = r"[^\w.-]|^[.-]", 100


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("view", epilog=_EXAMPLE)(view)


def view(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")],
    episode: Annotated[
        str | None, typer.Option("--episode", metavar="ID", help="Episode; the first by id by default.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.rrd", help="File to write instead of opening the viewer.")
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="Name or scene.yaml; by default the episode's, if built in."),
    ] = None,
    version: Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")] = None,
) -> None:
    """Show an episode in Rerun: hand, object, contacts and forces in space, and traces over time.

    Needs the extra `view`. Without --out the viewer opens; where there is no display, EPISODE.rrd is written here.
    """
    if out is not None:
        check_output(out, "file")
    from candata.reports.rerun_view import has_display
    from candata.reports.rerun_view import view as show
    from candata_cli import console

    data = console.open_named(dataset, version)
    episode_id = episode or data.ids[0]
    if out is None and not has_display():
        out = Path(f"{re.sub(_UNSAFE, '_', episode_id)[:_LONGEST_NAME]}.rrd")
        check_output(out, "file")
        console.note(f"there is no display to open a window on: open {out} with `rerun` where there is one")
    for line in show(data, episode_id, scene, out):
        console.note(line)
    console.note(f"{episode_id}: {out}, {out.stat().st_size / 1e6:.2f} MB" if out else f"{episode_id}: shown in Rerun")
