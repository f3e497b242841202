"""Meshes of objects: read within bounds, checked for what spoils a simulation, and written again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.lfs import refuse_pointer
from candata.scenes.named_files import kind_of

#: Endings of files that are meshes.
ENDINGS = (".obj", ".stl", ".ply")
#: Triangles of a mesh: as many as MuJoCo reads (XML reference, "asset/mesh").
MOST_FACES = 200_000
#: Size of a mesh file [bytes]. Chosen: 200,000 triangles as STL text are 50 MB.
LARGEST_BYTES = 1 << 26
#: Largest side of an object's box [m]: what a hand handles is between the two; a mesh in millimetres is above.
MOST_EXTENT_M, LEAST_EXTENT_M = 2.0, 0.002
#: Volume of a mesh over that of its box: below it is flat, and MuJoCo makes no hull of it.
LEAST_FILL = 1e-6


@dataclass(frozen=True)
class CheckedMesh:
    """A mesh that can be simulated.

    Attributes
    ----------
    surface : trimesh.Trimesh
        Its triangles [m], corners merged, normals outward where it is closed.
    is_closed : bool
        Whether each edge belongs to two triangles that turn the same way, so that it bounds a volume.
    was_inside_out : bool
        Whether its normals pointed inward and were turned.
    hull : trimesh.Trimesh
        Its convex hull.
    """

    surface: trimesh.Trimesh
    is_closed: bool
    was_inside_out: bool
    hull: trimesh.Trimesh

    @property
    def fill(self) -> float:
        """Share of the hull's volume that the mesh fills; of an open mesh not known, and nan."""
        return float(self.surface.volume / self.hull.volume) if self.is_closed else float("nan")


def read_mesh(path: Path, scale: float = 1.0) -> CheckedMesh:
    """Return the mesh of an OBJ, STL or PLY file, multiplied by `scale` into metres.

    Raises
    ------
    DataError
        When it is no such file, cannot be read, has no or too many triangles, numbers that are none, no volume, a size
        that no object in a hand has, or triangles of which neighbours face opposite ways.
    """
    vertices, faces = _triangles(path)
    where = Where(path=str(path))
    if not len(faces):
        raise DataError(
            f"mesh {path.name} is empty", expected="triangles", found="none", where=where, fix="export it again"
        )
    _refuse_many(path, len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(
            f"mesh {path.name} has a triangle without a corner",
            expected=f"corners 0 to {len(vertices) - 1}",
            found=f"{faces.min()} to {faces.max()}",
            where=where,
            fix="export it again",
        )
    if not np.isfinite(vertices).all():
        raise DataError(f"mesh {path.name} has corners that are no numbers", where=where, fix="export it again")
    used_corners = vertices[np.unique(faces)] * scale
    _check_extent(path, float(np.max(np.ptp(used_corners, axis=0))))
    surface = trimesh.Trimesh(vertices * scale, faces, process=True)
    is_closed = bool(surface.is_watertight)
    if is_closed and not surface.is_winding_consistent:
        raise DataError(
            f"mesh {path.name} has neighbouring triangles that face opposite ways",
            expected="normals that all point outward",
            where=where,
            fix="let your mesh program recalculate them (Blender: Mesh, Normals, Recalculate Outside)",
        )
    was_inside_out = is_closed and float(surface.volume) < 0
    if was_inside_out:
        surface.invert()
    return CheckedMesh(surface, is_closed, was_inside_out, _hull(path, surface))


def _triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the corners `(V, 3)` and the triangles `(F, 3)` of a file; materials and what they name are not read."""
    where = Where(path=str(path))
    if path.suffix.lower() not in ENDINGS:
        raise DataError(f"{path.name} is no mesh", expected=f"a file that ends in {', '.join(ENDINGS)}", where=where)
    if not path.is_file():
        raise DataError(f"mesh {path.name} is {kind_of(path) or 'not there'}", expected="a file", where=where)
    refuse_pointer(path)
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise _too_many(path, f"a file of {size:,} bytes", f"at most {LARGEST_BYTES:,} bytes")
    try:
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type=path.suffix[1:].lower(), process=False, skip_materials=True)
        return np.asarray(mesh.vertices, float).reshape(-1, 3), np.asarray(mesh.faces, int).reshape(-1, 3)
    except Exception as error:  # the readers of three formats raise of everything
        text = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"mesh {path.name} cannot be read", found=text, where=where, fix="export it again") from None


def _refuse_many(path: Path, faces: int) -> None:
    """Refuse more triangles than MuJoCo reads."""
    if faces > MOST_FACES:
        raise _too_many(path, f"{faces:,} triangles", f"at most {MOST_FACES:,} triangles")


def _too_many(path: Path, found: str, expected: str) -> DataError:
    """Return the error of a mesh that is too fine."""
    return DataError(
        f"mesh {path.name} is too fine to simulate",
        expected=expected,
        found=found,
        where=Where(path=str(path)),
        fix="reduce it in your mesh program (Blender: Decimate); a few thousand triangles show any object",
    )


def _check_extent(path: Path, largest_m: float) -> None:
    """Refuse a largest side that no object in a hand has: the mesh is in another unit."""
    if LEAST_EXTENT_M <= largest_m <= MOST_EXTENT_M:
        return
    if largest_m > MOST_EXTENT_M:
        unit = f"in millimetres it would be {largest_m / 1000:.3g} m: --scale 0.001; in centimetres: --scale 0.01"
    else:
        unit = "give the factor that makes metres of its numbers: --scale NUMBER"
    raise DataError(
        f"mesh {path.name} has the size of no object in a hand",
        expected=f"metres, a largest side of {LEAST_EXTENT_M:g} to {MOST_EXTENT_M:g} m",
        found=f"{largest_m:.4g} m",
        where=Where(path=str(path)),
        fix=unit,
    )


def _hull(path: Path, surface: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the convex hull of a mesh.

    Raises
    ------
    DataError
        When the mesh is flat.
    """
    try:
        hull = surface.convex_hull
    except Exception:  # Qhull's own error, which no public name has
        hull = None
    if hull is None or hull.volume < LEAST_FILL * float(np.max(surface.extents)) ** 3:
        raise DataError(
            f"mesh {path.name} is flat",
            expected="an object with a volume",
            where=Where(path=str(path)),
            fix="give it a thickness",
        )
    return hull


def obj_text(mesh: trimesh.Trimesh) -> str:
    """Return a mesh as OBJ text: corners and triangles, no more."""
    corners = (f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist())
    triangles = (f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in mesh.faces.tolist())
    return "".join([*corners, *triangles])
