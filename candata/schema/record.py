"""The one parent of all records: frozen, closed, with readable errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from candata.schema.record_errors import refusal


class Record(BaseModel):
    """A frozen, validated value that refuses fields it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=(), allow_inf_nan=False)

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
            raise refusal(cls, value, error, path) from None


class ResultRecord(Record):
    """A record of what was computed: a number may be NaN or infinite where nothing could be measured."""

    model_config = ConfigDict(allow_inf_nan=True)
