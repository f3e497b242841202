"""YAML that a user or a stranger wrote, as a value; whatever is wrong with it is one kind of error.

Plain words are read as YAML 1.2 reads them (core schema, https://yaml.org/spec/1.2.2/#103-core-schema), since names are
often such words: `on`, `off`, `yes`, `no`, `012`, `1_2`, `12:30` and `2026-01-31` are text, which YAML 1.1 takes for
truth values, an octal number, others of base ten and sixty, and a date.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

#: Fields that one mapping may hold once others are merged into it (`<<`); merges of merges grow without end.
_MOST_FIELDS = 10_000
#: Kinds of words of pyyaml that stay as they are: nothing, and the key that merges.
_NULL, _MERGE = "tag:yaml.org,2002:null", "tag:yaml.org,2002:merge"
#: What YAML 1.2 reads as no text otherwise, with the characters that it may begin with.
_WORDS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
}


class _Loader(yaml.SafeLoader):
    """The safe loader, without merges that unfold to more than any file says, and without halves of characters.

    Its words are those of YAML 1.2, and a key that stands twice is an error: the first would be lost.
    """

    yaml_implicit_resolvers = {
        character: [(tag, pattern) for tag, pattern in entries if tag in (_NULL, _MERGE)]
        for character, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Return a mapping whose keys are all different."""
        node = super().compose_mapping_node(anchor)
        first_keys: dict[tuple[str, str], yaml.ScalarNode] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
                continue
            first_key = first_keys.setdefault((key.tag, key.value), key)
            if first_key is not key:
                raise yaml.constructor.ConstructorError(
                    f"the key `{key.value}` stands twice, first",
                    first_key.start_mark,
                    "and again: remove one of them",
                    key.start_mark,
                )
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merge what a mapping refers to into it."""
        super().flatten_mapping(node)
        if len(node.value) > _MOST_FIELDS:
            raise yaml.constructor.ConstructorError(
                None, None, f"a mapping of more than {_MOST_FIELDS} fields", node.start_mark
            )

    def construct_scalar(self, node: yaml.Node) -> Any:
        """Return a plain value, which can be written as UTF-8."""
        value = super().construct_scalar(node)  # type: ignore[arg-type]
        if isinstance(value, str):
            value.encode()
        return value


for _tag, (_pattern, _characters) in _WORDS.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), list(_characters))


def parse_yaml(text: str) -> Any:
    """Return the value of YAML text.

    Raises
    ------
    yaml.YAMLError
        Whatever is wrong with it: its form, a key that stands twice, a number too long.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError:
        raise
    except Exception as error:  # pyyaml lets through what the constructors of values raise
        raise yaml.YAMLError(f"{type(error).__name__}: {error}") from None
