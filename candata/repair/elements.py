"""Which element of an MJCF text is which object of the compiled model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco

from candata.repair.markup import Node

#: (kind, id in the compiled model); ids of an option or a root are 0.
Key = tuple[str, int]
#: Elements that make others: what they make has no text of its own.
_MAKERS = frozenset({"replicate", "composite", "flexcomp", "attach"})
_JOINTS = ("joint", "freejoint")


def located(spec: mujoco.MjSpec, root: Node) -> dict[Key, Node]:
    """Return where the objects of a compiled spec stand in its text; what cannot be told apart is left out.

    Named elements are found by name, others by their order within the body.
    """
    found: dict[Key, Node] = {}
    world = [child for section in root.each("worldbody") for child in section.children]
    _body(spec.worldbody, world, found)
    for kind, section, things in (
        ("actuator", "actuator", spec.actuators),
        ("pair", "contact", spec.pairs),
        ("mesh", "asset", spec.meshes),
    ):
        nodes = [n for part in root.each(section) for n in part.children if kind == "actuator" or n.tag == kind]
        _match(kind, things, nodes, found)
    return found


def _body(body: mujoco.MjsBody, children: Sequence[Node], found: dict[Key, Node]) -> None:
    """Add what stands in one body, and in those it carries."""
    inner = list(_framed(children))
    ordered = not any(n.tag in _MAKERS for n in inner)
    for kind, things, tags in (
        ("geom", body.geoms, ("geom",)),
        ("joint", body.joints, _JOINTS),
        ("site", body.sites, ("site",)),
        ("body", body.bodies, ("body",)),
    ):
        nodes = [n for n in inner if n.tag in tags]
        _match(kind, things, nodes, found, ordered)
    for child in body.bodies:
        node = found.get(("body", child.id))
        if node is not None:
            _body(child, node.children, found)


def _framed(children: Iterable[Node]) -> Iterator[Node]:
    """Yield elements of a body, those in frames in place of the frame."""
    for child in children:
        if child.tag == "frame":
            yield from _framed(child.children)
        else:
            yield child


def _match(kind: str, things: Sequence[Any], nodes: Sequence[Node], found: dict[Key, Node], ordered: bool = True):
    """Pair objects and elements: by order where the counts agree, else by name."""
    if ordered and len(things) == len(nodes):
        found |= {(kind, thing.id): node for thing, node in zip(things, nodes, strict=True)}
        return
    by_name = {_name(node): node for node in nodes}
    found |= {(kind, thing.id): by_name[thing.name] for thing in things if thing.name in by_name}


def _name(node: Node) -> str | None:
    """Return the name of an element; a mesh without one bears its file's."""
    if node.tag == "mesh" and "name" not in node.attributes:
        return Path(node.attributes.get("file", "")).stem
    return node.attributes.get("name")
