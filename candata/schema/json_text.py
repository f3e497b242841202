"""JSON that a user or a stranger wrote, as a value; whatever is wrong with it is one kind of error."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from candata.schema.text_bounds import TextError, decode_text, line_of, read_value

#: Size of JSON text [bytes], and how many values it may hold: at 100 bytes of memory each, half a gigabyte. Chosen.
MOST_BYTES, MOST_VALUES = 128_000_000, 5_000_000
#: Texts with what makes keys of them, ends of objects, words that are no JSON, and numbers.
_MARKS = re.compile(r'"(?:[^"\\]|\\.)*"(\s*:)?|[\[\]{}]|-?Infinity|NaN|[0-9]+')


class _DuplicateKeyError(ValueError):
    """A key stands twice in one object."""


class _ConstantError(ValueError):
    """A word stands where a number should."""


def parse_json(text: str | bytes, finite: bool = True) -> Any:
    """Return the value of JSON text.

    Parameters
    ----------
    text : str or bytes
        The text; bytes are UTF-8.
    finite : bool
        Whether `NaN` and `Infinity`, which are no JSON but are written by many, are refused.

    Raises
    ------
    TextError
        Whatever is wrong with it: its form, a key that stands twice, too many values, too long a number.
    """
    if len(text) > MOST_BYTES:
        raise TextError(f"{len(text):,} bytes", expected=f"at most {MOST_BYTES:,}")
    if isinstance(text, bytes):
        text = decode_text(text)
    values = sum(map(text.count, "[{,"))
    if values > MOST_VALUES:
        raise TextError(f"about {values:,} values", expected=f"at most {MOST_VALUES:,}")
    try:
        value = json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse if finite else None)
        if "\\ud" in text or "\\uD" in text:
            json.dumps(value, ensure_ascii=False).encode()  # refuses halves of characters
    except json.JSONDecodeError as error:
        raise TextError(error.msg, error.lineno, fix="correct that line, or restore the file from a copy") from None
    except _DuplicateKeyError:
        key, line = _second_key(text)
        raise TextError(f"the key `{key}` twice in one object", line, fix="remove one of them") from None
    except _ConstantError as error:
        raise TextError(str(error), _line(text, str(error).__eq__), "a finite number, or null") from None
    except RecursionError:
        raise TextError("values nested too deep", expected="fewer than some hundred levels") from None
    except UnicodeEncodeError:
        raise TextError("half of a character (\\ud800 to \\udfff)") from None
    except ValueError:  # Python converts no number of more digits than this
        digits = sys.get_int_max_str_digits()
        line = _line(text, lambda word: word.isdigit() and len(word) > digits)
        raise TextError(f"a number of more than {digits:,} digits", line) from None
    return value


def read_json(path: Path, title: str | None = None, finite: bool = True) -> Any:
    """Return the value of a JSON file; `title` it is to the user is its name by default.

    Raises
    ------
    UsageError
        When it cannot be read, is too large, or is no JSON; names the line.
    DataError
        When it is a Git LFS pointer.
    """
    return read_value(path, lambda data: parse_json(data, finite), "JSON", MOST_BYTES, title)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object whose keys are all different."""
    value = dict(pairs)
    if len(value) != len(pairs):
        raise _DuplicateKeyError
    return value


def _refuse(word: str) -> None:
    """Raise for what is no finite number."""
    raise _ConstantError(word)


def _line(text: str, sought: Callable[[str], bool]) -> int | None:
    """Return the line of the first word that is sought; words within texts are none."""
    return next((line_of(text, mark.start()) for mark in _MARKS.finditer(text) if sought(mark[0])), None)


def _second_key(text: str) -> tuple[str, int | None]:
    """Return the first key that stands twice in one object, and the line where it does."""
    open_keys: list[set[str]] = []
    for mark in _MARKS.finditer(text):
        word = mark[0]
        if word in "[{":
            open_keys.append(set())
        elif word in "]}":
            open_keys.pop()
        elif mark[1]:
            key = json.loads(word.removesuffix(mark[1]))
            if key in open_keys[-1]:
                return key[:80], line_of(text, mark.start())
            open_keys[-1].add(key)
    return "", None
