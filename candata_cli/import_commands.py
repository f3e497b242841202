"""Commands that bring data in: `import` from files and logs, `fetch` from public places."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli import import_options as options
from candata_cli.hub_source import hub_source, source_details
from candata_cli.import_publishing import publish_import
from candata_cli.object_commands import write_objects
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from candata.record.import_recipe import ImportRecipe
    from candata.record.import_session import ImportedSession
    from candata.schema.episode import Episode
    from candata.schema.manifest import Lineage

Out = Annotated[Path, typer.Option("--out", metavar="DATASET", help="Dataset to write.")]
Append = Annotated[bool, typer.Option("--append", help="Add to a dataset that stands.")]
LOG, TABLE = "log", "table"
#: What a foreign file may not say of its episodes.
_LABELS = ("scene", "object", "task")
#: Options of `import log` that are not called as the recipe calls them.
_OPTIONS = {
    "rate_hz": "--rate",
    "newton_per_count": "--newton-per-count",
    "threshold_n": "--threshold",
    "release_n": "--release",
    "max_gap_periods": "--max-gap",
    "labels": "--label",
}
_EXAMPLES = """\b
Examples:
  candata import table map.yaml --out recordings
  candata import lerobot downloads/my_set --out recordings
  candata import lerobot hf:lerobot/svla_so101_pickplace@v3.0 --out recordings
  candata import mcap flight_bag --map topics.yaml --out recordings
  candata import log run.mcap --with table/map.yaml --scene xhand_tabletop --out recordings
"""


def register(app: typer.Typer) -> None:
    """Add `import` and `fetch`."""
    app.command("import", epilog=_EXAMPLES)(import_)
    app.command("fetch", epilog="Example: candata fetch cube-tosses --out tosses")(fetch)


@console.stoppable()
def import_(
    format_name: options.FormatName,
    sources: options.Sources,
    out: Out,
    append: Append = False,
    replace: options.Replace = False,
    allow_gaps: options.AllowGaps = False,
    mapping: options.MapFile = None,
    origin: options.Origin = None,
    companions: options.Companions = None,
    scene: options.SceneName = None,
    rate_hz: options.RateHz = None,
    newton_per_count: options.NewtonPerCount = None,
    threshold_n: options.Threshold = None,
    release_n: options.Release = None,
    max_gap: options.MaxGap = None,
    align: options.Align = None,
    allow_uncalibrated: options.AllowUncalibrated = False,
    object_name: options.ObjectName = None,
    task: options.TaskName = None,
    episode: options.EpisodeId = None,
    outcome: options.Outcome = None,
    label: options.Labels = None,
) -> None:
    """Import recordings into a dataset: all of a source or nothing; the same source twice adds nothing."""
    from candata.errors import UsageError

    settings = {
        "rate_hz": rate_hz,
        "newton_per_count": newton_per_count,
        "threshold_n": threshold_n,
        "release_n": release_n,
        "max_gap_periods": max_gap,
        "align": align,
        "uncalibrated": allow_uncalibrated or None,
        "scene": scene,
        "object": object_name,
        "task": task,
        "episode": episode,
        "outcome": outcome,
        "labels": _labels(label) if label else None,
    }
    stated_settings = {name: value for name, value in settings.items() if value is not None}
    if format_name == LOG:
        refused_options: dict[str, object] = {"--allow-gaps": allow_gaps, "--map": mapping, "--source": origin}
        _refuse_options(refused_options, "`import log` takes no")
        if replace and not append:
            raise UsageError("--replace changes a dataset that stands", fix="give --append as well")
        _import_logs(sources, companions or [], stated_settings, out, append, replace)
        return
    labels = {name: stated_settings.pop(name) for name in _LABELS if name in stated_settings}
    only_log = {_OPTIONS.get(name, f"--{name}"): True for name in stated_settings}
    _refuse_options(only_log | {"--with": companions, "--replace": replace}, "only `import log` takes")
    if format_name == TABLE:
        refused_options = {"--map": mapping, "--source": origin} | {f"--{name}": True for name in labels}
        _refuse_options(refused_options, "`import table` reads it from its map and takes no")
    reading = {"allow_gaps": allow_gaps, "mapping": mapping, **labels} | ({"source": origin} if origin else {})
    _import_format(format_name, sources, out, append, reading)


def _labels(pairs: list[str]) -> dict[str, int | float | str]:
    """Return labels from `NAME=VALUE`: a finite number where its text is how that number is written, else text."""
    from math import isfinite

    from candata.errors import UsageError

    labels: dict[str, int | float | str] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not (name and equals and text) or name in labels:
            raise UsageError("--label is no new name with its value", expected="NAME=VALUE, each name once", found=pair)
        labels[name] = text
        for number in (int, float):
            with suppress(ValueError):
                if isfinite(number(text)) and str(number(text)) == text:
                    labels[name] = number(text)
                    break
    return labels


def _refuse_options(options: Mapping[str, object], problem: str) -> None:
    """Refuse options of another kind of source."""
    from candata.errors import UsageError

    for name, value in options.items():
        if value:
            raise UsageError(f"{problem} {name}", fix="leave it out")


def _import_format(format_name: str, sources: list[Path], out: Path, append: bool, options: dict) -> None:
    """Import one source of a format of the folder."""
    import hashlib
    import itertools

    from candata import __version__
    from candata.datasets.encode import content_hash
    from candata.errors import UnknownNameError, UsageError
    from candata.formats import FORMATS, Reading
    from candata.schema.manifest import Lineage

    if format_name not in FORMATS:
        raise UnknownNameError("format", format_name, [*FORMATS.names(), LOG])
    if options.get("source", "real") not in ("sim", "real"):
        raise UsageError("--source is neither sim nor real", found=options["source"])
    if len(sources) > 1:
        raise UsageError(
            f"`import {format_name}` takes one source",
            found=", ".join(str(source) for source in sources),
            fix="import them one after the other, with --append",
        )
    (source,) = sources
    reader = FORMATS.load(format_name)
    read = reader.read
    if read is None:
        raise UsageError(f"{format_name} can be exported, not imported")
    if options["mapping"] is not None and not reader.takes_map:
        raise UsageError(f"`import {format_name}` takes no --map", fix="leave it out")
    _refuse_standing(out, append)
    hub_set = hub_source(format_name, str(source))
    folder = source if hub_set is None else hub_set.folder
    clouds: list[NDArray] = []
    reading = Reading(**options, note=console.note, cloud=clouds.append)
    operation, hashes = f"import {format_name}", []

    def episodes() -> Iterator[Episode]:
        for episode in read(folder, reading):
            hashes.append(content_hash(episode))
            yield episode

    def lineage() -> Lineage:
        return Lineage(
            operation=operation,
            config_digest=hashlib.sha256("\n".join(hashes).encode()).hexdigest(),
            tools={"candata": __version__},
            revision=None if hub_set is None else hub_set.commit,
            details=source_details(source, hub_set) | {"allow_gaps": reading.allow_gaps} | _map_text(reading.mapping),
        )

    # One is read before anything is made: a source that is refused leaves not even the folder around the dataset.
    episode_stream = episodes()
    checked_stream = itertools.chain(list(itertools.islice(episode_stream, 1)), episode_stream)
    publish_import(out, append, checked_stream, operation, lineage, clouds=clouds)


def _map_text(mapping: Path | None) -> dict[str, str]:
    """Return the text of a map that was read, as the lineage keeps it."""
    return {} if mapping is None else {"map": mapping.read_text(encoding="utf-8")}


def _import_logs(
    logs: list[Path], companions: list[Path], settings: dict, out: Path, append: bool, replace: bool
) -> None:
    """Import recorded logs one after the other: one episode each, or those that were marked."""
    import hashlib

    from candata import __version__
    from candata.errors import UnknownNameError, UsageError
    from candata.schema.manifest import Lineage
    from candata.schema.outcome import OUTCOMES

    if settings.get("outcome", OUTCOMES[0]) not in OUTCOMES:
        raise UnknownNameError("outcome", settings["outcome"], OUTCOMES)
    if "episode" in settings and len(logs) > 1:
        raise UsageError("--episode names one episode", found=f"{len(logs)} logs", fix="import them one by one")
    _refuse_standing(out, append)
    recipe, scene_clouds = _recipe(settings)
    clouds: list[NDArray] = []
    log_records: list[tuple[str, dict]] = []

    def lineage() -> Lineage:
        digests = [digest for digest, _ in log_records]
        joint_digest = hashlib.sha256("\n".join(digests).encode()).hexdigest()
        return Lineage(
            operation="import log",
            config_digest=digests[0] if len(digests) == 1 else joint_digest,
            tools={"candata": __version__},
            details={"logs": [details for _, details in log_records]},
        )

    def episodes() -> Iterator[Episode]:
        for digest, session in _read_logs(logs, companions, recipe):
            log_records.append((digest, session.details))
            if any(episode.meta.point_cloud for episode in session.episodes):
                clouds[:] = scene_clouds
            yield from session.episodes

    publish_import(out, append, episodes(), "import log", lineage, part_size=1, clouds=clouds, replaces=replace)


def _read_logs(logs: list[Path], companions: list[Path], recipe: ImportRecipe) -> Iterator[tuple[str, ImportedSession]]:
    """Yield the digest of each log with its recipe, and its episodes; only one log is held."""
    from candata.record.companions import read_companion
    from candata.record.import_session import cut_episodes
    from candata.record.importing import import_log
    from candata.record.logs import read_log
    from candata.record.session_run import log_of

    companion_files = [read_companion(path) for path in companions]
    for path in map(log_of, logs):
        log = read_log(path)
        log_recipe = recipe if recipe.episode else recipe.model_copy(update={"episode": log.meta.session or path.stem})
        imported_log = import_log(path, log, log_recipe, companion_files)
        session = cut_episodes(imported_log, log)
        for line in session.notes:
            console.note(line)
        yield imported_log.digest, session


def _recipe(settings: dict) -> tuple[ImportRecipe, list[NDArray]]:
    """Return the recipe of an import and the cloud of its scene's object; it bears the file's name, not its path."""
    from candata.datasets.clouds import cloud_hash
    from candata.record.import_recipe import ImportRecipe

    clouds: list[NDArray] = []
    if "scene" in settings:
        from candata.scenes import load_scene
        from candata.scenes.clouds import surface_cloud

        scene = load_scene(settings["scene"])
        settings = {**settings, "scene": Path(scene.name).name, "roles": scene.file}
        if scene.object_id is not None:
            clouds = [surface_cloud(scene)]
            settings["point_cloud"] = cloud_hash(clouds[0])
    return ImportRecipe.parse({"episode": "", **settings}, "options"), clouds


@console.stoppable()
def fetch(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Public data set, such as `cube-tosses`.")],
    out: Out,
    folder: Annotated[
        Path | None, typer.Option("--from", metavar="FOLDER", help="Read a prepared folder; no network.")
    ] = None,
    cache: Annotated[Path | None, typer.Option("--cache", metavar="FOLDER", help="Where downloads are kept.")] = None,
    append: Append = False,
) -> None:
    """Fetch a public data set into a dataset, or public objects into a folder; hashes and licence are checked."""
    from candata import __version__
    from candata.fetch import SOURCES, FetchedObjects
    from candata.schema.manifest import Lineage
    from candata.user_folders import user_cache

    source, downloads = SOURCES.load(name.replace("-", "_")), cache or user_cache()
    _refuse_standing(out, append)
    if folder is None:
        check_output(downloads, "folder", "--cache")
    console.note(f"{source.summary}; {source.origin}; licence {source.licence}")
    with console.stoppable(f"files that were fetched whole are kept in {downloads}", goes_on=True):
        public_data = source.from_folder(folder) if folder is not None else source.download(downloads, console.note)
    if isinstance(public_data, FetchedObjects):
        write_objects(out, append, source, public_data)
        return
    lineage = Lineage(
        operation=f"fetch {name}",
        config_digest=public_data.digest,
        tools={"candata": __version__},
        details={"origin": source.origin, "licence": source.licence, "licence_text": public_data.notice},
    )
    publish_import(out, append, public_data.episodes, lineage.operation, lambda: lineage)


def _refuse_standing(out: Path, append: bool) -> None:
    """Refuse an `--out` that cannot be written, or that stands unless it is to be appended to."""
    from candata.datasets.versions import read_dataset_file

    check_output(out, "dataset" if append else "new", fix="choose another --out, or add to it with --append")
    if out.exists():
        read_dataset_file(out)
