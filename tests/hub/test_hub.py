"""Sets from and to a stand-in Hub: what is asked for, what is kept, and one clear refusal each."""

from __future__ import annotations

import json

import pyarrow.parquet as pq
import pytest
import yaml

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.hub import parse_address, stated_licences
from candata.schema.manifest import Lineage
from tests.cli.command import run
from tests.hub.conftest import content
from tests.hub.stand_in import TOKEN

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # huggingface_hub keeps its connections


def imported(address, out, *options):
    return run("import", "lerobot", address, "--out", out, *options)


def test_an_import_takes_the_tables_alone_and_keeps_the_revision(hub, published, tmp_path):
    repository = published("acme/cups", "ab", licence="cc-by-4.0")
    done = imported("hf:acme/cups", tmp_path / "in")
    assert done.code == 0, done.err
    assert "1 other files" not in done.err
    assert "2 other files are left out" in done.err, "the video and the card"
    names = {name for name, _, _ in hub.asked}
    assert "data/chunk-000/file-000.parquet" in names
    assert not any(name.startswith("videos") for name in names)
    assert content(tmp_path / "in").keys() == {"a", "b"}
    (lineage,) = open_dataset(tmp_path / "in").lineage
    assert lineage.revision == repository.refs["main"]
    assert (lineage.details["source"], lineage.details["licence"]) == ("hf:acme/cups", "cc-by-4.0")
    asked = len(hub.asked)
    again = imported("hf:acme/cups", tmp_path / "in", "--append")
    assert "0 episodes added" in again.out
    assert len(hub.asked) == asked, "what is there is not fetched again"


def test_a_revision_is_taken_as_it_was(hub, published, tmp_path):
    repository = published("acme/cups", "ab")
    repository.tags["v3.0"] = repository.refs["main"]
    published("acme/cups", "abc")
    assert imported("hf:acme/cups@v3.0", tmp_path / "old").code == 0
    assert imported("hf:acme/cups", tmp_path / "new").code == 0
    assert content(tmp_path / "old").keys() == {"a", "b"}
    assert content(tmp_path / "new").keys() == {"a", "b", "c"}


def test_a_set_without_a_sidecar_is_called_by_its_name(hub, published, tmp_path):
    repository = published("acme/cups", "ab")
    files = repository.commits[repository.refs["main"]]
    repository.commit({name: data for name, data in files.items() if name != "meta/candata.json"})
    assert imported("hf:acme/cups", tmp_path / "in").code == 0
    assert content(tmp_path / "in").keys() == {"cups-0", "cups-1"}


def test_a_download_that_broke_off_goes_on_with_what_is_missing(hub, published, tmp_path, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    published("acme/cups", "ab")
    hub.broken = {"data/chunk-000/file-000.parquet"}
    done = imported("hf:acme/cups", tmp_path / "in")
    assert done.code == 3
    assert "the Hub cannot be reached" in done.err
    assert not (tmp_path / "in").exists()
    hub.broken, broken_at = set(), len(hub.asked)
    assert imported("hf:acme/cups", tmp_path / "in").code == 0
    assert {name for name, _, _ in hub.asked[broken_at:]} == {"data/chunk-000/file-000.parquet"}


@pytest.mark.parametrize(
    ("fields", "token", "address", "code", "says"),
    [
        ({}, None, "hf:acme/cup", 2, ("no data set acme/cup to those who are not logged in", "HF_TOKEN")),
        ({}, TOKEN, "hf:acme/cup", 2, ("no data set acme/cup to the owner of this token", "check its name")),
        ({"private": True}, None, "hf:acme/cups", 2, ("not logged in", "if it is private, log in")),
        ({"private": True}, TOKEN, "hf:acme/cups", 0, ()),
        ({"gated": True}, None, "hf:acme/cups", 3, ("acme/cups is gated", "accept its terms")),
        ({}, None, "hf:acme/cups@v9", 2, ("acme/cups has no revision v9",)),
        ({}, None, "hf:acme", 2, ("this is no address on the Hub", "hf:ORG/NAME")),
        ({}, None, "hf:acme/../cups", 2, ("this is no address on the Hub",)),
    ],
)
def test_each_refusal_is_one_error(hub, published, tmp_path, monkeypatch, fields, token, address, code, says):
    published("acme/cups", "ab", **fields)
    if token:
        monkeypatch.setenv("HF_TOKEN", token)
    done = imported(address, tmp_path / "in")
    assert done.code == code, done.err
    assert "Traceback" not in done.err
    assert all(text in done.err for text in says), done.err
    assert (tmp_path / "in").exists() == (code == 0)


def test_no_network_is_one_error(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    done = imported("hf:acme/cups", tmp_path / "in")
    assert done.code == 3
    assert "the Hub cannot be reached" in done.err
    assert "Traceback" not in done.err


def test_what_is_no_lerobot_set_is_refused_before_it_is_fetched(hub, published, tmp_path):
    repository = published("acme/cups", "ab")
    repository.commit({"train.csv": b"a,b"})
    done = imported("hf:acme/cups", tmp_path / "in")
    assert (done.code, hub.asked) == (2, [])
    assert "acme/cups is no LeRobot set" in done.err
    assert "train.csv" in done.err


def test_another_format_reads_no_address(hub, tmp_path):
    done = run("import", "robomimic", "hf:acme/cups", "--out", tmp_path / "in")
    assert done.code == 2
    assert "`import robomimic` reads no address on the Hub" in done.err


def test_a_push_comes_back_as_it_was(hub, dataset, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    root = dataset("ab")
    done = run("export", "lerobot", root, "--push", "hf:acme/cups", "--licence", "CC-BY-4.0", "--private")
    assert done.code == 0, done.err
    repository = hub.repositories["acme/cups"]
    files = repository.commits[repository.refs["main"]]
    assert repository.private
    assert repository.tags == {"v3.0": repository.refs["main"]}
    assert f"hf:acme/cups@{repository.refs['main'][:12]}: 2 episodes of cups@" in done.out
    _, head, body = files["README.md"].decode().split("---\n", 2)
    assert yaml.safe_load(head)["license"] == "cc-by-4.0"
    assert "LeRobot" in yaml.safe_load(head)["tags"]
    assert "| observation.fingertip_force | N |" in body
    assert "| observation.object_pose | m | world |" in body
    assert "2 episodes, 40 rows at 80 Hz" in body.replace("\n", " ")
    assert imported("hf:acme/cups", tmp_path / "back").code == 0
    assert open_dataset(tmp_path / "back").digest == open_dataset(root).digest


def test_a_second_push_replaces_the_first(hub, dataset, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    for ids, name in (("ab", "one"), ("abc", "two")):
        out = tmp_path / f"out-{ids}"
        done = run("export", "lerobot", dataset(ids, name), "--out", out, "--push", "hf:acme/cups", "--licence", "mit")
        assert done.code == 0, done.err
        assert (out / "README.md").is_file()
    repository = hub.repositories["acme/cups"]
    files = repository.commits[repository.refs["main"]]
    assert json.loads(files["meta/info.json"])["total_episodes"] == 3
    assert repository.tags == {"v3.0": repository.refs["main"]}
    assert pq.read_table(tmp_path / "out-abc" / "data" / "chunk-000" / "file-000.parquet").num_rows == 60


@pytest.mark.parametrize(
    ("token", "options", "code", "says"),
    [
        (None, ("--push", "hf:acme/cups", "--licence", "mit"), 3, "a push to the Hub needs a token"),
        (TOKEN, ("--push", "hf:acme/cups"), 2, "the licence of the set is not known"),
        (TOKEN, ("--push", "hf:acme/cups@v1", "--licence", "mit"), 2, "a push goes to the main branch"),
        (TOKEN, ("--private",), 2, "nowhere to write to"),
    ],
)
def test_a_push_that_cannot_be_is_refused_before_anything_is_written(
    hub, dataset, monkeypatch, token, options, code, says
):
    if token:
        monkeypatch.setenv("HF_TOKEN", token)
    done = run("export", "lerobot", dataset("ab"), *options)
    assert done.code == code, done.err
    assert says in done.err
    assert hub.repositories == {}


def test_a_token_that_may_not_write_is_said(hub, dataset, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    hub.readonly = True
    done = run("export", "lerobot", dataset("ab", licence="mit"), "--push", "hf:acme/cups")
    assert done.code == 3
    assert "the token is not allowed to do this with acme/cups" in done.err


def test_addresses():
    address = parse_address("hf:acme/my.set@refs/convert/parquet")
    assert (address.repository, address.revision) == ("acme/my.set", "refs/convert/parquet")
    assert str(address) == "hf:acme/my.set@refs/convert/parquet"
    with pytest.raises(UsageError):
        parse_address("hf:acme/cups@")


def test_licences_are_those_of_all_ancestors():
    parent = Lineage(operation="fetch", details={"licence": "CC-BY-4.0"})
    lineage = (Lineage(operation="merge", parents=("a@1",), ancestry={"a@1": (parent,)}),)
    assert stated_licences(lineage) == {"CC-BY-4.0"}


def test_a_hub_that_fails_is_said_with_its_status(hub, tmp_path):
    hub.status = 503
    done = imported("hf:acme/cups", tmp_path / "in")
    assert done.code == 3
    assert "HTTP 503" in done.err
    assert "wait a few minutes" in done.err
