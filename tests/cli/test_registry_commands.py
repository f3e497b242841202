"""`candata registry ...`: exact text, JSON, exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import CandataError, DataError, UnknownNameError, UsageError
from candata.loaders.splits import load_split, make_split, split_digest, split_names
from candata.schema.manifest import Lineage
from candata_cli.main import build

from ..datasets.forging import forge, nudged, rewrite


@pytest.fixture(autouse=True)
def own_registry(tmp_path, monkeypatch):
    monkeypatch.setenv("CANDATA_REGISTRY", str(tmp_path / "home/registry.json"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def day1(tmp_path, episode):
    root = create_dataset(tmp_path / "day1")
    append(
        root, [episode(i, seed=ord(i), object="cup" if i < "c" else "can") for i in "abc"], Lineage(operation="test")
    )
    assert run("registry", "add", "first", root).exit_code == 0
    return root


def run(*arguments: object):
    result = CliRunner().invoke(build(), [str(a) for a in arguments])
    assert result.exception is None or isinstance(result.exception, CandataError | SystemExit), result.exception
    return result


def out(*arguments: object) -> str:
    result = run(*arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def digest(path) -> str:
    return open_dataset(path).digest[:12]


def test_names_are_added_listed_and_forgotten(day1, tmp_path):
    assert out("registry", "list").splitlines() == [
        "name   version  episodes  digest        state  folder",
        f"first  1        3         {digest(day1)}  ok     {day1}",
    ]
    (row,) = json.loads(out("registry", "list", "--json"))["datasets"]
    assert (row["name"], row["episodes"], row["state"]) == ("first", 3, "ok")
    assert out("registry", "remove", "first") == "first forgotten; the dataset was not touched\n"
    assert run("registry", "list").stderr == "no names yet: candata registry add NAME FOLDER\n"
    assert day1.is_dir()


def test_a_name_whose_dataset_is_gone_is_listed_as_such(day1, tmp_path):
    day1.rename(tmp_path / "moved")
    assert "not a dataset" in out("registry", "list")
    assert isinstance(run("registry", "info", "first").exception, UsageError)


def test_info_tells_versions_tags_and_lineage(day1, episode):
    append(day1, [episode("d", seed=9)], Lineage(operation="more"))
    assert out("registry", "tag", "first", "raw", "--version", "1") == f"raw: version 1, {digest_of(day1, 1)}\n"
    assert out("registry", "info", "first").splitlines() == [
        f"day1@{digest(day1)}  version 2, 4 episodes, in {day1}",
        "version  digest        parts  left out  tags",
        f"1        {digest_of(day1, 1)}  1      0         raw",
        f"2        {digest(day1)}  2      0         -",
        "splits: none stored",
        f"day1@{digest(day1)}",
        "├─ test",
        "└─ more",
    ]
    found = json.loads(out("registry", "info", "first@raw", "--json"))
    assert (found["version"], found["episodes"]) == (1, 3)
    assert [v["tags"] for v in found["versions"]] == [["raw"], []]


def digest_of(path, version) -> str:
    return open_dataset(path, version).digest[:12]


def test_a_tag_is_moved_and_taken_away(day1, episode):
    out("registry", "tag", "first", "good")
    append(day1, [episode("d", seed=9)], Lineage(operation="more"))
    assert "--move" in str(run("registry", "tag", "day1", "good").exception)
    assert out("registry", "tag", "day1", "good", "--move").startswith("good: version 2")
    assert out("registry", "tag", "first@1", "good", "--move").startswith("good: version 1")
    assert out("registry", "tag", "day1", "good", "--delete") == "good taken away; the version stays\n"
    assert isinstance(run("registry", "tag", "day1", "good", "--delete").exception, UnknownNameError)
    assert isinstance(run("registry", "tag", "day1", "x", "--delete", "--move").exception, UsageError)


def test_diff_says_what_changed_and_exits_1(day1, episode):
    append(day1, [episode("d", seed=9)], Lineage(operation="more"))
    result = run("registry", "diff", "first@1", "first")
    assert (result.exit_code, result.stdout) == (1, "added   d\n1 added, 0 removed, 0 changed, 3 the same\n")
    same = run("registry", "diff", "first", day1, "--json")
    assert (same.exit_code, json.loads(same.stdout)["equal"], json.loads(same.stdout)["same"]) == (0, True, 4)


def test_diff_reads_contents_and_only_when_quick_what_manifests_claim(day1):
    shutil.copytree(day1, "forged")
    forge(Path("forged"), lambda folder, _: rewrite(folder / "steps.parquet", "joint_position", nudged))
    result = run("registry", "diff", "first", "forged")
    assert (result.exit_code, result.stdout) == (1, "changed a\n0 added, 0 removed, 1 changed, 2 the same\n")
    assert "not what manifests claim: a; see candata validate\n" in result.stderr
    assert run("registry", "diff", "first", "forged", "--quick").exit_code == 0


def test_filter_prints_ids_or_makes_a_dataset(day1):
    pytest.importorskip("duckdb")
    result = run("registry", "filter", "first", "object = 'cup'")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "a\nb\n", "2 of 3 episodes\n")
    assert json.loads(out("registry", "filter", "first", "rows > 99", "--json"))["ids"] == []
    made = out("registry", "filter", "first", "object = 'cup'", "--out", "cups")
    assert made == f"cups: 2 episodes in version 1, {digest('cups')}\n"
    assert "did you mean 'object'" in str(run("registry", "filter", "first", "objet = 'cup'").exception)


def test_filter_without_duckdb_names_the_extra(day1, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "duckdb", None)
    result = run("registry", "filter", "first", "true")
    assert isinstance(result.exception, CandataError)
    assert (result.exception.exit_code, 'pip install "candata[query]"' in str(result.exception)) == (3, True)


def test_merge_relabel_and_log(day1, episode):
    pytest.importorskip("duckdb")
    out("registry", "filter", "first", "id = 'a'", "--out", "one")
    out("registry", "filter", "first", "id = 'b'", "--out", "two")
    assert out("registry", "merge", "one", "two", "--out", "both").startswith("both: 2 episodes in version 1")
    assert isinstance(run("registry", "merge", "one", "two", "--out", "both").exception, UsageError)
    assert out("registry", "merge", "first", "--out", "both", "--append").startswith("both: 3 episodes in version 2")
    out(
        "registry", "relabel", "both", "--set", "task=pick", "--set", "object=", "--where", "id = 'a'", "--out", "named"
    )
    assert open_dataset("named").episode("a").meta.task == "pick"
    assert open_dataset("named").episode("a").meta.object is None
    lines = out("registry", "log", "named").splitlines()
    assert lines[1].startswith("└─ relabel; set {'task': 'pick', 'object': None}; where id = 'a'; episodes 1; candata")
    assert sum("filter; where" in line for line in lines) == 2
    assert out("registry", "cut", "both", "--length-s", "0.1", "--out", "pieces").startswith("pieces: ")
    tree = json.loads(out("registry", "log", "named", "--json"))
    assert tree["steps"][0]["parents"][0]["dataset"].startswith("both@")
    assert isinstance(run("registry", "relabel", "both", "--set", "task", "--out", "x").exception, UsageError)
    assert isinstance(run("registry", "relabel", "both", "--set", "tsk=1", "--out", "x").exception, UnknownNameError)


def test_push_and_pull_through_a_share(day1, tmp_path):
    assert run("registry", "remotes", "list").stderr == "no remotes yet: candata registry remotes add NAME URL\n"
    result = run("registry", "remotes", "add", "lab", "share")
    assert (result.exit_code, "not there yet" in result.stderr) == (0, True)
    assert run("registry", "push", "first", "lab").exception.exit_code == 3
    (tmp_path / "share").mkdir()
    out("registry", "tag", "first", "good")
    result = run("registry", "push", "first", "lab")
    assert result.stdout.startswith(f"day1@{digest(day1)} on lab: new versions 1; 3 files sent (")
    assert result.stderr.startswith("sending: 0.0 MB")
    sent = json.loads(out("registry", "push", "first", "lab", "--json"))
    assert (sent["objects"], sent["standing"], sent["versions"]) == (0, 3, [])
    assert out("registry", "remotes", "list", "lab").splitlines()[1] == "day1     1"
    got = json.loads(out("registry", "pull", "lab", "day1@good", "--out", "copy", "--json"))
    assert (got["version"], got["tags"], got["episodes"]) == (1, ["good"], 3)
    assert run("registry", "diff", "day1", "copy").exit_code == 0
    assert isinstance(run("registry", "push", "first@1", "lab").exception, UsageError)
    assert isinstance(run("registry", "push", "first", "lap").exception, UnknownNameError)
    assert isinstance(run("registry", "pull", "lab", "day2", "--out", "x").exception, UnknownNameError)
    assert not (tmp_path / "x").exists()


def test_a_remote_with_a_credential_in_its_address_is_refused_and_not_repeated(tmp_path):
    result = run("registry", "remotes", "add", "own", "s3://key:hush@bucket")
    assert isinstance(result.exception, UsageError)
    assert "hush" not in str(result.exception) + result.output
    assert not (tmp_path / "home").exists()


def test_remotes_are_listed_with_how_they_are_reached():
    out("registry", "remotes", "add", "own", "s3://bucket/x", "--endpoint", "http://localhost:9000", "--allow-http")
    out("registry", "remotes", "add", "cloud", "s3://bucket", "--region", "eu-central-1")
    assert out("registry", "remotes", "list").splitlines()[1:] == [
        "cloud  s3://bucket    AWS, eu-central-1",
        "own    s3://bucket/x  http://localhost:9000, path-style, plain http",
    ]
    found = json.loads(out("registry", "remotes", "list", "--json"))["remotes"]
    assert (found["own"]["path_style"], found["cloud"]["path_style"]) == (True, False)
    assert out("registry", "remotes", "remove", "own").startswith("own forgotten")


def test_a_damaged_registry_is_an_error_of_data(day1, tmp_path):
    (tmp_path / "home/registry.json").write_text("{")
    assert isinstance(run("registry", "list").exception, DataError)
    assert run("registry", "info", "day1").exit_code == 0  # a folder needs no registry


def test_a_split_is_drawn_stored_and_the_same_wherever_it_is_drawn(day1, tmp_path):
    text = out("registry", "split", "first", "mine", "--seed", 3)
    assert text.startswith("mine: train 1, val 1, test 1 of 3 episodes, ")
    stored = load_split(open_dataset(day1), "mine")
    assert stored == make_split(open_dataset(day1), seed=3)
    assert out("registry", "split", day1, "mine", "--seed", 3) == text
    found = json.loads(out("registry", "split", "first", "--by", "object", "--shares", "0.5,0,0.5", "--json"))
    assert (found["split"], found["train"], found["val"], found["test"]) == ("default", 2, 0, 1)
    assert found["digest"] == split_digest(load_split(open_dataset(day1)))


def test_splits_come_along_and_an_appended_one_stays(day1, tmp_path, episode):
    pytest.importorskip("duckdb")
    out("registry", "split", "first", "mine", "--seed", 3)
    told = run("registry", "filter", "first", "id <> 'a'", "--out", "two").stderr
    assert told.startswith("the split mine is carried: ")
    assert "; empty now: " in told
    assert run("registry", "merge", "first", "two", "--out", "both").stderr.startswith("the split mine is carried")
    assert load_split(open_dataset("both"), "mine").train == load_split(open_dataset(day1), "mine").train
    append(day1, [episode("d", seed=9)], Lineage(operation="more"))
    result = run("registry", "merge", "first", "--out", "both", "--append")
    assert result.stderr == "the split mine stays as it was drawn: 1 of 4 episodes are in none of it\n"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("--shares", "0.8,0.2"), "cannot read the shares"),
        (("--shares", "a,b,c"), "cannot read the shares"),
        (("--shares", "0.8,0.8,0"), "add up to 1"),
        (("--shares", "nan,0.8,0"), "add up to 1"),
        (("--by", "colour"), "unknown field to split by"),
        (("--seed", "7"), "another split"),
        (("--by", "object"), "too few episodes"),
    ],
)
def test_a_split_that_cannot_be_drawn_is_refused_and_nothing_kept(day1, arguments, error):
    out("registry", "split", "first", "mine")
    before = load_split(open_dataset(day1), "mine")
    result = run("registry", "split", "first", "mine", *arguments)
    assert error in str(result.exception)
    assert split_names(open_dataset(day1)) == ("mine",)
    assert load_split(open_dataset(day1), "mine") == before
