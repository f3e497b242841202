"""What the text of a model says before MuJoCo reads it: some files crash MuJoCo, others keep it busy for hours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from candata.errors import SceneError, Where
from candata.scenes.named_files import MOST_NESTED, too_large

#: Copies of elements that a model may unfold to. Measured: MuJoCo 4.0.0 takes 8 s for 10,000 bodies, 416 s for 50,000.
MOST_COPIES = 10_000
#: Samples of one height field or picture. Measured: MuJoCo 4.0.0 takes 0.5 s for 25 million, 17 s for 400 million.
MOST_SAMPLES = 100_000_000
#: Sides of what is stored in memory sample by sample.
_SIDES = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
_XACRO = "{http://www.ros.org/wiki/xacro}"


def check_text(path: Path) -> None:
    """Return nothing when MuJoCo can be given a model file.

    What is no sound XML, or names files that are not there, is left to MuJoCo to refuse.

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
    _check_file(path, path.parent, (), 0, 1)


def _check_file(path: Path, base: Path, ancestors: tuple[Path, ...], document: int, copies: int) -> None:
    """Check one file and those that it attaches or includes, beside `base`.

    `ancestors` are the files that led to it; those from `document` on include one another, and are one document.
    """
    real_path = path.resolve()
    ancestors = (*ancestors, real_path)
    if len(ancestors) > MOST_NESTED:
        size_text = f"files that attach or include one another {len(ancestors)} deep"
        raise too_large(path, size_text, f"at most {MOST_NESTED} deep")
    root = _root(path)
    for node, count in _unfold_copies(root, copies) if root is not None else ():
        if count > MOST_COPIES:
            raise too_large(path, f"a <{node.tag}> that unfolds to {count:,} copies", f"at most {MOST_COPIES:,}")
        sides = [_integer(node.get(side)) for side in _SIDES.get(node.tag, ())]
        if sides and sides[0] * sides[1] > MOST_SAMPLES:
            size_text = f"a <{node.tag}> of {sides[0]:,} x {sides[1]:,} samples"
            raise too_large(path, size_text, f"at most {MOST_SAMPLES:,} samples")
        if node.tag not in ("model", "include") or not (child := base / node.get("file", "")).is_file():
            continue
        if node.tag == "include" and child.resolve() in ancestors[document:]:
            continue  # MuJoCo finds by itself a file that includes itself
        if child.resolve() in ancestors:
            raise _attached_to_itself(path, (*ancestors[ancestors.index(child.resolve()) :], child))
        if node.tag == "include":
            _check_file(child, base, ancestors, document, count)
        else:
            _check_file(child, child.parent, ancestors, len(ancestors), count)


def _attached_to_itself(path: Path, chain: tuple[Path, ...]) -> SceneError:
    """Return the error of a file that attaches one of those that led to it."""
    return SceneError(
        f"model {chain[0].name} attaches itself",
        found=" -> ".join(p.name for p in chain),
        where=Where(path=str(path)),
        fix="remove the <model> that names the file it stands in",
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
    """Yield each element of a model, and of how many copies of it the whole consists."""
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
