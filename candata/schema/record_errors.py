"""Errors of a value that makes no record, in the words of whoever wrote the file."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from reprlib import Repr
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from candata.errors import UsageError, Where

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

#: Shows the start of a value: a small YAML file may unfold to one that no memory holds.
_SHORT_REPR = Repr()
_SHORT_REPR.maxlevel, _SHORT_REPR.maxstring, _SHORT_REPR.maxlong, _SHORT_REPR.maxother = 3, 200, 200, 200
_SHORT_REPR.maxdict = _SHORT_REPR.maxlist = _SHORT_REPR.maxtuple = 20
#: Keys at fault that are named; a file of another kind has many. Chosen.
_MOST_KEYS = 5
#: Likeness from which a key counts as another one misspelt (difflib's ratio): `rate` is 0.73 like `rate_hz`. Chosen.
_LIKENESS = 0.65
_NO_KEY = "(whole file)"

KeyPath = tuple[str | int, ...]


class _Fault(NamedTuple):
    """One thing that pydantic found, and the keys that lead there in the file."""

    place: KeyPath
    details: ErrorDetails

    @property
    def kind(self) -> str:
        """Pydantic's name of the fault."""
        return self.details["type"]


def refusal(kind: type[BaseModel], value: Any, error: ValidationError, path: str | Path) -> UsageError:
    """Return the error that says why `value`, read from `path`, is no `kind`.

    Unknown keys come first and together with required ones that are missing, as one often is the other misspelt; else
    it is the first wrong value.
    """
    faults = _faults(value, error)
    unknown_keys = [f.place for f in faults if f.kind == "extra_forbidden"]
    missing_keys = [f.place for f in faults if f.kind == "missing"]
    if unknown_keys or missing_keys:
        problem, known_keys, fix = _keys_at_fault(kind, unknown_keys, missing_keys)
        fault = next(f for f in faults if f.place in (unknown_keys or missing_keys))
    else:
        fault, known_keys = faults[0], _keys(kind, faults[0].place) if faults[0].kind == "model_type" else []
        problem, fix = _value_at_fault(fault)
    return UsageError(
        f"{Path(path).name} is not valid: {problem}",
        expected=f"keys {', '.join(known_keys)}" if known_keys else None,
        found=_short_text(fault.details.get("input")),
        where=Where(path=str(path)),
        fix=fix,
    )


def _short_text(value: Any) -> str:
    """Return the start of a value as text."""
    try:
        return _SHORT_REPR.repr(value)[:200]
    except ValueError:  # Python writes no number of thousands of digits
        return f"a long {type(value).__name__}"


def _faults(value: Any, error: ValidationError) -> list[_Fault]:
    """Return what is wrong; for a value with alternatives, only the faults of those that fit it best."""
    faults = [_Fault(_place(value, details), details) for details in error.errors()]
    return [
        f for f in faults if not any(len(f.place) < len(o.place) and o.place[: len(f.place)] == f.place for o in faults)
    ]


def _place(value: Any, details: ErrorDetails) -> KeyPath:
    """Return the keys that lead to a fault, without pydantic's names of the alternatives on the way."""
    keys: list[str | int] = []
    for part in details["loc"]:
        is_item = isinstance(value, list | tuple) and isinstance(part, int) and part < len(value)
        if is_item or (isinstance(value, Mapping) and part in value):
            keys, value = [*keys, part], value[part]
    return (*keys, details["loc"][-1]) if details["type"] == "missing" else tuple(keys)


def _keys_at_fault(
    kind: type[BaseModel], unknown_keys: list[KeyPath], missing_keys: list[KeyPath]
) -> tuple[str, list[str], str]:
    """Return the text on keys that are unknown or missing, the keys there are, and what to do."""
    lines: list[str] = []
    for place in unknown_keys[:_MOST_KEYS]:
        *parents, key = place
        matches = difflib.get_close_matches(str(key), _keys(kind, parents), n=1, cutoff=_LIKENESS)
        line = f"{_prefix(parents)}unknown key `{key}`" + (f", did you mean `{matches[0]}`" if matches else "")
        if matches and (*parents, matches[0]) in missing_keys:
            line += ", which is required and missing"
            missing_keys = [p for p in missing_keys if p != (*parents, matches[0])]
        lines.append(line)
    if len(unknown_keys) > _MOST_KEYS:
        lines.append(f"{len(unknown_keys) - _MOST_KEYS} more unknown")
    lines += [f"{_prefix(p[:-1])}required key `{p[-1]}` is missing" for p in missing_keys]
    known_keys = _keys(kind, (unknown_keys or missing_keys)[0][:-1])
    do = ["rename or remove what is unknown"] if unknown_keys else []
    do += [f"add {', '.join(f'`{_dotted_key(p)}`' for p in missing_keys)}"] if missing_keys else []
    return "; ".join(lines), known_keys, ", and ".join(do)


def _value_at_fault(fault: _Fault) -> tuple[str, str]:
    """Return the text on a wrong value, and what to do."""
    field = _dotted_key(fault.place)
    value, message = fault.details.get("input"), fault.details["msg"]
    if fault.kind in ("string_type", "invalid_key") and (yaml_type := _read_as(value)):
        word = "true" if value is True else "false" if value is False else value
        quote_hint = f', as "{word}"' if isinstance(value, int) else ""
        return f"{field}: a name is text, and this is read as {yaml_type}", f"put the name in quotes{quote_hint}"
    if fault.kind == "tuple_type":
        is_text = isinstance(value, str)
        return (
            f"{field}: a list is expected",
            f"write it in brackets: [{value}]" if is_text else f"correct the field {field}",
        )
    if fault.kind == "model_type":
        message = "keys with values are expected"
    return f"{field}: {message}", f"correct the field {field}"


def _read_as(value: Any) -> str:
    """Return what YAML read a name as; empty for text and for what holds other values."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true or false"
    return "a number" if isinstance(value, int | float) else ""


def _dotted_key(place: Sequence[str | int]) -> str:
    """Return the keys that lead to a place as one word."""
    return ".".join(str(key) for key in place) or _NO_KEY


def _prefix(place: Sequence[str | int]) -> str:
    """Return the beginning of a line on a place; empty for the file as a whole."""
    return f"{_dotted_key(place)}: " if place else ""


def _keys(kind: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """Return the keys that the record at a place knows; none if there is no record."""
    kinds: list[Any] = [kind]
    for part in place:
        kinds = [inner for outer in kinds for inner in _inner_types(outer, part)]
    records = (member for union in kinds for member in _alternatives(union) if _is_record(member))
    return [key for record in records for key in record.model_fields]


def _inner_types(kind: Any, part: str | int) -> Iterator[Any]:
    """Yield the types that stand behind one key or index of a type."""
    for member in _alternatives(kind):
        if _is_record(member):
            if str(part) in member.model_fields:
                yield member.model_fields[str(part)].annotation
        elif get_origin(member) in (dict, tuple, list):
            yield get_args(member)[1 if get_origin(member) is dict else 0]


def _alternatives(kind: Any) -> Iterator[Any]:
    """Yield the plain types that a type consists of: the members of a union, what an annotation is on."""
    if get_origin(kind) is Annotated:
        yield from _alternatives(get_args(kind)[0])
    elif get_origin(kind) in (Union, UnionType):
        for member in get_args(kind):
            yield from _alternatives(member)
    else:
        yield kind


def _is_record(kind: Any) -> bool:
    """Tell whether a type is a record."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)
