"""Tags: names that people give to versions, one small file each."""

from __future__ import annotations

from pathlib import Path

from candata.datasets import durable
from candata.schema.manifest import TagFile


def tag_path(root: Path, name: str) -> Path:
    """Return the file of a tag."""
    return root / "tags" / f"{name}.json"


def read_tags(root: Path) -> dict[str, TagFile]:
    """Return all tags of a dataset by name, sorted; none where there are none.

    Raises
    ------
    DataError
        When a tag's file is damaged, or holds a tag of another name; names it.
    """
    tags = {path.stem: durable.read_record(TagFile, path) for path in sorted((root / "tags").glob("*.json"))}
    for name, tag in tags.items():
        if tag.name != name:
            raise durable.damaged_error(tag_path(root, name), f"a tag {tag.name!r}", f"a tag {name!r}")
    return tags
