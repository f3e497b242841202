"""One registry for every kind of plug-in: the files of a folder, and what other packages bring by entry points.

A file of the folder bears the registered name and exports one constant. Another package brings the same constant as an
entry point, `NAME = "module:CONSTANT"`, in the group of its kind (`candata.effects`, `candata.formats` and so on).
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from candata.errors import MissingExtraError, PluginError, UnknownNameError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")

#: Begins the names of all groups of entry points.
GROUP_PREFIX = "candata."
#: Kind of plug-in that other packages may bring, to where its registry lies.
REGISTRIES = {
    "effects": "candata.effects:EFFECTS",
    "models": "candata.models:MODELS",
    "formats": "candata.formats:FORMATS",
    "devices": "candata.record.devices:DEVICES",
    "policies": "candata.policies:POLICIES",
    "scenes": "candata.scenes.contract:SCENES",
    "objects": "candata.scenes.contract:OBJECTS",
    "checks": "candata.checks:RULES",
}
#: Module of an optional extra, to the extra: a plug-in that needs it says what to install.
EXTRAS = {"torch": "train"}


class PluginWarning(UserWarning):
    """A plug-in of another package cannot be used; all else goes on without it."""


@cache
def names(package: str) -> tuple[str, ...]:
    """Return the registered names of a folder, sorted, without importing its files.

    Names that begin with `_`, and those that the folder lists as `NOT_PLUGINS`, are none.

    Parameters
    ----------
    package : str
        Dotted name of the folder, such as `candata.effects`.
    """
    folder = importlib.import_module(package)
    files = (module.name for module in pkgutil.iter_modules(folder.__path__))
    helpers = getattr(folder, "NOT_PLUGINS", ())
    return tuple(sorted(name for name in files if not name.startswith("_") and name not in helpers))


@cache
def load(package: str, constant: str, name: str) -> Any:
    """Return the constant that the file `name` of the folder exports.

    Raises
    ------
    UnknownNameError
        When the folder has no such file; lists the ones it has.
    MissingExtraError
        When the file needs a package of an optional extra that is not installed.
    """
    if name not in names(package):
        raise UnknownNameError(constant.lower(), name, names(package))
    try:
        return getattr(importlib.import_module(f"{package}.{name}"), constant)
    except ModuleNotFoundError as error:
        raise _missing_module(error) from None


@dataclass(frozen=True)
class Registry(Generic[T]):
    """All plug-ins of one kind, by name; those of the folder go before those of other packages.

    Attributes
    ----------
    kind : str
        What they are called together, such as `effects`; the group of their entry points is `candata.KIND`.
    package : str
        Dotted name of the folder.
    constant : str
        What a file of the folder exports.
    contract : type
        What that constant is.
    summary : str
        Attribute of the contract that says in one line what a plug-in is.
    """

    kind: str
    package: str
    constant: str
    contract: type[T]
    summary: str

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted, without importing a plug-in; a name that is taken counts once."""
        return tuple(sorted({*names(self.package), *_points_of(self.kind)}))

    def __contains__(self, name: str) -> bool:
        """Tell whether a plug-in has this name; other packages are only asked where the folder has none."""
        return name in names(self.package) or name in _points_of(self.kind)

    def load(self, name: str) -> T:
        """Return the plug-in called `name`.

        Raises
        ------
        UnknownNameError
            When there is none; lists those there are.
        PluginError
            When it comes from another package and cannot be used; names the package.
        MissingExtraError
            When it needs a package of an optional extra that is not installed.
        """
        if name in names(self.package):
            plugin: T = load(self.package, self.constant, name)
            return plugin
        if name not in _points_of(self.kind):
            raise UnknownNameError(self.constant.lower(), name, self.names())
        return _load_point(self, name)

    def load_all(self) -> Mapping[str, T]:
        """Return every plug-in by name; of those of other packages that cannot be used, a warning says so once.

        Raises
        ------
        MissingExtraError
            When a built-in one needs a package of an optional extra that is not installed.
        """
        return _load_every(self)

    def module(self, name: str) -> str:
        """Return the dotted name of the module that exports a plug-in."""
        return f"{self.package}.{name}" if name in names(self.package) else _points_of(self.kind)[name][0].module

    def origin(self, name: str) -> str:
        """Return the package that a plug-in comes from, with its version; `candata` for the built-in ones."""
        if name in names(self.package):
            return "candata"
        return _package_of(_points_of(self.kind)[name][0])

    def name_of(self, plugin: T) -> str | None:
        """Return the name under which a plug-in is registered; None where it is not."""
        return next((name for name, registered in self.load_all().items() if registered is plugin), None)

    def problems(self) -> tuple[PluginError, ...]:
        """Return why plug-ins of other packages cannot be used; nothing where all can."""
        return _problems(self)


def registry(kind: str) -> Registry[Any]:
    """Return the registry of a kind of plug-in, such as `effects`.

    Raises
    ------
    UnknownNameError
        When there is no such kind.
    """
    if kind not in REGISTRIES:
        raise UnknownNameError("kind of plug-in", kind, REGISTRIES)
    module, attribute = REGISTRIES[kind].split(":")
    matching_registry: Registry[Any] = getattr(importlib.import_module(module), attribute)
    return matching_registry


@cache
def _points_by_group() -> Mapping[str, Mapping[str, tuple[EntryPoint, ...]]]:
    """Return the entry points of all packages by group and name; the packages are scanned once."""
    from importlib.metadata import entry_points  # only who asks for other packages pays for it

    groups: dict[str, dict[str, tuple[EntryPoint, ...]]] = defaultdict(dict)
    points = entry_points()
    for group in filter(lambda name: name.startswith(GROUP_PREFIX), points.groups):
        for point in points.select(group=group):
            groups[group][point.name] = (*groups[group].get(point.name, ()), point)
    return groups


def _points_of(kind: str) -> Mapping[str, tuple[EntryPoint, ...]]:
    """Return what other packages bring of a kind, by name."""
    return _points_by_group().get(f"{GROUP_PREFIX}{kind}", {})


@cache
def _load_point(registry: Registry[T], name: str) -> T:
    """Return a plug-in of another package, checked."""
    points = _points_of(registry.kind)[name]
    if len(points) > 1:
        raise _name_taken(registry, points[0], f"package {_package_of(points[1])} brings it too")
    (point,) = points
    expected = f"{point.value} of type {registry.contract.__name__}"
    try:
        plugin = point.load()
    except ModuleNotFoundError as error:
        if error.name in EXTRAS:
            raise _missing_module(error) from None
        raise _not_usable(registry, point, expected, f"{type(error).__name__}: {error}") from error
    except Exception as error:
        raise _not_usable(registry, point, expected, f"{type(error).__name__}: {error}") from error
    if not isinstance(plugin, registry.contract):
        raise _not_usable(registry, point, expected, f"{type(plugin).__name__}")
    return plugin


@cache
def _load_every(registry: Registry[T]) -> Mapping[str, T]:
    """Return every plug-in that can be used; warn of the others."""
    problems = _problems(registry)
    if problems:
        from multiprocessing import parent_process  # only where there is something to say

        # Workers of a pool load all plug-ins too; what started them has said it.
        for problem in problems if parent_process() is None else ():
            warnings.warn(PluginWarning(str(problem)), stacklevel=3)
    broken_names = {problem.name for problem in problems} - set(names(registry.package))
    return {name: registry.load(name) for name in registry.names() if name not in broken_names}


@cache
def _problems(registry: Registry[Any]) -> tuple[PluginError, ...]:
    """Return why plug-ins of other packages cannot be used."""
    problems = []
    for name, points in _points_of(registry.kind).items():
        if name in names(registry.package):
            problems += [_name_taken(registry, point, "it is built in") for point in points]
            continue
        try:
            _load_point(registry, name)
        except PluginError as error:
            problems.append(error)
        except MissingExtraError as error:
            problems.append(_not_usable(registry, points[0], points[0].value, str(error.problem), error.fix))
    return tuple(problems)


def _package_of(point: EntryPoint) -> str:
    """Return the package that an entry point comes from, with its version."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.module.partition(".")[0]


def _name_taken(registry: Registry[Any], point: EntryPoint, reason: str) -> PluginError:
    """Return the error of a name that is another plug-in's."""
    fix = f"rename it in the entry points of {_package_of(point)}"
    kind = registry.constant.lower()
    return PluginError(kind, point.name, _package_of(point), expected="a name of its own", found=reason, fix=fix)


def _not_usable(
    registry: Registry[Any], point: EntryPoint, expected: str, found: str, fix: str | None = None
) -> PluginError:
    """Return the error of a plug-in that does not import or is no such constant."""
    package = _package_of(point)
    fix = fix or f"mend or remove the package: pip uninstall {package.split(' ')[0]}"
    return PluginError(registry.constant.lower(), point.name, package, expected=expected, found=found, fix=fix)


def _missing_module(error: ModuleNotFoundError) -> Exception:
    """Return what to raise for a module that is not installed: the install hint where it is an extra's."""
    return MissingExtraError(error.name, EXTRAS[error.name]) if error.name in EXTRAS else error
