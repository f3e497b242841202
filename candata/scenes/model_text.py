"""Checks on the text of a model before MuJoCo reads it: some files crash MuJoCo, others keep it busy for hours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from candata.errors import SceneError, Where

#: Copies of elements that a model may unfold to. Measured: MuJoCo 4.0.0 takes 8 s for 10,000 bodies, 416 s for 50,000.
MOST_COPIES = 10_000
#: Samples of one height field or picture. Measured: MuJoCo 4.0.0 takes 0.5 s for 25 million, 17 s for 400 million.
MOST_SAMPLES = 100_000_000
#: Sides of what is stored in memory sample by sample.
_SIDES = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
_XACRO = "{http://www.ros.org/wiki/xacro}"


def check_text(path: Path) -> None:
    """Return nothing when MuJoCo can be given a model file.

    MuJoCo itself refuses broken XML and names of files that are not there.

    Raises
    ------
    SceneError
        When the file is compiled or no XML, is xacro, attaches itself, or unfolds to more than a simulation holds.
    """
    if path.suffix.lower() == ".mjb":
        raise SceneError(
            f"model {path.name} is compiled, and a compiled model cannot be added to",
            expected="the MJCF or URDF that it was made from",
            found="a .mjb file",
            where=Where(path=str(path)),
        )
    _check_file(path, path.parent, (), 1)


def _check_file(path: Path, base: Path, ancestors: tuple[Path, ...], copies: int) -> None:
    """Check one file and those that it attaches or includes, beside `base`; `ancestors` are those that led to it."""
    real_path = path.resolve()
    if real_path in ancestors:
        raise SceneError(
            f"model {path.name} attaches itself",
            found=" -> ".join(p.name for p in (*ancestors[ancestors.index(real_path) :], real_path)),
            where=Where(path=str(path)),
            fix="remove the <model> that names the file it stands in",
        )
    root = _root(path)
    for node, count in _unfold_copies(root, copies) if root is not None else ():
        if count > MOST_COPIES:
            raise _too_much(path, f"a <{node.tag}> that unfolds to {count:,} copies", f"at most {MOST_COPIES:,}")
        sides = [_integer(node.get(side)) for side in _SIDES.get(node.tag, ())]
        if sides and sides[0] * sides[1] > MOST_SAMPLES:
            size_text = f"a <{node.tag}> of {sides[0]:,} x {sides[1]:,} samples"
            raise _too_much(path, size_text, f"at most {MOST_SAMPLES:,} samples")
        if node.tag in ("model", "include") and (child := base / node.get("file", "")).is_file():
            # MuJoCo finds by itself a file that includes itself.
            chain = (*ancestors, real_path) if node.tag == "model" else ancestors
            if node.tag == "model" or child.resolve() != real_path:
                _check_file(child, child.parent if node.tag == "model" else base, chain, count)


def _too_much(path: Path, found: str, expected: str) -> SceneError:
    """Return the error of a model that no simulation holds."""
    return SceneError(
        f"model {path.name} is too large to simulate", expected=expected, found=found, where=Where(path=str(path))
    )


def _root(path: Path) -> ElementTree.Element | None:
    """Return the root of an XML file; None where it is not sound.

    Raises
    ------
    SceneError
        When the file is no XML at all, or xacro.
    """
    raw = path.read_bytes()
    start = raw.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if start != b"<":
        raise SceneError(
            f"model {path.name} is not XML",
            expected="an MJCF (<mujoco>) or a URDF (<robot>)",
            found="an empty file" if not start else "other content",
            where=Where(path=str(path)),
        )
    try:
        root = ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError, LookupError):
        return None
    if any(str(node.tag).startswith(_XACRO) for node in root.iter()):
        raise SceneError(
            f"model {path.name} is xacro, of which a URDF is made",
            where=Where(path=str(path)),
            fix=f"xacro {path.name} > {path.name.split('.')[0]}.urdf",
        )
    return root


def _unfold_copies(root: ElementTree.Element, copies: int) -> Iterator[tuple[ElementTree.Element, int]]:
    """Yield each element of a model, and the number of its copies in the whole."""
    stack = [(root, copies)]
    while stack:
        node, count = stack.pop()
        if node.tag in ("replicate", "composite", "flexcomp"):
            for number in (node.get("count") or "1").split():
                count *= max(1, _integer(number))
        yield node, count
        stack += [(child, count) for child in node]


def _integer(text: str | None) -> int:
    """Return a whole number of an attribute; 0 where there is none."""
    try:
        return int(float(text or 0))
    except (ValueError, OverflowError):
        return 0
