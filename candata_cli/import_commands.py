"""Commands that bring data in: `import` from files, `fetch` from public places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.schema.episode import Episode
    from candata.schema.manifest import Lineage, VersionFile

Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="Dataset to write.")]
Append = Annotated[bool, typer.Option("--append", help="Add to a dataset that stands.")]


def register(app: typer.Typer) -> None:
    """Add `import` and `fetch`."""
    app.command("import")(import_)
    app.command("fetch")(fetch)


def import_(
    format_name: Annotated[str, typer.Argument(metavar="FORMAT", help="Kind of source, such as `table`.")],
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="For `table`: a map.yaml.")],
    out: Out,
    append: Append = False,
    allow_gaps: Annotated[
        bool, typer.Option("--allow-gaps", help="Mark values that are not finite as invalid.")
    ] = False,
) -> None:
    """Import recordings into a dataset: all of a source or nothing; the same source twice adds nothing."""
    from candata import __version__
    from candata.plugins import load
    from candata.schema.manifest import Lineage

    reader = load("candata.formats", "FORMAT", format_name)
    _refuse_standing(out, append)
    lineage = Lineage(
        operation=f"import {format_name}",
        config_digest=reader.digest(source),
        tools={"candata": __version__},
        details={"source": source.name, "allow_gaps": allow_gaps},
    )
    _publish(out, reader.read(source, allow_gaps), lineage)


def fetch(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Public data set, such as `cube-tosses`.")],
    out: Out,
    folder: Annotated[
        Path | None, typer.Option("--from", metavar="FOLDER", help="Read a prepared folder; no network.")
    ] = None,
    cache: Annotated[Path | None, typer.Option("--cache", metavar="FOLDER", help="Where downloads are kept.")] = None,
    append: Append = False,
) -> None:
    """Fetch a public data set into a dataset, its hashes and licence checked."""
    from candata import __version__
    from candata.plugins import load
    from candata.schema.manifest import Lineage

    source = load("candata.fetch", "SOURCE", name.replace("-", "_"))
    _refuse_standing(out, append)
    console.note(f"{source.summary}; {source.origin}; licence {source.licence}")
    if folder is not None:
        fetched = source.from_folder(folder)
    else:
        fetched = source.download(cache or _cache_folder(), console.note)
    lineage = Lineage(
        operation=f"fetch {name}",
        config_digest=fetched.digest,
        tools={"candata": __version__},
        details={"origin": source.origin, "licence": source.licence, "licence_text": fetched.notice},
    )
    _publish(out, fetched.episodes, lineage)


def _cache_folder() -> Path:
    """Return the user's cache folder for downloads (XDG base directory specification)."""
    import os

    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "candata"


def _refuse_standing(out: Path, append: bool) -> None:
    """Refuse an `--out` that stands, unless it is to be appended to."""
    from candata.errors import UsageError, Where

    if out.exists() and not append:
        raise UsageError(
            "the output exists already",
            where=Where(path=str(out)),
            fix="choose another --out, or add to it with --append",
        )


def _publish(out: Path, episodes: Iterable[Episode], lineage: Lineage) -> None:
    """Write all episodes as one version and print what was added; a failure leaves no trace.

    A new dataset is made beside `out` and renamed, so that `out` appears whole or not at all.
    """
    import tempfile

    from candata.datasets import append, create_dataset
    from candata.datasets.versions import newest

    standing = newest(out) if out.exists() else None
    if out.exists():
        version = append(out, _told(episodes), lineage)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            staged = create_dataset(Path(folder) / "dataset", name=out.resolve().name)
            version = append(staged, _told(episodes), lineage)
            staged.rename(out)
    total = _count(version)
    added = total - (_count(standing) if standing else 0)
    console.out(f"{out}: {added} episodes added, {total} in version {version.number}")


def _count(version: VersionFile) -> int:
    """Return the number of episodes in the parts of a version."""
    return sum(part.episodes for part in version.parts)


def _told(episodes: Iterable[Episode], every: int = 100) -> Iterator[Episode]:
    """Yield the episodes, with a line on stderr now and then."""
    for count, episode in enumerate(episodes, start=1):
        yield episode
        if count % every == 0:
            console.note(f"{count} episodes")
