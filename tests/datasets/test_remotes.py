"""The same over a shared folder and a real S3 protocol server."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from candata.checks import check
from candata.datasets import open_dataset
from candata.datasets.pull import pull
from candata.datasets.push import push
from candata.datasets.remotes import move, no_bar, object_key, open_remote, read_key
from candata.datasets.tags import read_tags
from candata.datasets.versions import numbers
from candata.errors import CandataError, DataError, SetupError, UnknownNameError, UsageError
from candata.loaders.splits import load_split
from candata.schema.registry import RemoteEntry
from tests.conftest import WHOLE

from .conftest import add

WORKER = Path(__file__).with_name("push_worker.py")
PULL_WORKER = WORKER.with_name("pull_worker.py")


def files(root: Path) -> dict[str, bytes]:
    """Everything that makes up a dataset, by path."""
    kept = ("parts", "versions", "objects", "splits", "tags")
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and (path.parent == root or path.relative_to(root).parts[0] in kept)
    }


def test_what_was_pulled_is_what_was_pushed_to_the_byte(rich, store, tmp_path):
    sent = push(rich, store, "rich")
    assert (sent.versions, sent.splits, sent.tags, sent.standing) == ((1, 2), ("default",), ("clean",), 0)
    got = pull(store, "rich", tmp_path / "copy")
    here, there = files(rich), files(tmp_path / "copy")
    del here["versions/000001.json"]  # only the newest was asked for
    assert there == here
    assert (got.version, got.splits, got.tags, got.notes) == (2, ("default",), ("clean",), ())
    opened, copy = open_dataset(rich), open_dataset(tmp_path / "copy")
    assert load_split(copy) == load_split(opened)
    assert check(copy, rules=WHOLE, deep=True) == ()
    assert not (tmp_path / "copy/staging/pull").exists()


def test_pushing_again_sends_nothing_and_a_new_version_only_what_is_new(rich, store, episode, tmp_path):
    push(rich, store, "rich")
    again = push(rich, store, "rich")
    assert (again.versions, again.objects, again.bytes, again.splits, again.tags) == ((), 0, 0, (), ())
    add(rich, [episode("z", seed=9)])
    more = push(rich, store, "rich")
    assert (more.versions, more.objects) == ((3,), 3)  # part.json and two tables
    pull(store, "rich", tmp_path / "copy", 2)
    got = pull(store, "rich", tmp_path / "copy")
    assert (got.version, got.objects) == (3, 2)
    assert numbers(tmp_path / "copy") == [2, 3]


@pytest.mark.parametrize("asked", [1, "clean", "digest"])
def test_a_version_is_asked_for_by_number_tag_or_digest(rich, store, tmp_path, asked):
    push(rich, store, "rich")
    wanted = open_dataset(rich, 1 if asked == 1 else 2)
    got = pull(store, "rich", tmp_path / "copy", wanted.digest[:8] if asked == "digest" else asked)
    assert (got.version, got.digest, got.episodes) == (wanted.version, wanted.digest, len(wanted))


def test_a_push_killed_half_way_is_invisible_and_sends_only_the_rest(rich, entry, store, tmp_path):
    command = [sys.executable, str(WORKER), str(rich), entry.model_dump_json(), "rich"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        process.kill()
        rest = process.stdout.read()
    assert first.startswith("rich/objects/")
    assert "done" not in rest
    there = store.sizes("rich/objects")
    assert there
    with pytest.raises(UnknownNameError, match="dataset on the remote"):
        pull(store, "rich", tmp_path / "copy")
    assert not (tmp_path / "copy").exists()

    sent = push(rich, store, "rich")
    # A request that was under way when its sender died may still arrive after the look.
    assert sent.objects + sent.standing == len(store.sizes("rich/objects"))
    assert len(there) <= sent.standing < len(store.sizes("rich/objects"))
    pull(store, "rich", tmp_path / "copy")
    assert open_dataset(tmp_path / "copy").digest == open_dataset(rich).digest


@pytest.mark.parametrize("whole", [0, 3])
def test_a_pull_killed_in_a_file_is_no_dataset_yet_and_fetches_only_the_rest(rich, entry, store, tmp_path, whole):
    push(rich, store, "rich")
    out = tmp_path / "copy"
    command = [sys.executable, PULL_WORKER, out, entry.model_dump_json(), "rich", str(whole)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "half\n"
        process.kill()
    with pytest.raises(CandataError):
        open_dataset(out)
    got = pull(store, "rich", out)
    assert got.standing == whole
    there = files(out)
    here = files(rich)
    del here["versions/000001.json"]
    assert there == here  # no half file was taken along into a part
    assert check(open_dataset(out), rules=["hashes"]) == ()
    assert list((out / "staging").iterdir()) == []


def test_of_two_that_push_at_once_one_wins_and_the_other_is_told(rich, entry, store, episode, tmp_path):
    push(rich, store, "rich")
    copies = [tmp_path / "one", tmp_path / "two"]
    for number, copy in enumerate(copies):
        pull(store, "rich", copy)
        add(copy, [episode(f"new{number}", seed=50 + number)])
    together = threading.Barrier(2)
    told: dict[Path, CandataError | None] = {}

    def run(copy: Path) -> None:
        own = open_remote(entry)
        create = own.create

        def late(key: str, data: bytes) -> bool:
            if "/versions/" in key:
                together.wait(20)  # both have sent everything but the version
            return create(key, data)

        own.create = late  # type: ignore[method-assign]
        try:
            push(copy, own, "rich")
            told[copy] = None
        except DataError as error:
            told[copy] = error

    threads = [threading.Thread(target=run, args=(copy,)) for copy in copies]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (winner,) = [copy for copy in copies if told[copy] is None]
    (loser,) = [copy for copy in copies if told[copy] is not None]
    assert "another history" in str(told[loser])
    pull(store, "rich", tmp_path / "after")
    assert open_dataset(tmp_path / "after").digest == open_dataset(winner).digest

    from candata.datasets.merging import merge_into

    merge_into([open_dataset(loser)], tmp_path / "after")  # the way out that the error names
    push(tmp_path / "after", store, "rich")
    assert {"new0", "new1"} <= set(open_dataset(tmp_path / "after").ids)


def test_two_that_push_the_same_at_once_both_succeed(rich, store):
    create, done = store.create, []

    def meanwhile(key: str, data: bytes) -> bool:
        if "/versions/000001" in key and not done:
            done.append(key)
            create(key, data)
        return create(key, data)

    store.create = meanwhile  # type: ignore[method-assign]
    push(rich, store, "rich")
    assert done


def tamper(store, key: str, change) -> None:
    """Change an object of a remote behind its back."""
    data = change(read_key(store, key))
    store.write(key, [data], len(data))


@pytest.mark.parametrize(
    "change",
    [lambda d: d[:-1], lambda d: d + b"x", lambda d: bytes([d[0] ^ 1]) + d[1:], lambda d: b""],
    ids=["shorter", "longer", "flipped", "empty"],
)
def test_a_corrupted_object_is_refused_by_name_and_what_was_good_is_kept(rich, store, tmp_path, change):
    push(rich, store, "rich")
    part = open_dataset(rich).file.parts[0]
    sha = next(f.sha256 for f in next(open_dataset(rich).raw_parts()).manifest().files)
    key = object_key("rich", sha)
    good = read_key(store, key)
    tamper(store, key, change)
    with pytest.raises(DataError, match=sha):
        pull(store, "rich", tmp_path / "copy")
    with pytest.raises(CandataError):
        open_dataset(tmp_path / "copy")
    assert not (tmp_path / "copy" / "parts" / part.id).exists()
    store.write(key, [good], len(good))
    got = pull(store, "rich", tmp_path / "copy")
    assert got.objects < len(store.sizes("rich/objects"))
    assert open_dataset(tmp_path / "copy").digest == open_dataset(rich).digest


def test_pushing_mends_an_object_of_the_wrong_size(rich, store, tmp_path):
    push(rich, store, "rich")
    sha = open_dataset(rich).file.parts[0].sha256
    tamper(store, object_key("rich", sha), lambda data: data[:-3])
    assert push(rich, store, "rich").objects == 1
    pull(store, "rich", tmp_path / "copy")


def test_a_damaged_dataset_is_not_pushed(rich, store):
    path = next(rich.glob("parts/*/steps.parquet"))
    data = path.read_bytes()
    path.write_bytes(bytes([data[0] ^ 1]) + data[1:])
    with pytest.raises(DataError, match=r"steps\.parquet"):
        push(rich, store, "rich")
    assert store.sizes("rich/versions") == {}


def test_another_dataset_of_the_same_name_is_refused(dataset, store, tmp_path):
    push(dataset("one"), store, "ds")
    with pytest.raises(DataError, match="another history"):
        push(dataset("two", "xyz"), store, "ds")
    pull(store, "ds", tmp_path / "copy")
    with pytest.raises(DataError, match="another history"):
        push(dataset("three", "uvw"), store, "ds")


def test_a_folder_with_another_history_is_refused_and_left_alone(dataset, store):
    push(dataset("one"), store, "ds")
    other = dataset("two", "xyz")
    before = files(other)
    with pytest.raises(DataError, match="another history"):
        pull(store, "ds", other)
    assert files(other) == before


def test_a_folder_with_other_things_is_refused(dataset, store, tmp_path):
    push(dataset("one"), store, "ds")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/letter.txt").write_text("dear")
    with pytest.raises(UsageError, match="not empty"):
        pull(store, "ds", tmp_path / "docs")
    assert [p.name for p in (tmp_path / "docs").iterdir()] == ["letter.txt"]


def test_a_tag_that_moved_is_pushed_only_when_told(rich, store, tmp_path):
    push(rich, store, "rich")
    path = rich / "tags/clean.json"
    path.write_text(
        path.read_text()
        .replace('"version": 2', '"version": 1')
        .replace(open_dataset(rich, 2).digest, open_dataset(rich, 1).digest)
    )
    with pytest.raises(UsageError, match="--move-tags"):
        push(rich, store, "rich")
    assert push(rich, store, "rich", move_tags=True).tags == ("clean",)
    assert pull(store, "rich", tmp_path / "copy", "clean").version == 1
    assert read_tags(tmp_path / "copy")["clean"].version == 1


def test_a_split_that_differs_is_never_replaced(rich, store, tmp_path):
    push(rich, store, "rich")
    pull(store, "rich", tmp_path / "copy")
    path = tmp_path / "copy/splits/default.json"
    path.write_bytes(path.read_bytes().replace(b'"seed": 3', b'"seed": 4'))
    with pytest.raises(DataError, match="another split"):
        push(tmp_path / "copy", store, "rich")
    with pytest.raises(DataError, match="another split"):
        pull(store, "rich", tmp_path / "copy")


def test_an_unknown_dataset_and_an_unknown_version_are_named(rich, store, tmp_path):
    push(rich, store, "rich")
    with pytest.raises(UnknownNameError, match="did you mean 'rich'"):
        pull(store, "rihc", tmp_path / "copy")
    with pytest.raises(UsageError, match="no version 9"):
        pull(store, "rich", tmp_path / "copy", 9)
    with pytest.raises(UsageError, match="no version nope"):
        pull(store, "rich", tmp_path / "copy", "nope")
    assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize(
    ("url", "more", "words"),
    [
        ("s3://key:secret@bucket/x", {}, "holds a credential"),
        ("ftp://host/x", {}, "not the address"),
        ("s3://", {}, "not the address"),
        ("", {}, "not the address"),
        ("s3://b/x", {"endpoint": "http://host"}, "plain http"),
        ("s3://b/x", {"endpoint": "https://user:pw@host"}, "holds a credential"),
        ("s3://b/x", {"endpoint": "host:9000"}, "not an endpoint"),
    ],
)
def test_a_wrong_address_is_one_clear_error(url, more, words):
    with pytest.raises(UsageError, match=words) as told:
        open_remote(RemoteEntry(url=url, **more))
    assert "secret" not in str(told.value)
    assert "pw" not in str(told.value)


def test_s3_without_credentials_says_what_to_set(monkeypatch):
    pytest.importorskip("obstore")
    from candata.datasets.remote_s3 import CREDENTIALS

    for name in CREDENTIALS:
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SetupError, match="AWS_ACCESS_KEY_ID"):
        open_remote(RemoteEntry(url="s3://bucket/x"))


def test_a_bucket_that_is_not_there_is_one_line(s3_server, monkeypatch, rich, tmp_path):
    from .conftest import s3_entry

    entry = s3_entry(s3_server, monkeypatch, "x").model_copy(update={"url": "s3://no-such-bucket/x"})
    with pytest.raises(SetupError, match="NoSuchBucket") as told:
        push(rich, open_remote(entry), "rich")
    assert "Debug" not in str(told.value)


def test_a_share_that_is_not_mounted(tmp_path):
    with pytest.raises(SetupError, match="not there"):
        open_remote(RemoteEntry(url=str(tmp_path / "gone")))


def test_a_file_address_is_a_folder(tmp_path):
    (tmp_path / "a b").mkdir()
    assert open_remote(RemoteEntry(url=(tmp_path / "a b").as_uri())).url == str(tmp_path / "a b")


def test_what_killed_pushes_left_on_a_share_goes_once_it_is_old(rich, tmp_path):
    share = tmp_path / "share"
    for name, days in (("a" * 32, 8), ("b" * 32, 0)):
        draft = share / "x" / "staging" / name
        draft.mkdir(parents=True)
        os.utime(draft, times=(time.time() - days * 86_400,) * 2)
    push(rich, open_remote(RemoteEntry(url=str(share))), "x")
    assert [path.name for path in (share / "x" / "staging").iterdir()] == ["b" * 32]


def test_two_that_pull_into_one_folder_at_once_both_succeed(rich, store, tmp_path):
    push(rich, store, "x")
    read = store.read

    def slow(key):
        time.sleep(0.01)  # lets the two overlap
        yield from read(key)

    store.read = slow
    with ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(pull, store, "x", tmp_path / "out") for _ in range(2)]
        done = [job.result() for job in jobs]
    assert sorted(one.objects > 0 for one in done) == [False, True]
    assert open_dataset(tmp_path / "out").digest == open_dataset(rich).digest


@pytest.mark.parametrize("left", ["nothing", "a mount point"])
@pytest.mark.parametrize("moved", range(0, 12, 3))
def test_a_share_that_goes_midway_is_said_and_never_made_anew(rich, tmp_path, left, moved):
    share, away = tmp_path / "share", tmp_path / "away"
    share.mkdir()

    def goes(verb):
        """A store whose share goes after so many calls of a verb."""
        store = open_remote(RemoteEntry(url=str(share)))
        real, calls, lock = getattr(store, verb), [0], threading.Lock()

        def counted(*arguments):
            with lock:
                if calls[0] == moved:
                    share.rename(away)
                    if left == "a mount point":
                        share.mkdir()
                calls[0] += 1
                return real(*arguments)  # a write that is under way just then may still land on either side

        setattr(store, verb, counted)
        return store

    def back():
        if share.exists():
            share.rmdir()  # fails where anything was written to it
        away.rename(share)

    with pytest.raises(SetupError, match="the folder of the remote"):
        push(rich, goes("write"), "x")
    back()
    whole = open_remote(RemoteEntry(url=str(share)))
    push(rich, whole, "x")
    with pytest.raises(SetupError, match="the folder of the remote has gone"):
        pull(goes("read"), "x", tmp_path / "out")
    back()
    pull(whole, "x", tmp_path / "out")
    assert open_dataset(tmp_path / "out").digest == open_dataset(rich).digest


@pytest.mark.parametrize("error", [KeyboardInterrupt, UsageError("no")])
def test_what_moves_beside_a_failure_ends_with_its_next_piece(error):
    moved: list[int] = []

    def tasks(advance):
        def slow() -> None:
            for _ in range(1000):
                time.sleep(0.01)
                advance(1)
                moved.append(1)

        def failing() -> None:
            time.sleep(0.05)
            raise error

        return [failing, slow, slow]

    with pytest.raises(error if isinstance(error, type) else type(error)):
        move(tasks, 2000, no_bar)
    assert len(moved) < 1000
