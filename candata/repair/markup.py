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
    end_tag: int
    line: int
    children: list[Node] = field(default_factory=list)

    def children_of_tag(self, tag: str) -> Iterator[Node]:
        """Yield the children called `tag`."""
        return (child for child in self.children if child.tag == tag)


@dataclass(frozen=True)
class Edit:
    """The changes at one element: attributes set (None: removed), another tag, or text put inside at its start.

    `before_end` puts the text before the end tag instead.
    """

    node: Node
    attributes: Mapping[str, str | None] = field(default_factory=dict)
    tag: str | None = None
    inner_text: str = ""
    before_end: bool = False


def parse(main_file: Path) -> Node:
    """Return the root of an MJCF file with its includes in place.

    Raises
    ------
    SceneError
        When a file is no XML that can be edited as text, or an included file is missing.
    """
    return _parse_file(main_file, main_file.parent)


def _parse_file(path: Path, base: Path) -> Node:
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
        children += _parse_file(at, base).children
    node.children = children


def _tree(raw: bytes, path: Path) -> Node:
    """Return the elements of one file with their places."""
    parser = expat.ParserCreate()
    stack: list[Node] = []
    roots: list[Node] = []

    def on_start(tag: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        match = _START.match(raw, start)
        if match is None:
            raise SceneError(f"a tag of {path.name} cannot be edited as text", where=Where(path=str(path)))
        node = Node(tag, attributes, path, start, match.end(), start, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(node)
        stack.append(node)

    def on_end(tag: str) -> None:
        node = stack.pop()
        if not raw[node.start : node.end].endswith(b"/>"):
            node.end_tag = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = on_start, on_end
    parser.Parse(raw, True)
    return roots[0]


def edited_files(edits: Sequence[Edit]) -> dict[Path, bytes]:
    """Return the new bytes of each file that changes; all else stays byte by byte.

    Raises
    ------
    SceneError
        When text is to go inside an element that closes itself.
    """
    changes: dict[Path, list[tuple[int, int, bytes]]] = {}
    for edit in merge_edits(edits):
        changes.setdefault(edit.node.file, []).extend(_spans(edit))
    out = {}
    for path, spans in changes.items():
        raw = path.read_bytes()
        for start, end, text in sorted(spans, reverse=True):
            raw = raw[:start] + text + raw[end:]
        out[path] = raw
    return out


def merge_edits(edits: Sequence[Edit]) -> list[Edit]:
    """Return the edits, those of one element as one."""
    out: dict[int, Edit] = {}
    for edit in edits:
        previous = out.get(id(edit.node), Edit(edit.node))
        out[id(edit.node)] = Edit(
            edit.node,
            {**previous.attributes, **edit.attributes},
            edit.tag or previous.tag,
            previous.inner_text + edit.inner_text,
            edit.before_end or previous.before_end,
        )
    return list(out.values())


def _spans(edit: Edit) -> list[tuple[int, int, bytes]]:
    """Return the byte ranges that an edit replaces, and by what."""
    node, raw = edit.node, edit.node.file.read_bytes()
    tag = raw[node.start : node.end]
    text = tag
    for name, value in edit.attributes.items():
        text = _set_attribute(text, name, value)
    spans = []
    if edit.tag is not None:
        text = b"<" + edit.tag.encode() + text[1 + len(node.tag.encode()) :]
        if node.end_tag != node.start:
            spans.append((node.end_tag + 2, node.end_tag + 2 + len(node.tag.encode()), edit.tag.encode()))
    if edit.inner_text:
        if node.end_tag == node.start:
            raise SceneError(f"<{node.tag}> of {node.file.name} has no room for a child", where=at(node))
        spans.append(_insertion(edit, raw))
    if text != tag:
        spans.append((node.start, node.end, text))
    return spans


def _insertion(edit: Edit, raw: bytes) -> tuple[int, int, bytes]:
    """Return the place of new text inside an element, indented as its neighbours are."""
    node = edit.node
    if edit.before_end:
        return node.end_tag, node.end_tag, edit.inner_text.encode() + b"\n"
    first_child = re.match(rb"\s*\n([ \t]*)<", raw[node.end :])
    if first_child is None:
        return node.end, node.end, edit.inner_text.encode()
    return node.end, node.end, b"\n" + first_child.group(1) + edit.inner_text.encode()


def _set_attribute(tag: bytes, name: str, value: str | None) -> bytes:
    """Return a start tag with one attribute set, appended or removed."""
    match = re.search(rb"\s+" + re.escape(name.encode()) + rb"\s*=\s*(\"[^\"]*\"|'[^']*')", tag)
    if match is not None:
        if value is None:
            return tag[: match.start()] + tag[match.end() :]
        start, end = match.span(1)
        return tag[:start] + f'"{value}"'.encode() + tag[end:]
    if value is None:
        return tag
    tail_length = 2 if tag.endswith(b"/>") else 1
    head = tag[:-tail_length].rstrip()
    return head + f' {name}="{value}"'.encode() + tag[len(head) :]


def at(node: Node) -> Where:
    """Return the place of an element for an error."""
    return Where(path=f"{node.file}:{node.line}")
