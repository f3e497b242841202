"""Uploads of exported LeRobot sets to the Hub, with their card and the tag that LeRobot looks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from candata.datasets.writing import write_text
from candata.errors import SetupError
from candata.formats._lerobot_layout import INFO, SIDECAR
from candata.hub.address import HubAddress
from candata.hub.card import dataset_card
from candata.hub.failures import LOG_IN, hub_api, hub_failures, hub_library
from candata.schema.exchange import ExportFile
from candata.schema.json_text import read_json

#: Name of a card. Source: the Hub's documentation, "Dataset Cards".
CARD = "README.md"


def require_token() -> None:
    """Raise unless there is a token to push with.

    Raises
    ------
    MissingExtraError
        When huggingface_hub is not installed.
    SetupError
        When there is no token.
    """
    if not hub_library().get_token():
        raise SetupError("a push to the Hub needs a token, and there is none", fix=LOG_IN)


def push_set(folder: Path, address: HubAddress, licence: str, private: bool, say: Callable[[str], None]) -> str:
    """Return the commit of the Hub that now holds an exported LeRobot set; its card is written into the folder.

    The repository is made where there is none. Files that are there unchanged are not sent again, and tables of an
    earlier push that the set lacks are removed. The commit bears the set's version (`v3.0`) as its tag, by which
    LeRobot finds it.

    Parameters
    ----------
    folder : Path
        An export of `candata export lerobot`.
    address : HubAddress
        Where to.
    licence : str
        SPDX name.
    private : bool
        Whether a new repository is private.
    say : callable
        Takes a line about what is sent.

    Raises
    ------
    MissingExtraError
        When huggingface_hub is not installed.
    SetupError
        When there is no token or no network, or the token may not write there.
    UsageError
        When the owner does not exist.
    """
    require_token()
    info = read_json(folder / INFO)
    export = ExportFile.parse(read_json(folder / SIDECAR), folder / SIDECAR)
    write_text(folder / CARD, dataset_card(address, export, info, licence), "card")
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    say(f"{address}: {len(sizes)} files, {sum(sizes) / 1e6:.1f} MB")
    api, where = hub_api(), {"repo_id": address.repository, "repo_type": "dataset"}
    with hub_failures(address):
        api.create_repo(**where, private=private, exist_ok=True)
        commit = api.upload_folder(
            **where,
            folder_path=folder,
            commit_message=f"candata export of {export.dataset}@{export.digest[:12]}",
            delete_patterns=["data/*", "meta/*"],
        )
        tags = {tag.name for tag in api.list_repo_refs(**where).tags}
        if info["codebase_version"] in tags:
            api.delete_tag(**where, tag=info["codebase_version"])
        api.create_tag(**where, tag=info["codebase_version"], revision=commit.oid)
    return str(commit.oid)
