"""The command that writes a dataset in a foreign format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.datasets import Dataset
    from candata.schema.episode import Episode

_EXAMPLES = """\b
Examples:
  candata export lerobot recordings --out for_lerobot
  candata export lerobot recordings --out for_lerobot --v21
"""


def register(app: typer.Typer) -> None:
    """Add `export`."""
    app.command("export", epilog=_EXAMPLES)(export)


@console.stoppable()
def export(
    format_name: Annotated[str, typer.Argument(metavar="FORMAT", help="Format; an unknown one lists them.")],
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")],
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder to write; appears whole or not at all.")],
    version: Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")] = None,
    v21: Annotated[bool, typer.Option("--v21", help="lerobot: the layout of v2.1 instead of v3.0.")] = False,
) -> None:
    """Write a version of a dataset in a foreign format; what the format cannot hold is said."""
    from functools import partial

    from candata.datasets import get_cloud
    from candata.datasets.drafts import draft_beside, place
    from candata.datasets.durable import sync_tree
    from candata.errors import UnknownNameError, UsageError
    from candata.formats import FORMATS, Writing

    target = FORMATS.load(format_name) if format_name in FORMATS else None
    if target is None or target.write is None:
        writable = [name for name, entry in FORMATS.load_all().items() if entry.write is not None]
        raise UnknownNameError("format to export to", format_name, writable)
    if v21 and "v21" not in target.variants:
        raise UsageError(f"`export {format_name}` takes no --v21", fix="leave it out")
    check_output(out, "new")
    data = console.open_named(dataset, version)
    writing = Writing(
        data.name, data.digest, data.lineage, "v21" if v21 else None, console.note, partial(get_cloud, data.path)
    )
    with console.stoppable(lambda: console.written_clause(out)), draft_beside(out) as folder:
        export_folder = folder / "export"
        export_folder.mkdir()
        target.write(_WithProgress(data), export_folder, writing)
        sync_tree(export_folder)
        place(export_folder, out)
    console.out(f"{out}: {len(data)} episodes of {data.name}@{data.digest[:12]}")


@dataclass(frozen=True)
class _WithProgress:
    """The episodes of a dataset, each reading of them under a progress bar."""

    data: Dataset

    def __iter__(self) -> Iterator[Episode]:
        """Yield all episodes."""
        with console.progress("reading episodes", len(self.data)) as advance:
            for episode in self.data.episodes():
                yield episode
                advance(1)
