"""Reading a map file that a user wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml

from candata.errors import UsageError, Where
from candata.schema.record import Record

R = TypeVar("R", bound=Record)


def read_map_file(kind: type[R], path: Path) -> R:
    """Return the record in a YAML file.

    Raises
    ------
    UsageError
        When the file is missing, is no YAML, or a field is missing, unknown or wrong.
    """
    where = Where(path=str(path))
    try:
        value: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise UsageError("the map is no text", expected="a YAML file", found="other bytes", where=where) from None
    except OSError as error:
        raise UsageError("the map cannot be read", found=error.strerror, where=where) from None
    except (yaml.YAMLError, RecursionError) as error:
        raise UsageError("the map is no YAML", found=" ".join(str(error).split())[:200], where=where) from None
    return kind.parse(value, path)
