"""YAML that a user or a stranger wrote, as a value; whatever is wrong with it is one kind of error."""

from __future__ import annotations

from typing import Any

import yaml

#: Fields that one mapping may hold once others are merged into it (`<<`); merges of merges grow without end.
_MOST_FIELDS = 10_000


class _Loader(yaml.SafeLoader):
    """The safe loader, without merges that unfold to more than any file says, and without halves of characters."""

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


def parse_yaml(text: str) -> Any:
    """Return the value of YAML text.

    Raises
    ------
    yaml.YAMLError
        Whatever is wrong with it: its form, a number too long, a date that is none.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError:
        raise
    except Exception as error:  # pyyaml lets through what the constructors of values raise
        raise yaml.YAMLError(f"{type(error).__name__}: {error}") from None
