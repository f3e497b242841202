"""Versions are compared by what episodes hold, not by what manifests claim."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from candata.datasets import open_dataset
from candata.datasets.diff import diff, ids_to_read
from candata.datasets.filtering import filter_dataset
from candata.datasets.merging import merge, merge_into
from candata.errors import DataError

from .conftest import add
from .forging import forge, nudged, rewrite

pytestmark = pytest.mark.hard


def other_cell(folder: Path, _: dict) -> None:
    """Change a number; hash and digest go on to claim the old content."""
    rewrite(folder / "steps.parquet", "joint_position", nudged)


def other_claim(folder: Path, manifest: dict) -> None:
    """Claim another content for the first episode; the content stays."""
    manifest["episodes"][0][1] = "1" * 64
    rewrite(folder / "episodes.parquet", "content_hash", lambda old: ["1" * 64, *old[1:]])


@pytest.fixture
def honest(dataset):
    return open_dataset(dataset("honest", "abc"))


@pytest.fixture
def forged(honest, tmp_path):
    """A copy of it in which one number differs and every hash claims that none does."""
    root = shutil.copytree(honest.path, tmp_path / "forged")
    forge(root, other_cell)
    return open_dataset(root)


def test_equal_claims_for_other_contents_are_a_difference(honest, forged):
    assert forged.digest == honest.digest
    found = diff(honest, forged)
    assert (found.changed, found.same, found.misstated, found.is_equal) == (("a",), 2, ("a",), False)
    assert diff(honest, forged, trust_manifests=True).is_equal


def test_other_claims_for_equal_contents_are_none(honest, tmp_path):
    root = shutil.copytree(honest.path, tmp_path / "claims")
    forge(root, other_claim)
    found = diff(honest, open_dataset(root))
    assert (found.is_equal, found.misstated) == (True, ("a",))
    assert diff(honest, open_dataset(root), trust_manifests=True).changed == ("a",)


def test_what_does_not_decode_is_damage(honest, tmp_path):
    root = shutil.copytree(honest.path, tmp_path / "torn")
    path = next(root.glob("parts/*/steps.parquet"))
    path.write_bytes(bytes(path.stat().st_size))
    with pytest.raises(DataError, match=r"damaged dataset: steps\.parquet"):
        diff(honest, open_dataset(root))


def test_episodes_in_the_same_files_are_not_read(honest, dataset, episode, tmp_path):
    filter_dataset(honest, "id <> 'c'", tmp_path / "some")
    assert ids_to_read(honest, open_dataset(tmp_path / "some")) == set()
    assert ids_to_read(honest, honest) == set()
    copy = open_dataset(shutil.copytree(honest.path, tmp_path / "copy"))
    assert ids_to_read(honest, copy) == {"a", "b", "c"}
    add(honest.path, [episode("z", seed=9)])
    told: list[int] = []
    assert diff(honest, open_dataset(honest.path), progress=told.append).added == ("z",)
    assert sum(told) == 3


def test_a_merge_refuses_equal_claims_for_other_contents(honest, forged, dataset, tmp_path):
    with pytest.raises(DataError, match="the content of an episode has changed") as error:
        merge([honest, forged], tmp_path / "out")
    assert (error.value.where.episode, error.value.where.path.startswith(str(forged.path))) == ("a", True)
    assert not (tmp_path / "out").exists()
    before = open_dataset(honest.path).version
    with pytest.raises(DataError, match="the content of an episode has changed"):
        merge_into([forged], honest.path)
    assert open_dataset(honest.path).version == before
    merge([forged, open_dataset(dataset("other", "xy"))], tmp_path / "apart")  # no id twice: nothing to compare
    assert open_dataset(tmp_path / "apart").ids == ("a", "b", "c", "x", "y")


def test_two_contents_of_one_id_in_one_version_are_damage(dataset, tmp_path):
    root, other = dataset("one", "ab"), dataset("two", "xy")

    def same_name(folder: Path, manifest: dict) -> None:
        manifest["episodes"][0][0] = "a"

    forge(other, same_name)
    (part,) = (other / "parts").iterdir()
    shutil.copytree(part, root / "parts" / part.name)
    version, more = root / "versions/000001.json", other / "versions/000001.json"
    told = json.loads(version.read_text())
    told["parts"] += json.loads(more.read_text())["parts"]
    version.write_text(json.dumps(told))
    with pytest.raises(DataError, match=r"000001\.json\n.*\n  found: two contents: [0-9a-f]{12} and [0-9a-f]{12} of a"):
        open_dataset(root)
