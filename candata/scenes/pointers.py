"""Git LFS pointers among the files of a scene: the model, what it includes, the meshes and pictures that it names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from candata.lfs import refuse_pointer

#: Attributes of MJCF and URDF that name a file (`file`, `filename`, `fileright`, ...), and those that name a folder.
_FILES = re.compile(r"""\bfile[a-z]*\s*=\s*["']([^"']+)["']""")
_FOLDERS = re.compile(r"""\b(?:mesh|texture|asset)dir\s*=\s*["']([^"']+)["']""")
#: A model is text; one that is larger is looked into no further.
_LARGEST_MODEL_BYTES = 1 << 26


def refuse_pointers(source: Path) -> None:
    """Raise if a model, or a file that it names, is a Git LFS pointer, which MuJoCo would call a damaged mesh.

    Raises
    ------
    DataError
        Names the file, and says how to get it.
    """
    visited_paths: set[Path] = set()
    stack = [source]
    while stack:
        path = stack.pop()
        if path in visited_paths:
            continue
        visited_paths.add(path)
        refuse_pointer(path)
        if path.suffix.lower() in (".xml", ".urdf") and path.stat().st_size <= _LARGEST_MODEL_BYTES:
            stack += _named_files(path.read_text(encoding="utf-8", errors="replace"), source.parent)


def _named_files(text: str, folder: Path) -> Iterator[Path]:
    """Yield the files that a model names and that are there, wherever below its folders they may be meant to lie."""
    folders = ["", *_FOLDERS.findall(text)]
    for name in _FILES.findall(text):
        package, _, relative = name.rpartition("://")
        parts = PurePosixPath(relative).parts
        tails = [PurePosixPath(*parts[k:]) for k in range(len(parts))]
        bases = [base / part for base in [folder, *folder.parents][: 1 + 3 * bool(package)] for part in folders]
        yield from (path for base in bases for tail in tails if (path := base / tail).is_file())
