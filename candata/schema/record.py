"""The one parent of all records: frozen, closed, with readable errors."""

from __future__ import annotations

from pathlib import Path
from reprlib import Repr
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from candata.errors import UsageError, Where

#: Shows the start of a value: a small YAML file may unfold to one that no memory holds.
_BRIEF = Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxlong, _BRIEF.maxother = 3, 200, 200, 200
_BRIEF.maxdict = _BRIEF.maxlist = _BRIEF.maxtuple = 20


def _brief(value: Any) -> str:
    """Return the start of a value as text."""
    try:
        return _BRIEF.repr(value)[:200]
    except ValueError:  # Python writes no number of thousands of digits
        return f"a long {type(value).__name__}"


class Record(BaseModel):
    """A frozen, validated value that refuses fields it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())

    @classmethod
    def parse(cls, value: Any, path: str | Path) -> Self:
        """Return the record read from `value`, which came from `path`.

        Raises
        ------
        UsageError
            When a field is missing, unknown or of the wrong kind; names file and field.
        """
        try:
            return cls.model_validate(value)
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(str(part) for part in first["loc"]) or "(whole file)"
            raise UsageError(
                f"{Path(path).name} is not valid: {field}: {first['msg']}",
                found=_brief(first.get("input")),
                where=Where(path=str(path)),
                fix=f"correct the field {field}",
            ) from None
