"""Convex pieces of an object: its hull where it fills it, else a decomposition by CoACD where that is installed."""

from __future__ import annotations

from collections.abc import Callable

import trimesh

from candata.scenes.object_mesh import CheckedMesh

#: Share of its hull that a mesh must fill for the hull to stand for it.
CONVEX_FILL = 0.9
#: Most pieces of a decomposition, and corners of each: as in the prepared YCB objects.
MOST_PARTS, MOST_CORNERS = 8, 64
#: Concavity at which CoACD stops cutting: its default (Wei, Liu, Ling, Su, "Approximate Convex Decomposition for 3D
#: Meshes with Collision-Aware Concavity and Tree Search", SIGGRAPH 2022).
CONCAVITY = 0.05


def convex_pieces(mesh: CheckedMesh, name: str, say: Callable[[str], None]) -> tuple[list[trimesh.Trimesh], str | None]:
    """Return convex pieces that stand for a mesh, and what to warn of; None for nothing.

    Parameters
    ----------
    mesh : CheckedMesh
        The mesh; of an open one it is not known how much of its hull it fills.
    name : str
        Name of the object, for the warning.
    say : callable
        Takes a line where the work takes a minute.
    """
    if mesh.fill >= CONVEX_FILL:
        return [mesh.hull], None
    try:
        import coacd
    except ImportError:
        share = f"fills {mesh.fill:.0%} of its convex hull" if mesh.is_closed else "is open, and may be hollow"
        return [mesh.hull], (
            f"{name} {share}, which alone touches other bodies: its hollows are filled; for convex pieces: "
            'pip install "candata[objects]", or put convex_0.stl, convex_1.stl, ... beside visual.obj'
        )
    say(f"cutting {name} into convex pieces, which takes a minute")
    coacd.set_log_level("off")
    parts = coacd.run_coacd(
        coacd.Mesh(mesh.surface.vertices, mesh.surface.faces),
        threshold=CONCAVITY,
        max_convex_hull=MOST_PARTS,
        max_ch_vertex=MOST_CORNERS,
        decimate=True,
        seed=0,
    )
    return [trimesh.Trimesh(vertices, faces).convex_hull for vertices, faces in parts], None
