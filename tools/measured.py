"""Writes docs/measured.md and the table of README from the records in `benchmarks/results`.

    python tools/measured.py                                       # after a record has changed
    python tools/measured.py --bench out/bench/bench.json --draw "seed 9"     # a draw of `candata gap bench` first

Each file of `benchmarks/results` is a section of the page: a title, the command that measures it, and blocks. A block
is a heading, a note on what was measured, or a table of records. A record has

    measure     what was measured, in words
    value       the result, or `values`: one for each column of the table
    interval    of the value, with its level
    target      what was promised
    missed      true if the value misses its target; a text says so under another name in the list of misses
    command     what measures it, if not the section's command
    date        of the measurement, or of its entry
    headline    the question under which it stands in README, with its group; `columns` or `value` say what is shown
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks/results"
PAGE, README = ROOT / "docs/measured.md", ROOT / "README.md"
#: Section in which `--bench` puts a draw.
SELF_CHECK = RESULTS / "01_the_self_check.json"
#: Between these two lines README holds its table.
BEGIN, END = "<!-- measured: written by tools/measured.py -->", "<!-- end of measured -->"
#: Kinds of evidence in README's table, in order, and what stands there for each.
GROUPS = {
    "sealed": "sealed, simulated",
    "real": "real recordings",
    "policies": "policies, simulated",
    "paper": "the paper's table",
}

OPENING = """\
# Measured

How often candata is right, how fast it is, and what it does not do well. Two CPU cores measured every figure, of
simulated worlds unless a section says otherwise.

This page is written by `python tools/measured.py` from `benchmarks/results`. To measure again:

<!-- not run: it takes hours -->
```bash
make bench                                    # the benchmarks: some hours
candata gap bench --seed 8 --out out/bench    # the self-check alone: 75 to 90 minutes
```

- A **floor** is what the simulator shows against a recording of itself with the same sensor noise. An effect worth 0.05
  floors hardly shows.
- A case is **sealed** if what is hidden in it was drawn and stored before anyone, or any search, looked at it. A draw
  is used once. What it misses leads to the next search, which is then judged on a new draw.
- **Seen again** marks a result on a case whose answer was already known.
- Bold figures miss their target.
"""


@dataclass(frozen=True)
class Section:
    """A section of the page: its title, the command that measures it, the version of candata, and its blocks."""

    title: str
    command: str
    version: str
    blocks: tuple[dict[str, Any], ...]

    def records(self) -> list[dict[str, Any]]:
        """Return all records of the section, in order."""
        return [record for block in self.blocks for record in block.get("records", [])]


def sections() -> list[Section]:
    """Return the sections in the order of their files."""
    files = sorted(RESULTS.glob("*.json"))
    return [Section(**json.loads(path.read_text(encoding="utf-8"))) for path in files]


def page() -> str:
    """Return the text of docs/measured.md."""
    parts = [OPENING, "## Misses\n", table(("what", "measured", "target"), misses()), ""]
    for section in sections():
        parts += [f"## {section.title}\n", f"{provenance(section)}\n"]
        for block in section.blocks:
            parts += [f"{text}\n" for text in block_texts(block)]
    return "\n".join(parts).rstrip() + "\n"


def provenance(section: Section) -> str:
    """Return how and when a section was measured."""
    dates = sorted({record["date"] for record in section.records()})
    days = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    own = (
        ", unless a table or row names another command"
        if any("command" in record for record in section.records())
        else ""
    )
    return f"Measured by `{section.command}`{own}; candata {section.version}, {days}."


def block_texts(block: dict[str, Any]) -> Iterator[str]:
    """Yield the Markdown of a block: a heading, a note, or a table of records."""
    if "heading" in block:
        yield f"### {block['heading']}"
    if "note" in block:
        yield block["note"]
    if "records" in block:
        columns, commands = tuple(block["columns"]), [record.get("command", "") for record in block["records"]]
        rows = [row(record, columns) for record in block["records"]]
        if len(set(commands)) == 1:
            yield from (f"Measured by {code(command)}." for command in set(commands) if command)
            yield table(columns, rows)
        else:
            with_commands = [(*cells, code(command)) for cells, command in zip(rows, commands, strict=True)]
            yield table((*columns, "command"), with_commands)


def row(record: dict[str, Any], columns: tuple[str, ...]) -> tuple[str, ...]:
    """Return the cells of a record under the columns of its table."""
    values = record["values"] if "values" in record else {columns[1]: result(record)}
    target = {"target": record.get("target", "")} if columns[-1] == "target" else {}
    shown = {**values, **target}
    return (record["measure"], *(shown.get(column, "") for column in columns[1:]))


def result(record: dict[str, Any]) -> str:
    """Return the value of a record (of its first column) with its interval, bold if it misses its target."""
    value = str(next(iter(record["values"].values())) if "values" in record else record["value"])
    if record.get("missed") and "**" not in value:
        value = f"**{value}**"
    return f"{value} ({record['interval']})" if "interval" in record else value


def misses() -> list[tuple[str, ...]]:
    """Return a row for each record that misses its target."""
    missed = [record for section in sections() for record in section.records() if record.get("missed")]
    return [
        (
            record["missed"] if isinstance(record["missed"], str) else record["measure"],
            result(record),
            record.get("target", ""),
        )
        for record in missed
    ]


def headlines() -> str:
    """Return the table of README: evidence by kind, each with its target and its command; repeats are left empty."""
    rows = [
        (
            GROUPS[record["headline"]["group"]],
            f"**missed:** {record['headline']['question']}" if record.get("missed") else record["headline"]["question"],
            headline_value(record),
            record.get("target", ""),
            code(record.get("command", section.command)),
        )
        for group in GROUPS
        for section in sections()
        for record in section.records()
        if record.get("headline", {}).get("group") == group
    ]
    shown = [
        tuple("" if column in (0, 4) and cell == above[column] else cell for column, cell in enumerate(cells))
        for above, cells in pairwise([("",) * 5, *rows])
    ]
    return table(("evidence", "question", "result", "target", "command"), shown)


def headline_value(record: dict[str, Any]) -> str:
    """Return what README shows of a record: what its headline says, else its value."""
    headline = record["headline"]
    if "value" in headline:
        return str(headline["value"])
    if "columns" in headline:
        return " / ".join(record["values"][column] for column in headline["columns"])
    return result(record)


def readme(text: str) -> str:
    """Return the text of README with its table written anew."""
    before, rest = text.split(BEGIN, 1)
    return f"{before}{BEGIN}\n{headlines()}\n{END}{rest.split(END, 1)[1]}"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(re.sub(r"(?<=\|)  (?=\|)", " ", f"| {' | '.join(cells)} |") for cells in lines)


def code(text: str) -> str:
    """Return a command as code; nothing stays nothing."""
    return f"`{text}`" if text else ""


def add_draw(bench: dict[str, Any], draw: str, date: str) -> None:
    """Put the rows of a `bench.json` into the self-check as its first column, and keep the earlier draws."""
    section = json.loads(SELF_CHECK.read_text(encoding="utf-8"))
    block = next(block for block in section["blocks"] if "records" in block)
    block["columns"].insert(1, draw)
    records = {record["measure"]: record for record in block["records"]}
    for measured in bench["rows"]:
        if measured["value"] is None:
            continue
        record = records.get(measured["measure"])
        if record is None:
            record = {"measure": measured["measure"], "values": {}}
            block["records"].append(record)
        record["values"] = {draw: bench_value(measured), **record["values"]}
        record["date"] = date
        if target := bench_target(measured):
            record["target"] = target
        if is_missed(measured):
            record["missed"] = True
        else:
            record.pop("missed", None)
    SELF_CHECK.write_text(json.dumps(section, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def bench_value(measured: dict[str, Any]) -> str:
    """Return the value of a row of `bench.json`, bold if it misses its target."""
    unit = f" {measured['unit']}" if measured["unit"] else ""
    digits = {"%": 1, "s": 0}.get(measured["unit"], 3)
    text = f"{measured['value']:.{digits}f}{unit}"
    return f"**{text}**" if is_missed(measured) else text


def bench_target(measured: dict[str, Any]) -> str:
    """Return the target of a row of `bench.json` in words."""
    low, high, unit = measured["low"], measured["high"], f" {measured['unit']}" if measured["unit"] else ""
    if low is not None and high is not None:
        return f"{low:g}{unit} to {high:g}{unit}"
    return f"at least {low:g}{unit}" if low is not None else f"at most {high:g}{unit}" if high is not None else ""


def is_missed(measured: dict[str, Any]) -> bool:
    """Tell whether a row of `bench.json` misses its target."""
    value, low, high = measured["value"], measured["low"], measured["high"]
    return (low is not None and value < low) or (high is not None and value > high)


def main() -> None:
    """Read the arguments and write the page and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.json of candata gap bench")
    parser.add_argument("--draw", default="new draw", help="the name of its column")
    parser.add_argument("--date", default="", help="the day of the draw, as 2026-11-30")
    arguments = parser.parse_args()
    if arguments.bench:
        if not re.fullmatch(r"\d{4}-\d{2}-\d{2}", arguments.date):
            parser.error("--bench needs --date, such as 2026-11-30")
        add_draw(json.loads(arguments.bench.read_text(encoding="utf-8")), arguments.draw, arguments.date)
    PAGE.write_text(page(), encoding="utf-8")
    README.write_text(readme(README.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
