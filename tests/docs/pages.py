"""The documents as the tests read them: pages, fenced examples, named commands, headings and links."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from candata_cli.main import build

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
DECISIONS = sorted((ROOT / "docs/decisions").glob("*.md"))
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if path not in DECISIONS)
NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *PAGES, *DECISIONS, *ROOT.glob("examples/**/*.md")])
#: What describes candata as it is; a changelog may name what is gone.
PRESENT = [path for path in DOCUMENTS if path.name != "CHANGELOG.md"]

#: A tag, where there is one, above a fenced block.
FENCE = re.compile(r"^(?:<!-- (?P<tag>[^\n]*?) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
#: `test: NAME [slow] [as FILE]`: runs, or is written to a file; `not run: REASON`: cannot run here.
TAG = re.compile(r"test: (?P<name>\w+)(?P<slow> slow)?(?: as (?P<file>[\w./-]+))?$")
NOT_RUN = re.compile(r"not run: \S.*")
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
LINK = re.compile(r"\]\((?!https?:)(?P<path>[^)#\s]*)(?:#(?P<anchor>[^)\s]+))?\)")
HEADING = re.compile(r"^(?P<level>#{1,6}) (?P<text>.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and what the comment above it says."""

    kind: str
    text: str
    tag: str

    @property
    def test(self) -> re.Match[str] | None:
        """The parts of its tag where it is an example that runs."""
        return TAG.fullmatch(self.tag)


def read(path: Path) -> str:
    """Return the text of a document."""
    return path.read_text(encoding="utf-8")


def blocks(path: Path) -> list[Block]:
    """Return the fenced blocks of a document in order."""
    return [Block(m["kind"], m["text"], m["tag"] or "") for m in FENCE.finditer(read(path))]


def prose(path: Path) -> str:
    """Return the text of a document without its fenced blocks."""
    return FENCE.sub("", read(path))


def examples() -> dict[tuple[Path, str], list[Block]]:
    """Return the blocks that run, in order, by document and name: blocks of one name share a folder."""
    named: dict[tuple[Path, str], list[Block]] = {}
    for path in DOCUMENTS:
        for block in blocks(path):
            if block.test:
                named.setdefault((path, block.test["name"]), []).append(block)
    return named


def anchors(path: Path) -> set[str]:
    """Return the anchors that a site makes of the headings of a document."""
    titles = [re.sub(r"[`*]|\]\([^)]*\)|\[", "", m["text"]).strip().lower() for m in HEADING.finditer(prose(path))]
    return {re.sub(r"[^\w\- ]", "", title).replace(" ", "-") for title in titles}


def application() -> Any:
    """Return the command line with every command's options read."""
    return typer.main.get_command(build())


def children(command: Any) -> dict[str, Any]:
    """Return the commands of a group by name; none where it is a command that runs."""
    return getattr(command, "commands", {})


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every command that runs."""
    for name, child in children(command).items():
        yield from leaves(child, (*path, name))
    if not children(command):
        yield path


def options_of(command: Any) -> set[str]:
    """Return the options of one command."""
    named = {opt for param in command.params for opt in [*param.opts, *param.secondary_opts]}
    return {opt for opt in named if opt.startswith("-")} | {"--help", "-h"}


def all_options(command: Any) -> set[str]:
    """Return the options of a command and of all below it."""
    return options_of(command).union(*map(all_options, children(command).values()))


def commands_in(shell: str) -> Iterator[list[str]]:
    """Yield the words of each `candata` command in shell text."""
    for line in shell.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.commenters = "#"
        words: list[str] = []
        for token in [*lexer, ";"]:
            if set(token) <= set("();<>|&"):
                if "candata" in words:
                    yield words[words.index("candata") + 1 :]
                words = []
            else:
                words.append(token)


def mistakes(words: list[str], command: Any) -> list[str]:
    """Return what a command names that the command line does not have."""
    rest = list(words)
    while children(command) and rest and not rest[0].startswith("-"):
        name = rest.pop(0)
        if name not in children(command):
            # A word in capitals, or dots, stands for any of them.
            return [] if name.isupper() or "." in name else [f"no command {name}"]
        command = children(command)[name]
    known = options_of(command)
    return [f"no option {word}" for word in rest if word.startswith("--") and word.split("=")[0] not in known]


def commands_named(path: Path) -> list[list[str]]:
    """Return the words of every `candata` command that a document shows, in examples and between the lines."""
    shown = [block.text for block in blocks(path) if block.kind in ("bash", "sh", "console")]
    inline = [code for code in INLINE.findall(prose(path)) if code.startswith("candata ")]
    return [words for text in [*shown, *inline] for words in commands_in(text)]


def options_named(path: Path) -> set[str]:
    """Return the options that a document names by themselves, between the lines; examples name their scripts' too."""
    if path.is_relative_to(ROOT / "examples"):
        return set()
    return {code.split()[0].split("=")[0] for code in INLINE.findall(prose(path)) if code.startswith("--")}


def table(path: Path, heading: str) -> list[list[str]]:
    """Return the cells of the table whose first header is `heading`, row by row."""
    rows = read(path).split(f"\n| {heading} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def first_column(path: Path, heading: str) -> set[str]:
    """Return the code words in the first column of a table."""
    return {word for row in table(path, heading) for word in re.findall(r"^`([\w./-]+)`", row[0])}
