"""Commands that bring data in: `import` from files and logs, `fetch` from public places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.record.importing import Imported, Recipe
    from candata.schema.episode import Episode
    from candata.schema.manifest import Lineage, VersionFile

Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="Dataset to write.")]
Append = Annotated[bool, typer.Option("--append", help="Add to a dataset that stands.")]
LOG = "log"
#: Options of `import log` that are not called as the recipe calls them.
_OPTIONS = {
    "rate_hz": "--rate",
    "newton_per_count": "--newton-per-count",
    "threshold_n": "--threshold",
    "max_gap_periods": "--max-gap",
}
_EXAMPLES = """\b
Examples:
  candata import table map.yaml --out recordings
  candata import log run.mcap --with table/map.yaml --scene xhand_tabletop --out recordings
"""


def register(app: typer.Typer) -> None:
    """Add `import` and `fetch`."""
    app.command("import", epilog=_EXAMPLES)(import_)
    app.command("fetch")(fetch)


def import_(
    format_name: Annotated[str, typer.Argument(metavar="FORMAT", help="Kind of source: `table` or `log`.")],
    sources: Annotated[
        list[Path], typer.Argument(metavar="SOURCE...", help="For `table`: a map.yaml; for `log`: recorded logs.")
    ],
    out: Out,
    append: Append = False,
    allow_gaps: Annotated[
        bool, typer.Option("--allow-gaps", help="table: mark values that are not finite as invalid.")
    ] = False,
    companions: Annotated[
        list[Path] | None,
        typer.Option(
            "--with", metavar="FILE", help="log: map.yaml, table or MCAP with poses, joints, commands; repeat."
        ),
    ] = None,
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="log: rate and order of joints; a name or scene.yaml.")
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="log: rate without --scene [the device's].")
    ] = None,
    newton_per_count: Annotated[
        float | None, typer.Option(metavar="N", help="log: scale of the forces [the log's].")
    ] = None,
    threshold_n: Annotated[
        float | None, typer.Option("--threshold", metavar="N", help="log: contact above |Fx|+|Fy|+|Fz| [0.3].")
    ] = None,
    max_gap: Annotated[
        float | None, typer.Option(metavar="PERIODS", help="log: readings further apart end a gap [1.5].")
    ] = None,
    uncalibrated: Annotated[
        bool, typer.Option("--uncalibrated", help="log: take one without calibration; forces keep their offset.")
    ] = False,
    object_name: Annotated[str | None, typer.Option("--object", metavar="NAME", help="log: the object.")] = None,
    task: Annotated[str | None, typer.Option(metavar="NAME", help="log: what is done.")] = None,
    episode: Annotated[str | None, typer.Option(metavar="ID", help="log: id of the episode [the file's name].")] = None,
) -> None:
    """Import recordings into a dataset: all of a source or nothing; the same source twice adds nothing."""
    settings = {
        "rate_hz": rate_hz,
        "newton_per_count": newton_per_count,
        "threshold_n": threshold_n,
        "max_gap_periods": max_gap,
        "uncalibrated": uncalibrated or None,
        "scene": scene,
        "object": object_name,
        "task": task,
        "episode": episode,
    }
    stated = {name: value for name, value in settings.items() if value is not None}
    only_log = {_OPTIONS.get(name, f"--{name}"): True for name in stated} | {"--with": companions}
    if format_name == LOG:
        _refuse_options({"--allow-gaps": allow_gaps}, "table")
        _import_logs(sources, companions or [], stated, out, append)
    else:
        _refuse_options(only_log, LOG)
        _import_format(format_name, sources, out, append, allow_gaps)


def _refuse_options(given: Mapping[str, object], belongs_to: str) -> None:
    """Refuse options of another kind of source."""
    from candata.errors import UsageError

    for name, value in given.items():
        if value:
            raise UsageError(f"{name} is for `import {belongs_to}` only", fix="leave it out")


def _import_format(format_name: str, sources: list[Path], out: Path, append: bool, allow_gaps: bool) -> None:
    """Import one source of a format of the folder."""
    from candata import __version__
    from candata.errors import UnknownNameError, UsageError
    from candata.plugins import load, names
    from candata.schema.manifest import Lineage

    if format_name not in names("candata.formats"):
        raise UnknownNameError("format", format_name, [*names("candata.formats"), LOG])
    if len(sources) > 1:
        raise UsageError(
            f"`import {format_name}` takes one source",
            found=", ".join(str(source) for source in sources),
            fix="import them one after the other, with --append",
        )
    (source,) = sources
    reader = load("candata.formats", "FORMAT", format_name)
    _refuse_standing(out, append)
    lineage = Lineage(
        operation=f"import {format_name}",
        config_digest=reader.digest(source),
        tools={"candata": __version__},
        details={"source": source.name, "allow_gaps": allow_gaps},
    )
    _publish(out, reader.read(source, allow_gaps), lineage.operation, lambda: lineage)


def _import_logs(logs: list[Path], companions: list[Path], settings: dict, out: Path, append: bool) -> None:
    """Import recorded logs, one episode each, one after the other."""
    import hashlib

    from candata import __version__
    from candata.errors import UsageError
    from candata.schema.manifest import Lineage

    if "episode" in settings and len(logs) > 1:
        raise UsageError("--episode names one episode", found=f"{len(logs)} logs", fix="import them one by one")
    _refuse_standing(out, append)
    recipe = _recipe(settings)
    made: list[tuple[str, dict]] = []

    def lineage() -> Lineage:
        digests = [digest for digest, _ in made]
        together = hashlib.sha256("\n".join(digests).encode()).hexdigest()
        return Lineage(
            operation="import log",
            config_digest=digests[0] if len(digests) == 1 else together,
            tools={"candata": __version__},
            details={"logs": [details for _, details in made]},
        )

    def episodes() -> Iterator[Episode]:
        for imported in _read_logs(logs, companions, recipe):
            made.append((imported.digest, imported.details))
            yield imported.episode

    _publish(out, episodes(), "import log", lineage, part_size=1)


def _read_logs(logs: list[Path], companions: list[Path], recipe: Recipe) -> Iterator[Imported]:
    """Yield what each log becomes; only one is held."""
    from candata.record.companions import read_companion
    from candata.record.importing import import_log
    from candata.record.logs import read_log

    beside = [read_companion(path) for path in companions]
    for path in logs:
        own = recipe if recipe.episode else recipe.model_copy(update={"episode": path.stem})
        imported = import_log(path, read_log(path), own, beside)
        for line in imported.notes:
            console.note(line)
        yield imported


def _recipe(settings: dict) -> Recipe:
    """Return the recipe of an import, the scene's file read; it bears the file's name, not its path."""
    from candata.record.importing import Recipe

    if "scene" in settings:
        from candata.scenes import load_scene

        found = load_scene(settings["scene"])
        settings = {**settings, "scene": Path(found.name).name, "roles": found.file}
    return Recipe.parse({"episode": "", **settings}, "options")


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
    from candata.datasets.durable import user_cache
    from candata.plugins import load
    from candata.schema.manifest import Lineage

    source = load("candata.fetch", "SOURCE", name.replace("-", "_"))
    _refuse_standing(out, append)
    console.note(f"{source.summary}; {source.origin}; licence {source.licence}")
    fetched = source.from_folder(folder) if folder is not None else source.download(cache or user_cache(), console.note)
    lineage = Lineage(
        operation=f"fetch {name}",
        config_digest=fetched.digest,
        tools={"candata": __version__},
        details={"origin": source.origin, "licence": source.licence, "licence_text": fetched.notice},
    )
    _publish(out, fetched.episodes, lineage.operation, lambda: lineage)


def _refuse_standing(out: Path, append: bool) -> None:
    """Refuse an `--out` that stands, unless it is to be appended to."""
    from candata.errors import UsageError, Where

    if out.exists() and not append:
        raise UsageError(
            "the output exists already",
            where=Where(path=str(out)),
            fix="choose another --out, or add to it with --append",
        )


def _publish(
    out: Path, episodes: Iterable[Episode], operation: str, lineage: Callable[[], Lineage], part_size: int = 16
) -> None:
    """Write all episodes as one version and print what was added; a failure leaves no trace.

    A new dataset is made beside `out` and renamed, so that `out` appears whole or not at all. `lineage` is asked
    once all episodes were read.
    """
    import tempfile

    from candata.datasets import create_dataset, publish, write_parts
    from candata.datasets.versions import newest

    def add(root: Path) -> VersionFile:
        return publish(root, write_parts(root, _told(episodes), operation, part_size), lineage())

    standing = newest(out) if out.exists() else None
    if out.exists():
        version = add(out)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            staged = create_dataset(Path(folder) / "dataset", name=out.resolve().name)
            version = add(staged)
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
