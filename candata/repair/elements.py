"""The elements of an MJCF text that belong to the objects of the compiled model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco

from candata.repair.markup import Node

#: (kind, id in the compiled model); ids of an option or a root are 0.
Key = tuple[str, int]
#: Elements that make others, which have no text of their own.
_MAKERS = frozenset({"replicate", "composite", "flexcomp", "attach"})
_JOINTS = ("joint", "freejoint")


def locate_elements(spec: mujoco.MjSpec, root: Node) -> dict[Key, Node]:
    """Return the text element of each object of a compiled spec; objects that cannot be told apart are left out.

    Named elements are found by name, others by their order within the body.
    """
    node_of: dict[Key, Node] = {}
    world = [child for section in root.children_of_tag("worldbody") for child in section.children]
    _body(spec.worldbody, world, node_of)
    for kind, section, objects in (
        ("actuator", "actuator", spec.actuators),
        ("pair", "contact", spec.pairs),
        ("mesh", "asset", spec.meshes),
    ):
        nodes = [
            n for part in root.children_of_tag(section) for n in part.children if kind == "actuator" or n.tag == kind
        ]
        _match(kind, objects, nodes, node_of)
    return node_of


def _body(body: mujoco.MjsBody, children: Sequence[Node], node_of: dict[Key, Node]) -> None:
    """Add the elements of one body, and of those it carries."""
    inner = list(_flatten_frames(children))
    is_ordered = not any(n.tag in _MAKERS for n in inner)
    for kind, objects, tags in (
        ("geom", body.geoms, ("geom",)),
        ("joint", body.joints, _JOINTS),
        ("site", body.sites, ("site",)),
        ("body", body.bodies, ("body",)),
    ):
        nodes = [n for n in inner if n.tag in tags]
        _match(kind, objects, nodes, node_of, is_ordered)
    for child in body.bodies:
        node = node_of.get(("body", child.id))
        if node is not None:
            _body(child, node.children, node_of)


def _flatten_frames(children: Iterable[Node]) -> Iterator[Node]:
    """Yield elements of a body, those in frames in place of the frame."""
    for child in children:
        if child.tag == "frame":
            yield from _flatten_frames(child.children)
        else:
            yield child


def _match(kind: str, objects: Sequence[Any], nodes: Sequence[Node], node_of: dict[Key, Node], is_ordered: bool = True):
    """Pair objects and elements: by order where the counts agree, else by name."""
    if is_ordered and len(objects) == len(nodes):
        node_of |= {(kind, obj.id): node for obj, node in zip(objects, nodes, strict=True)}
        return
    by_name = {_name(node): node for node in nodes}
    node_of |= {(kind, obj.id): by_name[obj.name] for obj in objects if obj.name in by_name}


def _name(node: Node) -> str | None:
    """Return the name of an element; a mesh without one bears its file's."""
    if node.tag == "mesh" and "name" not in node.attributes:
        return Path(node.attributes.get("file", "")).stem
    return node.attributes.get("name")
