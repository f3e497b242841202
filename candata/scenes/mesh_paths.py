"""Mesh paths as ROS and Gazebo write them, found in the folders of the URDF: `package://`, `model://`, `file://`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import mujoco

from candata.errors import SceneError, Where

_SCHEMES = ("package", "model", "file")
#: Folders of a ROS package that hold its URDFs; meshes lie beside them.
_URDF_FOLDERS = ("urdf", "urdfs", "robot", "robots", "xacro", "model", "models", "description")
#: Marks the top folder of a ROS package.
_MANIFEST = "package.xml"
#: Places that an error names. Chosen.
_MOST_PLACES = 4

#: A file that may be meant, and the folder that it may not lead out of.
Candidate = tuple[Path, Path]


def resolve_meshes(spec: mujoco.MjSpec, urdf: Path) -> None:
    """Set the paths of meshes that name a package, a Gazebo model or a URL to the files that they mean.

    Raises
    ------
    SceneError
        When a file is not found, or found only outside the folder that its path begins in.
    """
    for mesh in spec.meshes:
        if mesh.file.partition("://")[0] in _SCHEMES:
            mesh.file = str(_find_mesh(mesh.file, urdf).absolute())


def _find_mesh(uri: str, urdf: Path) -> Path:
    """Return the file that a mesh's path means."""
    candidate_files = list(dict.fromkeys(candidates(uri, urdf)))
    existing_files = [(file, root) for file, root in candidate_files if file.is_file()]
    for file, root in existing_files:
        if file.resolve().is_relative_to(root.resolve()):
            return file
    places = [str(file) for file, _ in candidate_files]
    more_text = f" and {len(places) - _MOST_PLACES} more places" if len(places) > _MOST_PLACES else ""
    raise SceneError(
        f"mesh {uri} of {urdf.name} is not found",
        expected=f"a file at {', '.join(places[:_MOST_PLACES])}{more_text}",
        found=f"{existing_files[0][0]}, which a link or `..` leads out of {existing_files[0][1]}"
        if existing_files
        else "nothing there",
        where=Where(path=str(urdf)),
        fix=f"copy the file to {_home(uri, urdf)}, or put {urdf.name} into its package",
    )


def _home(uri: str, urdf: Path) -> Path:
    """Return where a mesh would be found."""
    scheme, _, rest = uri.partition("://")
    relative = PurePosixPath(rest) if scheme == "file" else PurePosixPath(rest.partition("/")[2])
    stays_inside = not relative.is_absolute() and ".." not in relative.parts
    return urdf.parent / (relative if stays_inside else relative.name)


def candidates(uri: str, urdf: Path) -> Iterator[Candidate]:
    """Yield what a path with a scheme may mean, the likeliest first."""
    scheme, _, rest = uri.partition("://")
    folders = list(_package_folders(urdf))
    if scheme != "file":
        name, _, relative = rest.partition("/")
        if name not in ("", ".", ".."):
            packages = (parent for start in _starts(urdf) for parent in start.parents if parent.name == name)
            yield from ((parent / relative, parent) for parent in packages)
        yield from ((folder / name / relative, folder) for folder in folders)
        yield from ((folder / relative, folder) for folder in folders)
    elif rest.startswith("/"):
        # A path from the root is read without a scheme too; that of another machine is sought by its end.
        yield Path(rest), Path("/")
        parts = PurePosixPath(rest).parts
        yield from ((folder.joinpath(*parts[k:]), folder) for k in range(2, len(parts)) for folder in folders)
    else:
        yield from ((start.parent / rest, folder) for start in _starts(urdf) for folder in folders)


def _starts(urdf: Path) -> tuple[Path, ...]:
    """Return where a URDF lies: as it is named, and where a link leads."""
    return tuple(dict.fromkeys((urdf.absolute(), urdf.resolve())))


def _package_folders(urdf: Path) -> Iterator[Path]:
    """Yield the folders that hold a URDF and its meshes: its own, and the top of the package that it lies in."""
    for start in _starts(urdf):
        yield start.parent
        if start.parent.name in _URDF_FOLDERS:
            yield start.parent.parent
        yield from [parent for parent in start.parents if (parent / _MANIFEST).is_file()][:1]
