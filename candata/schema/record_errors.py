"""What is wrong with a value that makes no record, told in the words of whoever wrote the file."""

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
_BRIEF = Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxlong, _BRIEF.maxother = 3, 200, 200, 200
_BRIEF.maxdict = _BRIEF.maxlist = _BRIEF.maxtuple = 20
#: Keys at fault that are named; a file of another kind has many. Chosen.
_MOST_KEYS = 5
#: Likeness from which a key counts as another one misspelt (difflib's ratio): `rate` is 0.73 like `rate_hz`. Chosen.
_LIKENESS = 0.65
_NO_KEY = "(whole file)"

Place = tuple[str | int, ...]


class _Fault(NamedTuple):
    """One thing that pydantic found, and the keys that lead there in the file."""

    place: Place
    details: ErrorDetails

    @property
    def kind(self) -> str:
        """What pydantic calls it."""
        return self.details["type"]


def refusal(kind: type[BaseModel], value: Any, error: ValidationError, path: str | Path) -> UsageError:
    """Return the error that says why `value`, read from `path`, is no `kind`.

    Unknown keys come first and together with required ones that are missing, as one often is the other misspelt; else
    it is the first wrong value.
    """
    faults = _faults(value, error)
    unknown = [f.place for f in faults if f.kind == "extra_forbidden"]
    missing = [f.place for f in faults if f.kind == "missing"]
    if unknown or missing:
        about, known, fix = _keys_at_fault(kind, unknown, missing)
        first = next(f for f in faults if f.place in (unknown or missing))
    else:
        first, known = faults[0], _keys(kind, faults[0].place) if faults[0].kind == "model_type" else []
        about, fix = _value_at_fault(first)
    return UsageError(
        f"{Path(path).name} is not valid: {about}",
        expected=f"keys {', '.join(known)}" if known else None,
        found=_brief(first.details.get("input")),
        where=Where(path=str(path)),
        fix=fix,
    )


def _brief(value: Any) -> str:
    """Return the start of a value as text."""
    try:
        return _BRIEF.repr(value)[:200]
    except ValueError:  # Python writes no number of thousands of digits
        return f"a long {type(value).__name__}"


def _faults(value: Any, error: ValidationError) -> list[_Fault]:
    """Return what is wrong; of the alternatives that a value may be only what those say that fit it best."""
    found = [_Fault(_place(value, details), details) for details in error.errors()]
    return [
        f for f in found if not any(len(f.place) < len(o.place) and o.place[: len(f.place)] == f.place for o in found)
    ]


def _place(value: Any, details: ErrorDetails) -> Place:
    """Return the keys that lead to a fault; what pydantic calls the alternatives on the way is left out."""
    keys: list[str | int] = []
    for part in details["loc"]:
        listed = isinstance(value, list | tuple) and isinstance(part, int) and part < len(value)
        if listed or (isinstance(value, Mapping) and part in value):
            keys, value = [*keys, part], value[part]
    return (*keys, details["loc"][-1]) if details["type"] == "missing" else tuple(keys)


def _keys_at_fault(kind: type[BaseModel], unknown: list[Place], missing: list[Place]) -> tuple[str, list[str], str]:
    """Return what is said of keys that are unknown or missing, which keys there are, and what to do."""
    lines: list[str] = []
    for place in unknown[:_MOST_KEYS]:
        *above, key = place
        near = difflib.get_close_matches(str(key), _keys(kind, above), n=1, cutoff=_LIKENESS)
        line = f"{_prefix(above)}unknown key `{key}`" + (f", did you mean `{near[0]}`" if near else "")
        if near and (*above, near[0]) in missing:
            line += ", which is required and missing"
            missing = [p for p in missing if p != (*above, near[0])]
        lines.append(line)
    if len(unknown) > _MOST_KEYS:
        lines.append(f"{len(unknown) - _MOST_KEYS} more unknown")
    lines += [f"{_prefix(p[:-1])}required key `{p[-1]}` is missing" for p in missing]
    known = _keys(kind, (unknown or missing)[0][:-1])
    do = ["rename or remove what is unknown"] if unknown else []
    do += [f"add {', '.join(f'`{_dotted(p)}`' for p in missing)}"] if missing else []
    return "; ".join(lines), known, ", and ".join(do)


def _value_at_fault(fault: _Fault) -> tuple[str, str]:
    """Return what is said of a wrong value, and what to do."""
    field = _dotted(fault.place)
    value, message = fault.details.get("input"), fault.details["msg"]
    if fault.kind in ("string_type", "invalid_key") and (read := _read_as(value)):
        word = "true" if value is True else "false" if value is False else value
        quoted = f', as "{word}"' if isinstance(value, int) else ""
        return f"{field}: a name is text, and this is read as {read}", f"put the name in quotes{quoted}"
    if fault.kind == "tuple_type":
        one = isinstance(value, str)
        return (
            f"{field}: a list is expected",
            f"write it in brackets: [{value}]" if one else f"correct the field {field}",
        )
    if fault.kind == "model_type":
        message = "keys with values are expected"
    return f"{field}: {message}", f"correct the field {field}"


def _read_as(value: Any) -> str:
    """Return as what YAML took a name; empty for text and for what holds other values."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true or false"
    return "a number" if isinstance(value, int | float) else ""


def _dotted(place: Sequence[str | int]) -> str:
    """Return the keys that lead to a place as one word."""
    return ".".join(str(key) for key in place) or _NO_KEY


def _prefix(place: Sequence[str | int]) -> str:
    """Return the beginning of a line on a place; empty for the file as a whole."""
    return f"{_dotted(place)}: " if place else ""


def _keys(kind: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """Return the keys that the record at a place knows; none where no record stands."""
    kinds: list[Any] = [kind]
    for part in place:
        kinds = [inner for outer in kinds for inner in _inside(outer, part)]
    records = (plain for each in kinds for plain in _alternatives(each) if _is_record(plain))
    return [key for record in records for key in record.model_fields]


def _inside(kind: Any, part: str | int) -> Iterator[Any]:
    """Yield the types that stand behind one key or index of a type."""
    for plain in _alternatives(kind):
        if _is_record(plain):
            if str(part) in plain.model_fields:
                yield plain.model_fields[str(part)].annotation
        elif get_origin(plain) in (dict, tuple, list):
            yield get_args(plain)[1 if get_origin(plain) is dict else 0]


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
