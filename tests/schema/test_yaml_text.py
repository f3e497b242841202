"""YAML of strangers: whatever is wrong with it is one kind of error, soon."""

from __future__ import annotations

import re

import pytest
import yaml

from candata.errors import UsageError
from candata.schema.scene import SceneFile
from candata.schema.text_bounds import TextError
from candata.schema.yaml_text import parse_yaml
from tests.memory import GIGABYTE, memory_and_words

MERGES = "a: &a {x: 1}\nm0: &m0 {<<: [" + ", ".join(["*a"] * 10) + "]}\n"
MERGES += "".join(f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 10)}]}}\n" for i in range(1, 9))


LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
LAUGHS += "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))


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
    "0o17": 15,
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


def refusal(text: str | bytes) -> TextError:
    with pytest.raises(TextError) as caught:
        parse_yaml(text)
    return caught.value


def test_a_key_that_stands_twice_is_named_with_both_lines():
    for text in ("joints: [a]\nrate_hz: 80\njoints: [b]\n", "a: {rate_hz: 1,\n\n rate_hz: 2}"):
        error = refusal(text)
        assert re.fullmatch(r"the key `(joints|rate_hz)` stands twice, first in line 1", error.found)
        assert (error.line, error.fix) == (3, "remove one of them")


@pytest.mark.parametrize("keys", ["1: a\n0x1: b", "1: a\n1.0: b", "true: a\n1: b", "~: a\nnull: b"])
def test_keys_of_one_value_are_one_key(keys):
    assert "stands twice, first in line 1" in str(refusal(keys))


def test_a_key_that_a_merge_brings_may_be_set_again():
    assert parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: [*a, *a], x: 3}")["b"] == {"x": 3, "y": 2}


#: What is wrong, the words that say it, and the line.
WRONG = {
    "open brackets": ("a: [", "expected the node content", 1),
    "a long number": ("a: 1\nb: " + "9" * 300_000, "a number of 300,000 digits", 2),
    "a large number": ("a: -1e999", "the number -1e999", 1),
    "a tag of a number": ("a: !!int ''", "the tag `tag:yaml.org,2002:int`", 1),
    "an octal number of YAML 1.1": ("a: !!int 012", "the tag `tag:yaml.org,2002:int`", 1),
    "a tag of a truth value": ("a: !!bool x", "the tag `tag:yaml.org,2002:bool`", 1),
    "a date": ("a:\n  !!timestamp 2001-01-01", "the tag `tag:yaml.org,2002:timestamp`", 2),
    "a set": ("!!set {a, b}", "the tag `tag:yaml.org,2002:set`", 1),
    "bytes": ("a: !!binary aGk=", "the tag `tag:yaml.org,2002:binary`", 1),
    "a tag of the file's own": ("%TAG ! tag:x,2000:\n---\na: !b c", "the tag `tag:x,2000:b`", 3),
    "a call": ("!!python/object/apply:os.getcwd []", "the tag `tag:yaml.org,2002:python/object/apply:os.getcwd`", 1),
    "half of a character": ('a: "\\ud800"', "half of a character", 1),
    "no character": ('a: "\\U99999999"', "an escape that is no character", None),
    "deep brackets": ("[" * 100_000, "nested too deep", 1),
    "deep braces": ("{a: " * 90_000, "nested too deep", 1),
    "deep blocks": ("- " * 100_000, "nested too deep", 1),
    "deep keys": ("? " * 100_000, "nested too deep", 1),
    "deep lines": ("".join(" " * k + "a:\n" for k in range(800)), "nested too deep", 64),
    "merges of merges": (MERGES, "more than 10,000 values, aliases unfolded", 5),
    "a billion laughs": (LAUGHS, "more than 10,000 values, aliases unfolded", 5),
    "one list many times": (
        f"a: &a [{', '.join('1' * 500)}]\nb: [{', '.join(['*a'] * 20_000)}]",
        "more than 10,000",
        2,
    ),
    "many anchors": ("".join(f"- &a{k} x\n" for k in range(20_000)), "more than 10,000 values", 10_000),
    "a list within itself": ("a: &a\n- *a", "the alias *a within what it stands for", 2),
    "keys within themselves": ("&a {b: 1,\nc: *a}", "the alias *a within what it stands for", 2),
    "a merge of itself": ("a: &a {<<: *a}", "the alias *a within what it stands for", 1),
    "an alias of nothing": ("a: *b", "found undefined alias 'b'", 1),
    "a merge of a number": ("a: {<<: 3}", "expected a mapping or list of mappings for merging", 1),
    "two documents": ("a: 1\n---\nb: 2", "found another document", 2),
    "another version": ("%YAML 9.9\n---\na: 1", "incompatible YAML document", 1),
    "a tab": ("a:\n\tb: 1", "found character '\\t'", 2),
    "a blank": ("a: 1\nb: \0x", "the character U+0000", 2),
    "a control character": ("a: \x07", "the character U+0007", 1),
    "UTF-16": ("a: 1".encode("utf-16"), "UTF-16 or UTF-32", None),
    "UTF-16 without its mark": ("a: 1".encode("utf-16-le"), "the character U+0000", 1),
    "another encoding": (b"a: 1\nb: \xe9", "the byte 0xe9, which is no UTF-8", 2),
    "a list as a key": ("a: 1\n? [a]\n: b", "a key that is itself a list or has keys", 2),
    "too much text": ("#" * 400_001, "400,001 bytes", None),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_whatever_is_wrong_is_one_kind_of_error_that_names_the_line(wrong):
    text, found, line = WRONG[wrong]
    error = refusal(text)
    assert found in error.found
    assert error.line == line


def test_a_byte_order_mark_of_utf_8_is_no_text():
    assert parse_yaml(b"\xef\xbb\xbfa: 1") == {"a": 1}


def test_tags_that_change_nothing_are_read():
    assert parse_yaml("!!map {a: !!str 1, b: !!float 1, c: !!seq [!!int 3], d: !!null , e: ! x}") == {
        "a": "1",
        "b": 1.0,
        "c": [3],
        "d": None,
        "e": "x",
    }


def test_as_many_values_as_are_allowed_are_read():
    assert len(parse_yaml("a: &a [1, 2]\nb: [" + ", ".join(["*a"] * 3_000) + "]")["b"]) == 3_000


def test_a_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "scene.yaml"
    with path.open("wb") as file:
        file.truncate(10**10)
    code = "import sys; from pathlib import Path; from candata.schema.yaml_text import read_yaml\n"
    code += "try: read_yaml(Path(sys.argv[1]))\nexcept Exception as error: print(error)"
    peak_bytes, words = memory_and_words(code, path)
    assert words.startswith("scene.yaml is no YAML\n  expected: at most 400,000 bytes\n  found: 10,000,000,000 bytes\n")
    assert peak_bytes < GIGABYTE / 4


@pytest.mark.parametrize("wrong", ["one list many times", "deep brackets", "a long number", "many anchors"])
def test_what_is_refused_takes_little_memory(tmp_path, wrong):
    (tmp_path / "map.yaml").write_text(WRONG[wrong][0])
    code = "import sys; from pathlib import Path; from candata.schema.yaml_text import read_yaml\n"
    code += "try: read_yaml(Path(sys.argv[1]), 'the map')\nexcept Exception as error: print(error)"
    peak_bytes, words = memory_and_words(code, tmp_path / "map.yaml")
    assert words.startswith("the map is no YAML\n")
    assert f"map.yaml, line {WRONG[wrong][2]}\n" in words
    assert peak_bytes < GIGABYTE / 4


@pytest.mark.parametrize("number", [".inf", "-.inf", ".nan", '"inf"', "0b101", "1:30", "017x", "1" * 350])
def test_a_record_takes_finite_numbers_only(number):
    with pytest.raises(UsageError, match=r"scene.yaml is not valid: rate_hz: "):
        SceneFile.parse(parse_yaml(f"model: a.xml\nrate_hz: {number}"), "scene.yaml")
