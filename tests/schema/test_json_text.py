"""JSON of strangers: whatever is wrong with it is one kind of error, soon."""

from __future__ import annotations

import math

import pytest

from candata.schema.json_text import parse_json
from candata.schema.text_bounds import TextError
from tests.memory import GIGABYTE, memory_and_words

#: What is wrong, the words that say it, and the line.
WRONG = {
    "nothing": ("", "Expecting value", 1),
    "a comma too many": ('{"a": 1,\n}', "Expecting property name", 2),
    "deep brackets": ("[" * 100_000, "values nested too deep", None),
    "deep objects": ('{"a":' * 100_000, "values nested too deep", None),
    "no number": ('{"NaN": 1,\n"b": NaN}', "NaN", 2),
    "no end": ("[1,\n\n-Infinity]", "-Infinity", 3),
    "a key twice": (
        '{"a": {"b": "a"},\n "c": {"b": 2, "d": [{"b": 1}],\n"b": 3}}',
        "the key `b` twice in one object",
        3,
    ),
    "a key twice, written in two ways": ('{"a": 1,\n"\\u0061": 2}', "the key `a` twice in one object", 2),
    "a long number": ('["' + "7" * 5000 + '",\n' + "9" * 5000 + "]", "a number of more than 4,300 digits", 2),
    "half of a character": ('["\\uD800"]', "half of a character", None),
    "many values": ("[" + "0," * 5_000_000 + "0]", "about 5,000,001 values", None),
    "UTF-16": ("{}".encode("utf-16"), "UTF-16 or UTF-32", None),
    "another encoding": (b'{"a":\n"\xe9"}', "the byte 0xe9, which is no UTF-8", 2),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_whatever_is_wrong_is_one_kind_of_error_that_names_the_line(wrong):
    text, found, line = WRONG[wrong]
    with pytest.raises(TextError) as caught:
        parse_json(text)
    assert found in caught.value.found
    assert caught.value.line == line


def test_what_is_sound_is_read_as_ever():
    assert parse_json(b'\xef\xbb\xbf{"a": [1, 2.5, "NaN", null, {"a": true}], "b": "\\ud83d\\ude00"}') == {
        "a": [1, 2.5, "NaN", None, {"a": True}],
        "b": "\N{GRINNING FACE}",
    }


def test_numbers_that_are_not_finite_are_read_where_they_may_be():
    assert math.isnan(parse_json("[NaN]", finite=False)[0])


def test_a_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "registry.json"
    with path.open("wb") as file:
        file.truncate(10**10)
    code = "import sys; from pathlib import Path; from candata.schema.json_text import read_json\n"
    code += "try: read_json(Path(sys.argv[1]))\nexcept Exception as error: print(error)"
    peak_bytes, words = memory_and_words(code, path)
    assert words.startswith("registry.json is no JSON\n  expected: at most 128,000,000 bytes\n  found: 10,000,000,000")
    assert peak_bytes < GIGABYTE


def test_as_many_values_as_are_allowed_fit_into_a_gigabyte(tmp_path):
    (tmp_path / "a.json").write_text("[" + '{"a":0},' * 2_400_000 + "0]")
    code = "import sys; from pathlib import Path; from candata.schema.json_text import read_json\n"
    code += "print(len(read_json(Path(sys.argv[1]))))"
    peak_bytes, words = memory_and_words(code, tmp_path / "a.json")
    assert words == "2400001"
    assert peak_bytes < GIGABYTE
