"""The files that a model consists of: itself, what it includes and attaches, the meshes and pictures that it names."""

from __future__ import annotations

import hashlib
import html
import itertools
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from candata.errors import SceneError, Where
from candata.lfs import refuse_pointer
from candata.scenes.mesh_paths import candidates

#: Attributes of MJCF and URDF that name a file (`file`, `filename`, `fileright`, ...), and those that name a folder.
_FILES = re.compile(rb"""\bfile[a-z]*+\s*+=\s*+(?:"([^"]*+)"|'([^']*+)')""")
_FOLDERS = re.compile(rb"""\b(?:mesh|texture|asset)dir\s*+=\s*+(?:"([^"]*+)"|'([^']*+)')""")
#: Size of an XML file [bytes]. Chosen: the largest robots are some MB; reading 64 MB takes a second.
LARGEST_TEXT_BYTES = 1 << 26
#: Size of all files of a model together [bytes]. Chosen: a second to hash, and a quarter of what a first load may hold.
LARGEST_BYTES = 1 << 30
#: Places where the files that a model names are sought. Chosen: a second to look.
MOST_PLACES = 200_000
#: Files that lead from one to the next. Chosen: parts of parts of parts are three.
MOST_NESTED = 50
#: Kinds of what is no file, by the test that tells them.
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def model_digest(source: Path) -> str:
    """Return the SHA-256 over the names and contents of a model and of every file that it may mean by what it names.

    A name may be meant relative to more than one folder; whatever lies at any such place counts.

    Raises
    ------
    DataError
        When a file is a Git LFS pointer, which MuJoCo would call a damaged mesh.
    SceneError
        When one is a FIFO or a device, or they are more or larger than a simulation holds.
    """
    sums: dict[str, str] = {}
    texts: dict[str, bytes] = {}
    unread_files = [os.path.abspath(source)]
    places = set(unread_files)
    total = rounds = 0
    while unread_files:
        rounds += 1
        if rounds > MOST_NESTED:
            raise too_large(source, "files that name one another", f"at most {MOST_NESTED} deep")
        for path in unread_files:
            refuse_pointer(Path(path))
            total += os.stat(path).st_size
            if total > LARGEST_BYTES:
                raise too_large(source, f"{total:,} bytes in its files", f"at most {LARGEST_BYTES:,}")
            sums[path], text = _read(path)
            if text is not None:
                texts[path] = text
        named_files = set(_places(texts, source)) - places
        places |= named_files
        unread_files = [path for path in sorted(named_files) if _is_file(path)]
    folder = os.path.dirname(os.path.abspath(source))
    lines = sorted(f"{os.path.relpath(path, folder)}\0{content}\n" for path, content in sums.items())
    return hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()


def too_large(model: Path, size_text: str, expected: str) -> SceneError:
    """Return the error of a model that no simulation holds."""
    return SceneError(
        f"model {model.name} is too large to simulate", expected=expected, found=size_text, where=Where(path=str(model))
    )


def kind_of(path: str | Path) -> str | None:
    """Return what stands at a path where that is no file, as `a FIFO`; None for a file, and where nothing stands."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return None
    return next((words for test, words in _KINDS if test(mode)), None)


def _is_file(path: str) -> bool:
    """Tell whether a file stands at a path; folders are left to MuJoCo to refuse.

    Raises
    ------
    SceneError
        When a FIFO or a device stands there, from which one could read for ever.
    """
    kind = kind_of(path)
    if kind not in (None, "a folder"):
        raise SceneError(
            f"{os.path.basename(path)}, which the model names, is no file",
            expected="a file",
            found=kind,
            where=Where(path=path),
            fix="name a file in its place",
        )
    return kind is None and os.access(path, os.R_OK)


def _read(path: str) -> tuple[str, bytes | None]:
    """Return the SHA-256 of a file, and its text where it is XML.

    Raises
    ------
    SceneError
        When it is a larger text than any model.
    """
    with open(path, "rb") as file:
        begin = file.read(256)
        is_text = begin.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
        file.seek(0)
        if not is_text:
            return hashlib.file_digest(file, "sha256").hexdigest(), None
        text = file.read(LARGEST_TEXT_BYTES + 1)
    if len(text) > LARGEST_TEXT_BYTES:
        raise too_large(Path(path), "a larger text", f"at most {LARGEST_TEXT_BYTES:,} bytes")
    return hashlib.sha256(text).hexdigest(), text


def _places(texts: dict[str, bytes], source: Path) -> Iterator[str]:
    """Yield the places of the files that the texts of a model name, wherever its folders may mean them to lie.

    Raises
    ------
    SceneError
        When there are more places than any model needs.
    """
    names = {name for text in texts.values() for name in _values(_FILES, text)}
    folders = {"", *(folder for text in texts.values() for folder in _values(_FOLDERS, text))}
    bases = {os.path.dirname(path) for path in texts}
    if 2 * len(names) * len(folders) * len(bases) > MOST_PLACES:
        places = f"{len(names):,} names of files, in {len(folders):,} folders beside {len(bases):,} files"
        raise too_large(source, places, f"at most {MOST_PLACES:,} places where they may lie")
    for name in names:
        if "://" in name:
            yield from (os.path.abspath(file) for file, _ in candidates(name, source))
        # MuJoCo may be told to look for the last part of a name alone (`strippath`).
        for tail, folder, base in itertools.product({name, name.rpartition("/")[2]}, folders, bases):
            yield os.path.join(base, folder, tail)


def _values(attribute: re.Pattern[bytes], text: bytes) -> Iterator[str]:
    """Yield the values of an attribute, as they are on disk."""
    for double, value in attribute.findall(text):
        yield html.unescape(os.fsdecode(double or value)).replace("\\", "/")
