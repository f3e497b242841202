"""Reading a map file that a user wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml

from candata.errors import UsageError, Where
from candata.formats._memory import require_memory
from candata.lfs import refuse_pointer
from candata.schema.record import Record
from candata.schema.yaml_text import parse_yaml

R = TypeVar("R", bound=Record)


def read_map_file(kind: type[R], path: Path) -> R:
    """Return the record in a YAML file.

    Raises
    ------
    UsageError
        When the file is missing, is no YAML, or a field is missing, unknown or wrong.
    DataError
        When it is a Git LFS pointer.
    """
    location = Where(path=str(path))
    refuse_pointer(path)
    try:
        value: Any = parse_yaml(_text(path))
    except UnicodeDecodeError:
        raise UsageError("the map is no text", expected="a YAML file", found="other bytes", where=location) from None
    except OSError as error:
        raise UsageError("the map cannot be read", found=error.strerror, where=location) from None
    except yaml.YAMLError as error:
        raise UsageError("the map is no YAML", found=" ".join(str(error).split())[:400], where=location) from None
    return kind.parse(value, path)


def _text(path: Path) -> str:
    """Return the text of a map; a device or a pipe may never end."""
    if path.exists() and not path.is_file():
        raise OSError(0, "no regular file")
    if path.exists():
        require_memory(path.stat().st_size, "the map", Where(path=str(path)))
    return path.read_text(encoding="utf-8")
