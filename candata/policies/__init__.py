"""Policies: one file each; the folder is the registry."""

from candata.plugins import load, names
from candata.policies._contract import Plan, Policy

PACKAGE = "candata.policies"

__all__ = ["Plan", "Policy", "policy", "policy_names"]


def policy_names() -> tuple[str, ...]:
    """Return the names of all policies: the files of the folder."""
    return names(PACKAGE)


def policy(name: str) -> Policy:
    """Return the policy called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    """
    found: Policy = load(PACKAGE, "POLICY", name)
    return found
