"""A folder is its registry: each file exports the folder's constant, and says what it is."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from candata import plugins
from candata.errors import UnknownNameError

ROOT = Path(__file__).resolve().parents[2]

#: Folder to the constant its files export.
CONSTANTS = {
    "candata.effects": "EFFECT",
    "candata.formats": "FORMAT",
    "candata.policies": "POLICY",
    "candata.checks": "RULE",
    "candata.models": "MODEL",
    "candata.scenes.library": "SCENE",
    "candata.scenes.hands": "HAND",
    "candata.record.devices": "DEVICE",
}
FILES = [(package, constant, name) for package, constant in CONSTANTS.items() for name in plugins.names(package)]


def assigned(path: Path) -> set[str]:
    """Names that a module binds at its top level by assignment."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    plain = {t.id for n in body if isinstance(n, ast.Assign) for t in n.targets if isinstance(t, ast.Name)}
    return plain | {n.target.id for n in body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)}


@pytest.mark.parametrize(("package", "constant", "name"), FILES)
def test_a_file_of_the_folder_exports_its_constant(package, constant, name):
    path = ROOT.joinpath(*package.split("."), name)
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    assert constant in assigned(file)
    assert plugins.load(package, constant, name) is not None


@pytest.mark.parametrize(("package", "constant"), CONSTANTS.items())
def test_an_unknown_name_lists_the_known(package, constant):
    with pytest.raises(UnknownNameError) as caught:
        plugins.load(package, constant, "no_such_name")
    assert all(name in str(caught.value) for name in plugins.names(package))
