"""The command that writes a dataset in a foreign format."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.datasets import Dataset
    from candata.hub import HubAddress
    from candata.schema.episode import Episode

_EXAMPLES = """\b
Examples:
  candata export lerobot recordings --out for_lerobot
  candata export lerobot recordings --out for_lerobot --v21
  candata export lerobot recordings --push hf:me/my_set --licence cc-by-4.0
"""


def register(app: typer.Typer) -> None:
    """Add `export`."""
    app.command("export", epilog=_EXAMPLES)(export)


@console.stoppable()
def export(
    format_name: Annotated[str, typer.Argument(metavar="FORMAT", help="Format; an unknown one lists them.")],
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help="Folder to write; appears whole or not at all.")
    ] = None,
    version: Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")] = None,
    v21: Annotated[bool, typer.Option("--v21", help="lerobot: the layout of v2.1 instead of v3.0.")] = False,
    push: Annotated[
        str | None, typer.Option("--push", metavar="hf:ORG/NAME", help="lerobot: send it to the Hub (extra `hub`).")
    ] = None,
    licence: Annotated[
        str | None, typer.Option("--licence", metavar="SPDX", help="With --push: its licence [what its source states].")
    ] = None,
    private: Annotated[bool, typer.Option("--private", help="With --push: a new repository is private.")] = False,
) -> None:
    """Write a version of a dataset in a foreign format, or push it to the Hub; what the format cannot hold is said.

    A push makes the repository where there is none, and writes a card with columns, units, lineage and licence.
    """
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
    if out is not None:
        check_output(out, "new")
    elif push is None:
        raise UsageError("nowhere to write to", expected="--out FOLDER, --push hf:ORG/NAME, or both")
    data = console.open_named(dataset, version)
    target_address = _push_target(data, format_name, push, licence, private)
    writing = Writing(
        data.name, data.digest, data.lineage, "v21" if v21 else None, console.note, partial(get_cloud, data.path)
    )
    if out is not None:
        with console.stoppable(lambda: console.written_clause(out)), draft_beside(out) as folder:
            export_folder = folder / "export"
            export_folder.mkdir()
            target.write(_WithProgress(data), export_folder, writing)
            sync_tree(export_folder)
            place(export_folder, out)
        console.out(f"{out}: {len(data)} episodes of {data.name}@{data.digest[:12]}")
    if target_address is None:
        return
    with tempfile.TemporaryDirectory() as folder_name:
        if out is None:
            target.write(_WithProgress(data), Path(folder_name), writing)
        _push(data, out or Path(folder_name), *target_address, private)


def _push_target(
    data: Dataset, format_name: str, push: str | None, licence: str | None, private: bool
) -> tuple[HubAddress, str] | None:
    """Return where a set is pushed to and its licence, checked before anything is written; None without a push."""
    from candata.errors import UsageError

    if push is None:
        if licence is not None or private:
            raise UsageError(
                "--licence and --private belong to --push", fix="leave them out, or give --push hf:ORG/NAME"
            )
        return None
    if format_name != "lerobot":
        raise UsageError(f"`export {format_name}` takes no --push", expected="candata export lerobot DATASET --push")
    from candata.hub import parse_address, stated_licences
    from candata.hub.uploads import require_token

    address, licences = parse_address(push), stated_licences(data.lineage)
    if address.revision is not None:
        raise UsageError("a push goes to the main branch", found=push, fix=f"leave out @{address.revision}")
    if licence is None and len(licences) != 1:
        raise UsageError(
            "the licence of the set is not known",
            found=f"its lineage states {', '.join(sorted(licences)) or 'none'}",
            fix="say it: --licence cc-by-4.0",
        )
    require_token()
    return address, licence or licences.pop()


def _push(data: Dataset, folder: Path, address: HubAddress, licence: str, private: bool) -> None:
    """Push an exported folder and print where it is."""
    from candata.hub import push_set

    with console.stoppable("files that were sent are not sent again", goes_on=True):
        commit = push_set(folder, address, licence, private, console.note)
    console.out(f"{address}@{commit[:12]}: {len(data)} episodes of {data.name}@{data.digest[:12]}, licence {licence}")


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
