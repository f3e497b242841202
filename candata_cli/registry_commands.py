"""Commands on named datasets: add, list, info, tag, split, diff, filter, cut, merge, relabel, log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.schema.manifest import VersionFile

HELP = "Names, versions and lineage of datasets; choosing, joining and sharing them."

Data = Annotated[str, typer.Argument(metavar="DATASET", help="Name or folder; NAME@TAG, NAME@3, NAME@9f31c2.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Out = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="New dataset; appears whole or not at all.")]


def register(app: typer.Typer) -> None:
    """Add `registry` and its commands."""
    group = console.group(app, "registry", HELP)
    group.command("add", epilog="Example: candata registry add day1 recordings/day1")(add)
    group.command("remove", epilog="Example: candata registry remove day1")(remove)
    group.command("list", epilog="Example: candata registry list")(list_datasets)
    group.command("info", epilog="Example: candata registry info day1@clean")(info)
    group.command("tag", epilog="Example: candata registry tag day1 clean --version 3")(tag)
    group.command("split", epilog=_SPLIT)(split)
    group.command("diff", epilog="Example: candata registry diff day1@1 day1")(diff)
    group.command("filter", epilog=_FILTER)(filter_episodes)
    group.command("cut", epilog="Example: candata registry cut day1 --length-s 10 --out pieces")(cut_episodes)
    group.command("merge", epilog=_MERGE)(merge)
    group.command("relabel", epilog=_RELABEL)(relabel)
    group.command("log", epilog="Example: candata registry log day1")(log)


_FILTER = """\b
Examples:
  candata registry filter day1 "object = 'cup' and rows > 200"
  candata registry filter day1 "effects like '%joint_damping%'" --out damped
Columns: id source scene object task seed effects outcome rate_hz rows duration_s
joint_names actuator_names fingertip_names content_hash
"""
_MERGE = """\b
Examples:
  candata registry merge sim real --out both
  candata registry merge day2 --out both --append
"""
_SPLIT = """\b
Examples:
  candata registry split day1 held_out_cups --by object --seed 3
  candata registry split day1 --shares 0.9,0,0.1
Train by it: candata train --data day1 --split held_out_cups --out runs/first
"""
_RELABEL = """\b
Example:
  candata registry relabel day1 --set task=pick --set outcome=success --where "rows > 200" --out named
"""


def add(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Short name.")],
    path: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the dataset.")],
) -> None:
    """Give a dataset a short name, which every registry command takes in place of its folder."""
    from candata.datasets.registry import add_dataset

    console.out(f"{name}: {add_dataset(name, path).datasets[name]}")


def remove(name: Annotated[str, typer.Argument(metavar="NAME", help="Name to forget.")]) -> None:
    """Forget a name; the dataset stays where it is."""
    from candata.datasets.registry import remove_dataset

    remove_dataset(name)
    console.out(f"{name} forgotten; the dataset was not touched")


def list_datasets(json: Json = False) -> None:
    """List the named datasets: folder, newest version, episodes, digest; or what is wrong with one."""
    from candata.datasets.registry import read_registry

    rows = [_row(name, path) for name, path in read_registry().datasets.items()]
    if json:
        console.out_json({"datasets": rows})
    elif rows:
        cells = [
            (r["name"], _dash(r["version"]), _dash(r["episodes"]), _dash(r["digest"])[:12], r["state"], r["path"])
            for r in rows
        ]
        console.out_table(("name", "version", "episodes", "digest", "state", "folder"), cells)
    else:
        console.note("no names yet: candata registry add NAME FOLDER")


def _row(name: str, path: str) -> dict:
    """Return what `list` says of a name."""
    from candata.datasets import open_dataset
    from candata.errors import CandataError

    row = {"name": name, "path": path, "version": None, "episodes": None, "digest": None}
    try:
        data = open_dataset(path)
    except CandataError as error:
        return {**row, "state": error.problem}
    return {**row, "version": data.version, "episodes": len(data), "digest": data.digest, "state": "ok"}


def _dash(value: object) -> str:
    """Return the value, or a dash."""
    return "-" if value is None else str(value)


def info(dataset: Data, json: Json = False) -> None:
    """Print versions, tags, splits and lineage of a dataset."""
    from candata.datasets import history
    from candata.datasets.tags import read_tags
    from candata.datasets.versions import numbers, read_version

    data = console.open_named(dataset)
    tags = read_tags(data.path)
    versions = [
        _version(read_version(data.path, n), [t for t, v in tags.items() if v.version == n]) for n in numbers(data.path)
    ]
    splits = sorted(path.stem for path in (data.path / "splits").glob("*.json"))
    if json:
        record = {"name": data.name, "path": str(data.path), "version": data.version, "digest": data.digest}
        lineage = history.as_json(history.tree(data))
        console.out_json(
            record | {"episodes": len(data), "versions": versions, "splits": splits, "lineage": lineage["steps"]}
        )
        return
    console.out(f"{data.name}@{data.digest[:12]}  version {data.version}, {len(data)} episodes, in {data.path}")
    rows = [(v["number"], v["digest"][:12], v["parts"], v["excluded"], " ".join(v["tags"]) or "-") for v in versions]
    console.out_table(("version", "digest", "parts", "left out", "tags"), rows)
    console.out(f"splits: {', '.join(splits) or 'none stored'}")
    for line in history.lines(history.tree(data)):
        console.out(line)


def _version(version: VersionFile, tags: list[str]) -> dict:
    """Return what `info` says of a version."""
    return {
        "number": version.number,
        "digest": version.digest,
        "parent": version.parent,
        "parts": len(version.parts),
        "excluded": len(version.exclusions),
        "tags": tags,
    }


def tag(
    dataset: Data,
    name: Annotated[str, typer.Argument(metavar="TAG", help="Name of the tag.")],
    version: Annotated[str | None, typer.Option(help="Version: number or digest; by default the newest.")] = None,
    move: Annotated[bool, typer.Option("--move", help="Let a standing tag name this version.")] = False,
    delete: Annotated[bool, typer.Option("--delete", help="Take the tag away.")] = False,
) -> None:
    """Name a version, move the name, or take it away."""
    from candata.datasets.registry import resolve
    from candata.datasets.tagging import delete_tag, set_tag
    from candata.errors import UsageError

    path, named_version = resolve(dataset)
    if delete and (move or version):
        raise UsageError("--delete goes with neither --move nor --version")
    if delete:
        delete_tag(path, name)
        console.out(f"{name} taken away; the version stays")
        return
    version_tagged = set_tag(path, name, console.number(version) if version else named_version, move)
    console.out(f"{name}: version {version_tagged.version}, {version_tagged.digest[:12]}")


def split(
    dataset: Data,
    name: Annotated[
        str, typer.Argument(metavar="[SPLIT]", help="Name; `default` is taken where none is asked for.")
    ] = ("default"),
    shares: Annotated[str, typer.Option(metavar="A,B,C", help="Of train, val and test.")] = "0.8,0.1,0.1",
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 0,
    by: Annotated[str | None, typer.Option(help="Keep together what agrees in object, scene, task or source.")] = None,
    json: Json = False,
) -> None:
    """Draw train, val and test episodes and store who is where, to be pushed and pulled with the dataset."""
    from typing import cast

    from candata.datasets import open_dataset
    from candata.datasets.registry import resolve
    from candata.loaders.splits import GROUPS, SplitField, make_split, save_split, split_digest

    data = open_dataset(*resolve(dataset))
    drawn_split = make_split(data, _shares(shares, GROUPS), seed, cast(SplitField | None, by))
    path = save_split(data, drawn_split, name)
    counts = {group: len(drawn_split.ids(group)) for group in GROUPS}
    if json:
        console.out_json({"split": name, "path": str(path), "digest": split_digest(drawn_split), **counts})
        return
    counts_text = ", ".join(f"{group} {count}" for group, count in counts.items())
    console.out(f"{name}: {counts_text} of {len(data)} episodes, {split_digest(drawn_split)[:12]}")


def _shares(text: str, groups: tuple[str, ...]) -> dict[str, float]:
    """Return the share of each group."""
    from candata.errors import UsageError

    try:
        return dict(zip(groups, [float(word) for word in text.split(",")], strict=True))
    except ValueError:
        fix = "such as --shares 0.8,0.1,0.1"
        raise UsageError("cannot read the shares", expected="three numbers", found=repr(text), fix=fix) from None


def diff(
    first_name: Annotated[str, typer.Argument(metavar="A", help="Name or folder, @ and a version if not the newest.")],
    second_name: Annotated[str, typer.Argument(metavar="B", help="The same.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Believe the hashes of the manifests; read no episode.")
    ] = False,
    json: Json = False,
) -> None:
    """Compare two versions by episode id and content; exit 1 when they differ.

    Episodes of one id are read and hashed anew, but for those that lie in the same files.
    """
    from dataclasses import asdict

    from candata.datasets.diff import diff as difference
    from candata.datasets.history import label_of

    first_data, second_data = console.open_named(first_name), console.open_named(second_name)
    with console.progress("episodes compared", len(first_data.places.keys() & second_data.places.keys())) as advance:
        report = difference(first_data, second_data, quick, advance)
    if report.misstated:
        names, more_count = ", ".join(report.misstated[:5]), len(report.misstated) - 5
        console.note(
            f"not what manifests claim: {names}{f' and {more_count} more' if more_count > 0 else ''}; "
            "see candata validate"
        )
    if json:
        console.out_json(
            {"a": label_of(first_data), "b": label_of(second_data), "equal": report.is_equal, **asdict(report)}
        )
    else:
        for word, ids in (("added", report.added), ("removed", report.removed), ("changed", report.changed)):
            for name in ids:
                console.out(f"{word:8}{name}")
        counts = f"{len(report.added)} added, {len(report.removed)} removed, {len(report.changed)} changed"
        console.out(f"{counts}, {report.same} the same")
    if not report.is_equal:
        raise typer.Exit(1)


def filter_episodes(
    dataset: Data,
    where: Annotated[str, typer.Argument(metavar="EXPRESSION", help="SQL condition over the catalog.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FOLDER", help="New dataset of these episodes.")] = None,
    json: Json = False,
) -> None:
    """Print the ids of the episodes for which a condition holds, or make a dataset of them without rewriting data.

    Stored splits come along, less what is left out. What is left out of a part still lies in its files and travels
    with a push; `candata compact` drops it.
    """
    from candata.datasets.filtering import filter_dataset, matching_ids
    from candata.loaders import carry_splits

    if out is not None:
        check_output(out, "new")
    data = console.open_named(dataset)
    if out is not None:
        _print_made(out, filter_dataset(data, where, out, carry_splits([data], console.note)), json)
        return
    ids = matching_ids(data, where)
    if json:
        console.out_json({"dataset": data.name, "digest": data.digest, "where": where, "of": len(data), "ids": ids})
        return
    for name in ids:
        console.out(name)
    console.note(f"{len(ids)} of {len(data)} episodes")


@console.stoppable()
def cut_episodes(
    dataset: Data,
    out: Out,
    length_s: Annotated[float, typer.Option("--length-s", min=0, help="Length of a piece [s].")],
    json: Json = False,
) -> None:
    """Make a dataset of pieces of long episodes: a diagnosis then takes no longer than of short ones.

    A piece is a motion of its own: its number ends its id and its task. The rest of an episode that is shorter than a
    piece is left out.
    """
    from candata.datasets.cutting import cut

    check_output(out, "new")
    data = console.open_named(dataset)
    with console.stoppable(lambda: console.written_clause(out)):
        made = cut(data, length_s, out)
    _print_made(out, made, json)


@console.stoppable()
def merge(
    datasets: Annotated[list[str], typer.Argument(metavar="DATASET...", help="Names or folders.")],
    out: Out,
    append: Annotated[bool, typer.Option("--append", help="Add to the dataset that stands there.")] = False,
    prefix: Annotated[bool, typer.Option("--prefix", help="NAME- before each id; writes every episode anew.")] = False,
    json: Json = False,
) -> None:
    """Make one dataset of several; equal episodes count once, one id for two contents is refused.

    Episodes of one id are read and compared. The others are taken as their manifests claim: candata validate --deep.
    A split is carried where all of them store one of its name that holds all their episodes. With --append the splits
    that stand there stay as they are.
    """
    from candata.datasets.merging import merge as join
    from candata.datasets.merging import merge_into
    from candata.errors import UsageError
    from candata.loaders import carry_splits

    if append and prefix:
        raise UsageError("--prefix does not go with --append", fix="merge with --prefix to a new folder first")
    check_output(out, "dataset" if append else "new", fix="choose another --out, or add to it with --append")
    with console.stoppable(lambda: f"{out} is as it was" if append else console.written_clause(out)):
        data = [console.open_named(text) for text in datasets]
        merged_version = (
            merge_into(data, out) if append else join(data, out, prefix, carry_splits(data, console.note, prefix))
        )
    _print_made(out, merged_version, json)
    if append:
        _tell_uncovered(out)


def _tell_uncovered(out: Path) -> None:
    """Tell which splits do not hold the episodes that were added: a split never changes."""
    from candata.datasets import open_dataset
    from candata.loaders import load_split, split_names

    data = open_dataset(out)
    for name in split_names(data):
        split = load_split(data, name)
        outside_count = len(set(data.ids).difference(split.train, split.val, split.test))
        if outside_count:
            console.note(
                f"the split {name} stays as it was drawn: {outside_count} of {len(data)} episodes are in none of it"
            )


def relabel(
    dataset: Data,
    out: Out,
    setting: Annotated[list[str], typer.Option("--set", metavar="LABEL=VALUE", help="object, task, outcome, scene.")],
    where: Annotated[str | None, typer.Option("--where", metavar="EXPRESSION", help="As for filter.")] = None,
    json: Json = False,
) -> None:
    """Make a dataset in which some episodes bear other labels; LABEL= takes one away. Stored splits come along."""
    from candata.datasets.relabelling import relabel as write
    from candata.errors import UsageError
    from candata.loaders import carry_splits

    labels: dict[str, str | None] = {}
    for text in setting:
        name, equals, value = text.partition("=")
        if not equals:
            raise UsageError("--set takes LABEL=VALUE", found=text)
        labels[name] = value or None
    check_output(out, "new")
    data = console.open_named(dataset)
    with console.stoppable(lambda: console.written_clause(out)):
        relabelled_version = write(data, labels, where, out, carry_splits([data], console.note))
    _print_made(out, relabelled_version, json)


def _print_made(out: Path, version: VersionFile, json: bool) -> None:
    """Print what was made."""
    from candata.datasets import open_dataset

    count = len(open_dataset(out, version.number))
    if json:
        console.out_json({"path": str(out), "version": version.number, "digest": version.digest, "episodes": count})
    else:
        console.out(f"{out}: {count} episodes in version {version.number}, {version.digest[:12]}")


def log(dataset: Data, json: Json = False) -> None:
    """Print where a version comes from, as a tree: recorded, generated, imported, filtered, merged, relabelled."""
    from candata.datasets import history

    origin = history.tree(console.open_named(dataset))
    if json:
        console.out_json(history.as_json(origin))
        return
    for line in history.lines(origin):
        console.out(line)
