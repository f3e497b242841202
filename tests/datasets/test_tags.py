"""A tag opens its version; what is no tag of this version is refused."""

from __future__ import annotations

import pytest

from candata.datasets import append, create_dataset, durable, open_dataset
from candata.datasets.tags import read_tags, tag_path
from candata.errors import DataError, UsageError
from candata.schema.manifest import Lineage, TagFile


@pytest.fixture
def root(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    for name in "ab":
        append(root, [episode(name)], Lineage(operation="test"))
    return root


def put(root, name, version, digest=None, inside=None):
    digest = digest or open_dataset(root, version).digest
    durable.ensure_folder(root / "tags")
    tag_path(root, name).write_bytes(
        durable.encode_record(TagFile(name=inside or name, version=version, digest=digest))
    )


def test_a_tag_opens_its_version(root):
    assert read_tags(root) == {}
    put(root, "paper", 1)
    put(root, "best", 2)
    assert list(read_tags(root)) == ["best", "paper"]
    assert open_dataset(root, "paper").ids == ("a",)
    assert open_dataset(root, "best").version == 2


def test_a_number_and_a_digest_come_before_a_tag(root):
    first, second = open_dataset(root, 1), open_dataset(root, 2)
    put(root, second.digest[:8], 1)
    assert open_dataset(root, second.digest[:8]).version == 2
    assert open_dataset(root, first.digest[:8]).version == 1


def test_a_tag_that_names_another_version_or_another_tag_is_damaged(root):
    put(root, "paper", 1, digest=open_dataset(root, 2).digest)
    with pytest.raises(DataError, match=r"paper\.json"):
        open_dataset(root, "paper")
    put(root, "paper", 1, inside="other")
    with pytest.raises(DataError, match=r"paper\.json"):
        read_tags(root)
    tag_path(root, "paper").unlink()
    with pytest.raises(UsageError, match="no version paper"):
        open_dataset(root, "paper")
