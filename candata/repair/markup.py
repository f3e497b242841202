"""MJCF as text: where each element stands, and how to change its attributes and nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from candata.errors import SceneError, Where

_START = re.compile(rb"<[^\s/>]+(?:\s+[^\s=/>]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*\s*(/?)>")


@dataclass
class Node:
    """One element of an MJCF file, includes resolved.

    Attributes
    ----------
    tag, attributes
        As written.
    file : Path
        The file in which it stands.
    start, end : int
        Byte offsets of its start tag, from `<` to after `>`.
    close : int
        Byte offset of its end tag; `start` for one that closes itself.
    line : int
        Line of the start tag, from 1.
    children : list of Node
        With the children of included files in place of the include.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    end: int
    close: int
    line: int
    children: list[Node] = field(default_factory=list)

    def each(self, tag: str) -> Iterator[Node]:
        """Yield the children called `tag`."""
        return (child for child in self.children if child.tag == tag)


@dataclass(frozen=True)
class Edit:
    """What changes at one element: attributes set (None: removed), another tag, or text put inside at its start.

    `before_end` puts the text before the end tag instead.
    """

    node: Node
    attributes: Mapping[str, str | None] = field(default_factory=dict)
    tag: str | None = None
    inside: str = ""
    before_end: bool = False


def parse(main: Path) -> Node:
    """Return the root of an MJCF file with its includes in place.

    Raises
    ------
    SceneError
        When a file is no XML that can be edited as text, or an included file is missing.
    """
    return _parsed(main, main.parent)


def _parsed(path: Path, base: Path) -> Node:
    """Return the root of one file; included paths are relative to the main file, else to this one."""
    try:
        raw = path.read_bytes()
        root = _tree(raw, path)
    except (OSError, expat.ExpatError) as error:
        raise SceneError(f"{path.name} cannot be read as XML: {error}", where=Where(path=str(path))) from None
    _include(root, base)
    return root


def _include(node: Node, base: Path) -> None:
    """Replace includes by the children of what they name."""
    children: list[Node] = []
    for child in node.children:
        _include(child, base)
        if child.tag != "include":
            children.append(child)
            continue
        name = child.attributes.get("file", "")
        at = base / name if (base / name).is_file() else child.file.parent / name
        children += _parsed(at, base).children
    node.children = children


def _tree(raw: bytes, path: Path) -> Node:
    """Return the elements of one file with their places."""
    parser = expat.ParserCreate()
    stack: list[Node] = []
    roots: list[Node] = []

    def opened(tag: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        found = _START.match(raw, start)
        if found is None:
            raise SceneError(f"a tag of {path.name} cannot be edited as text", where=Where(path=str(path)))
        node = Node(tag, attributes, path, start, found.end(), start, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(node)
        stack.append(node)

    def closed(tag: str) -> None:
        node = stack.pop()
        if not raw[node.start : node.end].endswith(b"/>"):
            node.close = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.Parse(raw, True)
    return roots[0]


def edited(edits: Sequence[Edit]) -> dict[Path, bytes]:
    """Return the new bytes of each file that changes; all else stays byte by byte.

    Raises
    ------
    SceneError
        When text is to go inside an element that closes itself.
    """
    changes: dict[Path, list[tuple[int, int, bytes]]] = {}
    for edit in merged(edits):
        changes.setdefault(edit.node.file, []).extend(_spans(edit))
    out = {}
    for path, spans in changes.items():
        raw = path.read_bytes()
        for start, end, text in sorted(spans, reverse=True):
            raw = raw[:start] + text + raw[end:]
        out[path] = raw
    return out


def merged(edits: Sequence[Edit]) -> list[Edit]:
    """Return the edits, those of one element as one."""
    out: dict[int, Edit] = {}
    for edit in edits:
        before = out.get(id(edit.node), Edit(edit.node))
        out[id(edit.node)] = Edit(
            edit.node,
            {**before.attributes, **edit.attributes},
            edit.tag or before.tag,
            before.inside + edit.inside,
            edit.before_end or before.before_end,
        )
    return list(out.values())


def _spans(edit: Edit) -> list[tuple[int, int, bytes]]:
    """Return the byte ranges that an edit replaces, and by what."""
    node, raw = edit.node, edit.node.file.read_bytes()
    tag = raw[node.start : node.end]
    text = tag
    for name, value in edit.attributes.items():
        text = _with(text, name, value)
    spans = []
    if edit.tag is not None:
        text = b"<" + edit.tag.encode() + text[1 + len(node.tag.encode()) :]
        if node.close != node.start:
            spans.append((node.close + 2, node.close + 2 + len(node.tag.encode()), edit.tag.encode()))
    if edit.inside:
        if node.close == node.start:
            raise SceneError(f"<{node.tag}> of {node.file.name} has no room for a child", where=at(node))
        spans.append(_inside(edit, raw))
    if text != tag:
        spans.append((node.start, node.end, text))
    return spans


def _inside(edit: Edit, raw: bytes) -> tuple[int, int, bytes]:
    """Return the place of new text inside an element, indented as its neighbours are."""
    node = edit.node
    if edit.before_end:
        return node.close, node.close, edit.inside.encode() + b"\n"
    first = re.match(rb"\s*\n([ \t]*)<", raw[node.end :])
    if first is None:
        return node.end, node.end, edit.inside.encode()
    return node.end, node.end, b"\n" + first.group(1) + edit.inside.encode()


def _with(tag: bytes, name: str, value: str | None) -> bytes:
    """Return a start tag with one attribute set, appended or removed."""
    found = re.search(rb"\s+" + re.escape(name.encode()) + rb"\s*=\s*(\"[^\"]*\"|'[^']*')", tag)
    if found is not None:
        if value is None:
            return tag[: found.start()] + tag[found.end() :]
        start, end = found.span(1)
        return tag[:start] + f'"{value}"'.encode() + tag[end:]
    if value is None:
        return tag
    close = 2 if tag.endswith(b"/>") else 1
    head = tag[:-close].rstrip()
    return head + f' {name}="{value}"'.encode() + tag[len(head) :]


def at(node: Node) -> Where:
    """Return the place of an element for an error."""
    return Where(path=f"{node.file}:{node.line}")
