"""A folder is its registry: each file exports the folder's constant, and says what it is."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from candata import plugins
from candata.errors import UnknownNameError
from candata.fetch import SOURCES
from candata.scenes.contract import HANDS

ROOT = Path(__file__).resolve().parents[2]

REGISTRIES = [*map(plugins.registry, plugins.REGISTRIES), HANDS, SOURCES]
#: Folder to the constant its files export.
CONSTANTS = {registry.package: registry.constant for registry in REGISTRIES}
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


@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.kind)
def test_what_a_file_exports_is_what_its_contract_says(registry):
    for plugin in registry.load_all().values():
        assert isinstance(plugin, registry.contract)
        assert getattr(plugin, registry.summary)
