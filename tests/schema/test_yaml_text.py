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
    "word",
    ["on", "off", "yes", "no", "y", "n", "On", "OFF", "012", "1_2", "12:30", "1:1:1.5", "2026-01-31", "1.2.3", "="],
)
def test_a_name_that_yaml_1_1_takes_for_something_else_is_a_name(word):
    assert parse_yaml(f"joints: [{word}, b]\n{word}: 1") == {"joints": [word, "b"], word: 1}


NO_TEXT = {
    "true": True,
    "FALSE": False,
    "~": None,
    "null": None,
    "": None,
    "3": 3,
    "-3": -3,
    "+5": 5,
    "0x1F": 31,
    "1.5": 1.5,
    ".5": 0.5,
    "1e-3": 0.001,
    "2E4": 2e4,
    "-.inf": float("-inf"),
}


@pytest.mark.parametrize(("word", "value"), NO_TEXT.items())
def test_what_is_no_text_in_yaml_1_2_is_none(word, value):
    found = parse_yaml(f"a: {word}")["a"]
    assert (found, type(found)) == (value, type(value))


def test_a_key_that_stands_twice_is_named_with_both_lines():
    for text in ("joints: [a]\nrate_hz: 80\njoints: [b]\n", "a: {rate_hz: 1,\n\n rate_hz: 2}"):
        with pytest.raises(
            yaml.YAMLError, match=r"(?s)the key `(joints|rate_hz)` stands twice.*line 1, .*line 3, "
        ) as caught:
            parse_yaml(text)
        assert "remove one of them" in str(caught.value)


def test_a_key_that_a_merge_brings_may_be_set_again():
    assert parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: [*a, *a], x: 3}")["b"] == {"x": 3, "y": 2}


@pytest.mark.parametrize(
    "text",
    [
        "a: [",
        "a: " + "9" * 5000,
        "a: !!int ''",
        "a: !!bool x",
        "a: !!timestamp x",
        "a: !!timestamp 2001-01-01 00:00:00+99:99",
        "a: !!float " + "1:" * 2000 + "1.0",
        'a: "\\ud800"',
        "[" * 2000,
        "!!python/object/apply:os.getcwd []",
        MERGES,
    ],
)
def test_whatever_is_wrong_is_one_kind_of_error(text):
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)
