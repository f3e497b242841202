"""The conformance suites over whatever is in a folder: a new file is tested without a line of its own."""

from __future__ import annotations

from candata.plugins import Registry


def suites(suite: type, registry: Registry, attribute: str, contract: type = object, **of: dict) -> dict[str, type]:
    """A class of the suite for each plug-in of a contract, by the name pytest collects it under.

    `of` holds what some differ in.
    """
    return {
        f"Test_{name}": type(f"Test_{name}", (suite,), {attribute: plugin} | of.get(name, {}))
        for name, plugin in registry.load_all().items()
        if isinstance(plugin, contract)
    }
