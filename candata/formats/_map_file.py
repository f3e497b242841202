"""Reading a map file that a user wrote."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from candata.schema.record import Record
from candata.schema.yaml_text import read_yaml

R = TypeVar("R", bound=Record)


def read_map_file(kind: type[R], path: Path) -> R:
    """Return the record in a YAML file.

    Raises
    ------
    UsageError
        When the file is missing, too large, no YAML, or a field is missing, unknown or wrong.
    DataError
        When it is a Git LFS pointer.
    """
    return kind.parse(read_yaml(path, "the map"), path)
