"""YAML that a user or a stranger wrote, as a value; whatever is wrong with it is one kind of error.

Plain words are read as YAML 1.2 reads them (core schema, https://yaml.org/spec/1.2.2/#103-core-schema), since names are
often such words: `on`, `off`, `yes`, `no`, `012`, `1_2`, `12:30` and `2026-01-31` are text, which YAML 1.1 takes for
truth values, an octal number, others of base ten and sixty, and a date.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import yaml

from candata.schema.text_bounds import MOST_DIGITS, TextError, decode_text, line_of, read_value

#: Size of YAML text [bytes]; how many values it may unfold to, aliases and merges followed; how deep they may be
#: nested. pyyaml takes 4 s for a million line ends, 1.4 s for so many anchors. Chosen.
MOST_BYTES, MOST_VALUES, MOST_DEPTH = 400_000, 10_000, 64
#: Kinds of words of pyyaml that stay as they are: nothing, and the key that merges.
_NULL, _MERGE = "tag:yaml.org,2002:null", "tag:yaml.org,2002:merge"
_TEXT, _INT, _FLOAT = "tag:yaml.org,2002:str", "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_COLLECTIONS = ("tag:yaml.org,2002:seq", "tag:yaml.org,2002:map")
#: What YAML 1.2 reads as no text otherwise, with the characters that it may begin with.
_WORDS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+|0o[0-7]+", "-+0123456789"),
    "float": (
        r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
}


class _Loader(yaml.SafeLoader):
    """The safe loader within bounds, with the words of YAML 1.2 and no tag that makes anything else.

    A key that stands twice is an error: the first would be lost.
    """

    yaml_implicit_resolvers = {
        character: [(tag, pattern) for tag, pattern in entries if tag in (_NULL, _MERGE)]
        for character, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str):
        super().__init__(text)
        self._depth = self._values = 0
        self._anchored: dict[str, int] = {}

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        """Return a node, once what the text unfolds to with it is within the bounds."""
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            is_known = event.anchor in self.anchors  # type: ignore[has-type]
            if is_known and event.anchor not in self._anchored:
                raise _at(event, f"the alias *{event.anchor} within what it stands for", "write the values out")
            self._count(event, self._anchored.get(str(event.anchor), 0))
            return super().compose_node(parent, index)
        values_before, self._depth = self._values, self._depth + 1
        if self._depth > MOST_DEPTH:
            raise _at(event, "values nested too deep", expected=f"at most {MOST_DEPTH} levels")
        self._count(event, 1)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if event.anchor is not None:
            self._anchored[event.anchor] = self._values - values_before
        self._check_tag(event, node)
        return node

    def _count(self, event: yaml.Event, values: int) -> None:
        """Add to what the text unfolds to."""
        self._values += values
        if self._values > MOST_VALUES:
            fix = "write fewer aliases (*name) or values; data belong into a table"
            raise _at(event, f"more than {MOST_VALUES:,} values, aliases unfolded", fix)

    def _check_tag(self, event: Any, node: Any) -> None:
        """Refuse a tag that makes something else of a value than the text says, and numbers beyond any use."""
        allowed_tags: tuple[Any, ...] = (None, "!", _TEXT, *_COLLECTIONS)
        if isinstance(node, yaml.ScalarNode):
            plain_tag = self.resolve(yaml.ScalarNode, node.value, (True, False))
            allowed_tags = (None, "!", _TEXT, plain_tag) + ((_FLOAT,) if plain_tag == _INT else ())
        if event.tag not in allowed_tags:
            raise _at(event, f"the tag `{event.tag[:80]}`", "remove it", "plain values without tags")
        if node.tag in (_INT, _FLOAT):
            if len(node.value) > MOST_DIGITS:
                raise _at(event, f"a number of {len(node.value):,} digits", expected=f"at most {MOST_DIGITS}")
            if node.tag == _FLOAT and node.value[-1].isdigit() and math.isinf(float(node.value)):
                raise _at(event, f"the number {node.value[:80]}", expected="numbers below 1.8e308")

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Return a mapping whose keys are all different."""
        node = super().compose_mapping_node(anchor)
        first_keys: dict[Any, yaml.ScalarNode] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _at(key, "a key that is itself a list or has keys", expected="names as keys")
            if key.tag == _MERGE:
                continue
            first_key = first_keys.setdefault(self.construct_object(key), key)
            if first_key is not key:
                line = first_key.start_mark.line + 1
                raise _at(key, f"the key `{key.value[:80]}` stands twice, first in line {line}", "remove one of them")
        return node

    def construct_scalar(self, node: yaml.Node) -> Any:
        """Return a plain value, which can be written as UTF-8."""
        value = super().construct_scalar(node)  # type: ignore[arg-type]
        if isinstance(value, str):
            try:
                value.encode()
            except UnicodeEncodeError:
                raise _at(node, "half of a character (\\ud800 to \\udfff)") from None
        return value


for _tag, (_pattern, _characters) in _WORDS.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), list(_characters))


def _at(place: Any, found: str, fix: str | None = None, expected: str | None = None) -> TextError:
    """Return the error of a node or an event."""
    return TextError(found, place.start_mark.line + 1, expected, fix)


def parse_yaml(text: str | bytes) -> Any:
    """Return the value of YAML text; bytes are UTF-8.

    Raises
    ------
    TextError
        Whatever is wrong with it: its form, a key that stands twice, more values than the bounds allow.
    """
    if len(text) > MOST_BYTES:
        raise TextError(f"{len(text):,} bytes", expected=f"at most {MOST_BYTES:,}")
    if isinstance(text, bytes):
        text = decode_text(text)
    try:
        return yaml.load(text, _Loader)
    except yaml.reader.ReaderError as error:
        character = f"the character U+{ord(text[error.position]):04X}"
        raise TextError(character, line_of(text, error.position), "printable text", "remove it") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = ", ".join(part for part in (error.context, error.problem, error.note) if part)
        raise TextError(problem, None if mark is None else mark.line + 1) from None
    except (OverflowError, ValueError) as error:  # an escape such as "\U99999999" is no character
        if isinstance(error, TextError):
            raise
        raise TextError(f"an escape that is no character: {error}") from None


def read_yaml(path: Path, title: str | None = None) -> Any:
    """Return the value of a YAML file; `title` it is to the user is its name by default.

    Raises
    ------
    UsageError
        When it cannot be read, is too large, or is no YAML; names the line.
    DataError
        When it is a Git LFS pointer.
    """
    return read_value(path, parse_yaml, "YAML", MOST_BYTES, title)
