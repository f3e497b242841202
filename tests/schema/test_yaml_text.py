"""YAML of strangers: whatever is wrong with it is one kind of error, soon."""

from __future__ import annotations

import pytest
import yaml

from candata.schema.yaml_text import parse_yaml

MERGES = "a: &a {x: 1}\nm0: &m0 {<<: [" + ", ".join(["*a"] * 10) + "]}\n"
MERGES += "".join(f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 10)}]}}\n" for i in range(1, 9))


def test_what_is_sound_is_read_as_ever():
    text = "a: &a {x: 1, y: [mm, 2.5]}\nb: {<<: *a, y: ü}\n"
    assert parse_yaml(text) == yaml.safe_load(text) == {"a": {"x": 1, "y": ["mm", 2.5]}, "b": {"x": 1, "y": "ü"}}


@pytest.mark.parametrize(
    "text",
    [
        "a: [",
        "a: " + "9" * 5000,
        "a: 2001-99-99",
        "a: !!int ''",
        "a: !!bool x",
        "a: !!timestamp x",
        "a: 2001-01-01 00:00:00+99:99",
        "a: " + "1:" * 2000 + "1.0",
        'a: "\\ud800"',
        "[" * 2000,
        "!!python/object/apply:os.getcwd []",
        MERGES,
    ],
)
def test_whatever_is_wrong_is_one_kind_of_error(text):
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)
