"""Commands that share datasets: push, pull, remotes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output
from candata_cli.registry_commands import HELP, Json

if TYPE_CHECKING:
    from collections.abc import Callable

    from candata.schema.registry import RemoteEntry

Remote = Annotated[str, typer.Argument(metavar="REMOTE", help="Name of a remote: candata registry remotes list.")]

_ADD = """\b
Examples:
  candata registry remotes add lab /mnt/share/candata
  candata registry remotes add cloud s3://bucket/candata --region eu-central-1
  candata registry remotes add own s3://bucket --endpoint http://minio:9000 --allow-http
Credentials are read from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY and never kept.
"""
_LIST = """\b
Examples:
  candata registry remotes list
  candata registry remotes list lab
"""


def register(app: typer.Typer) -> None:
    """Add the commands to `registry`."""
    group = console.group(app, "registry", HELP)
    group.command("push", epilog="Example: candata registry push day1 lab")(push)
    group.command("pull", epilog="Example: candata registry pull lab day1@clean --out day1")(pull)
    remotes = console.group(group, "remotes", "Where datasets are pushed to: a shared folder or S3.")
    remotes.command("add", epilog=_ADD)(add)
    remotes.command("list", epilog=_LIST)(list_remotes)
    remotes.command("remove", epilog="Example: candata registry remotes remove lab")(remove)


@console.stoppable("nothing was sent")
def push(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Name or folder; all its versions are sent.")],
    remote: Remote,
    name: Annotated[str | None, typer.Option(help="What it is called there; by default as it is named.")] = None,
    move_tags: Annotated[bool, typer.Option("--move-tags", help="Let tags of the remote name other versions.")] = False,
    json: Json = False,
) -> None:
    """Send what a remote lacks of a dataset: all versions, splits and tags. A killed push goes on when run again."""
    from candata.datasets.push import push as send
    from candata.datasets.registry import find_remote, resolve
    from candata.datasets.remotes import open_remote
    from candata.datasets.versions import read_dataset_file
    from candata.errors import UsageError

    path, version = resolve(dataset)
    if version is not None:
        raise UsageError("push sends all versions", found=dataset, fix="leave out what follows the @")
    remote_name = name or read_dataset_file(path).name
    store = open_remote(find_remote(remote))
    with console.stoppable(f"what was sent whole is kept on {remote}, where nobody sees it yet", goes_on=True):
        report = send(path, store, remote_name, _bar("sending"), move_tags)
    if report.newest.exclusions:
        left_out = len(report.newest.exclusions)
        console.note(f"{left_out} episodes that the version leaves out travelled along in its parts")
    if json:
        console.out_json(
            {
                "name": remote_name,
                "remote": remote,
                "versions": report.versions,
                "splits": report.splits,
                "tags": report.tags,
                "objects": report.objects,
                "bytes": report.bytes,
                "standing": report.standing,
                "digest": report.newest.digest,
            }
        )
        return
    version_text = ", ".join(map(str, report.versions)) or "none"
    sent_text = f"{report.objects} files sent ({report.bytes / 1e6:.1f} MB), {report.standing} there already"
    console.out(f"{remote_name}@{report.newest.digest[:12]} on {remote}: new versions {version_text}; {sent_text}")


@console.stoppable()
def pull(
    remote: Remote,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Dataset there; NAME@TAG, NAME@3, NAME@9f31c2.")],
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="New folder, or one pulled to before.")],
    json: Json = False,
) -> None:
    """Fetch a version of a dataset; every file and episode is hashed anew, and no claim of the remote is believed.

    What does not fit is refused before anything is written. A killed pull goes on when run again.
    """
    from candata.datasets.pull import pull as fetch
    from candata.datasets.registry import find_remote
    from candata.datasets.remotes import open_remote

    check_output(out, "dataset")
    remote_name, _, version = name.partition("@")
    with console.stoppable(f"what was fetched whole is kept in {out}", goes_on=True):
        store = open_remote(find_remote(remote))
        report = fetch(store, remote_name, out, console.number(version or None), _bar("fetching"), _bar("checking"))
    for line in report.notes:
        console.note(line)
    if json:
        console.out_json(
            {
                "path": str(report.path),
                "version": report.version,
                "digest": report.digest,
                "episodes": report.episodes,
                "objects": report.objects,
                "bytes": report.bytes,
                "standing": report.standing,
                "splits": report.splits,
                "tags": report.tags,
            }
        )
        return
    fetched_text = f"{report.objects} files fetched ({report.bytes / 1e6:.1f} MB), {report.standing} there already"
    console.out(
        f"{report.path}: {report.episodes} episodes in version {report.version}, {report.digest[:12]}; {fetched_text}"
    )


def _bar(label: str) -> Callable[[int], AbstractContextManager[Callable[[int], None]]]:
    """Return what shows the progress in bytes."""
    return lambda total: console.transfer(label, total)


def add(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Short name.")],
    url: Annotated[str, typer.Argument(metavar="URL", help="Folder, file:///folder or s3://bucket/prefix.")],
    endpoint: Annotated[str | None, typer.Option(metavar="URL", help="S3 store of one's own: http(s)://host.")] = None,
    region: Annotated[str | None, typer.Option(help="Region of the bucket.")] = None,
    path_style: Annotated[
        bool | None,
        typer.Option("--path-style/--virtual-host", help="Bucket in the path (usual with --endpoint) or host."),
    ] = None,
    allow_http: Annotated[bool, typer.Option("--allow-http", help="Plain http, in a network you trust.")] = False,
    anonymous: Annotated[bool, typer.Option("--anonymous", help="Read a public bucket without credentials.")] = False,
) -> None:
    """Name a remote."""
    from candata.datasets.registry import add_remote
    from candata.datasets.remotes import check_remote
    from candata.schema.registry import RemoteEntry

    local = "://" not in url
    entry = RemoteEntry(
        url=str(Path(url).resolve()) if local and url else url,
        endpoint=endpoint,
        region=region,
        path_style=endpoint is not None if path_style is None else path_style,
        allow_http=allow_http,
        anonymous=anonymous,
    )
    add_remote(name, check_remote(entry))
    console.out(f"{name}: {entry.url}")
    if local and not Path(entry.url).is_dir():
        console.note("this folder is not there yet: make it, or mount the share, before a push")


def list_remotes(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="List the datasets of this remote.")] = None,
    json: Json = False,
) -> None:
    """List the remotes, or the datasets that one of them holds."""
    from candata.datasets.registry import find_remote, read_registry
    from candata.datasets.remotes import open_remote, remote_numbers

    if name is not None:
        store = open_remote(find_remote(name))
        rows = [(folder, versions[-1]) for folder in store.folders() if (versions := remote_numbers(store, folder))]
        if json:
            console.out_json({"remote": name, "datasets": [{"name": n, "version": v} for n, v in rows]})
        else:
            console.out_table(("dataset", "newest version"), rows)
        return
    remotes = read_registry().remotes
    if json:
        console.out_json({"remotes": {key: entry.model_dump(mode="json") for key, entry in remotes.items()}})
    elif remotes:
        console.out_table(
            ("name", "where", "how"), [(key, entry.url, _access_words(entry)) for key, entry in remotes.items()]
        )
    else:
        console.note("no remotes yet: candata registry remotes add NAME URL")


def _access_words(entry: RemoteEntry) -> str:
    """Return how a remote is reached, in words."""
    if not entry.url.startswith("s3://"):
        return "folder"
    words = [entry.endpoint or "AWS", entry.region, "path-style" if entry.path_style else None]
    words += ["plain http" if entry.allow_http else None, "anonymous" if entry.anonymous else None]
    return ", ".join(word for word in words if word)


def remove(name: Annotated[str, typer.Argument(metavar="NAME", help="Remote to forget.")]) -> None:
    """Forget a remote; what it holds stays."""
    from candata.datasets.registry import remove_remote

    remove_remote(name)
    console.out(f"{name} forgotten; what it holds was not touched")
