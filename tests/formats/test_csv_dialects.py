"""Text tables as programs write them: delimiters, decimal commas, comments, no header."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from candata.errors import DataError
from candata.formats.table import read

#: Time [s], a joint [rad] and its command [rad].
TABLE = np.array([[0.0, 0.5, 1.0], [0.02, -0.25, 1.5], [0.04, 1e-3, -2.0]])
NAMES = ("t", "q1", "a1")


def text(delimiter: str = ",", decimal: str = ".", header: str | None = "", end: str = "\n") -> str:
    """The table as text, with the names in its first line, another first line, or none."""
    lines = [delimiter.join(f"{x:g}".replace(".", decimal) for x in row) for row in TABLE]
    first = delimiter.join(NAMES) if header == "" else header
    return "".join(line + end for line in ([] if first is None else [first]) + lines)


def written(folder, content, numbered: bool = False):
    """Write a table and a map that gives columns by name or by number; return the map's path."""
    (folder / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    time, joint, action = (0, 1, 2) if numbered else NAMES
    channels = {"joint_position": [joint], "action": [action]}
    (folder / "map.yaml").write_text(
        yaml.safe_dump({"file": "log.csv", "time_s": time, "rate_hz": 50, "channels": channels})
    )
    return folder / "map.yaml"


def refusal(path) -> str:
    with pytest.raises(DataError) as caught:
        list(read(path))
    return str(caught.value).replace(f"{path.parent}/", "")


def check(path) -> None:
    (episode,) = read(path)
    np.testing.assert_allclose(episode["joint_position"][:, 0], TABLE[:, 1], rtol=1e-6)  # float32 rounding
    np.testing.assert_allclose(episode["action"][:, 0], TABLE[:, 2], rtol=1e-6)
    assert episode["time_ns"].tolist() == [0, 20_000_000, 40_000_000]


@pytest.mark.parametrize(
    "content",
    [
        text(),
        text(end="\r\n"),
        text(";"),
        text("\t"),
        text(" "),
        text("   "),
        text(";", ","),
        text("\t", ","),
        text(" ", ","),
        text(header='"t", "q1", "a1"'),
        text(header="# t,q1,a1"),
        text(" ", header="# t q1 a1"),
        text(",", header="% made by a robot\n%t, q1, a1"),
        "# made by a robot; at 50 Hz\n\n" + text(),
        text() + "# the end\n",
        "\ufeff" + text(";", ","),
        text()[:-1],
    ],
)
def test_delimiters_decimal_commas_and_comments_are_read(tmp_path, content):
    check(written(tmp_path, content))


@pytest.mark.parametrize(
    "content", [text(header=None), text(";", ",", None), text("  ", ".", None), "# 50 Hz\n" + text("\t", header=None)]
)
def test_without_a_header_columns_have_numbers(tmp_path, content):
    check(written(tmp_path, content, numbered=True))
    first = content.splitlines()[-3]
    assert refusal(written(tmp_path, content)) == (
        "the table has no header: its first line holds numbers\n"
        "  expected: a first line with the names of columns, or a map that gives columns by number\n"
        f"  found: {first}\n  where: log.csv\n"
        "  do: give columns by number, from 0, such as `time_s: 0` and `joint_position: [1, 2]`, or add a first line"
    )


def test_a_first_line_that_counts_is_a_header(tmp_path):
    check(written(tmp_path, text(header="0,1,2"), numbered=True))


def test_a_number_beyond_the_last_column(tmp_path):
    path = written(tmp_path, text(header=None), numbered=True)
    path.write_text(path.read_text().replace("- 2", "- 3"))
    assert refusal(path).startswith("the table has no header: ")


def test_commas_in_numbers_and_between_them_cannot_be_told_apart(tmp_path):
    message = refusal(written(tmp_path, "t,q1,a1\n0,00,0,50,1,00\n0,02,-0,25,1,50\n"))
    assert message.startswith("commas stand between values and in numbers\n  expected: another delimiter")
    assert "found: 3 names and 6 values a row\n" in message


@pytest.mark.parametrize(
    "content", [text().encode("utf-16"), b"\x00" * 500, b"\xff\xfe\xfd" * 99, b"PK\x03\x04\x00\x00\xff"]
)
def test_bytes_that_are_no_text(tmp_path, content):
    assert refusal(written(tmp_path, content)).startswith("the table is no text\n  expected: a text file in UTF-8\n")


def test_a_table_larger_than_the_memory_is_refused_at_once(tmp_path):
    path = written(tmp_path, text())
    with (tmp_path / "log.csv").open("r+b") as file:
        file.truncate(1 << 43)
    message = refusal(path)
    assert message.startswith("the table does not fit into memory\n  expected: at most ")
    assert "found: 8,796 GB\n" in message


def test_a_column_that_is_not_asked_for_may_hold_anything(tmp_path):
    names, *rows = text().splitlines()
    check(written(tmp_path, "\n".join([f"{names},note", *(f'{row},"a note, with; marks"' for row in rows)])))
