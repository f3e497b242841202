"""Policies: one file each; the folder is the registry."""

from candata.plugins import load, names
from candata.policies._contract import Motion, Plan, Policy, Variant
from candata.policies._motion_file import MotionFile, command_limits, motion_plan, read_motions, write_motions

PACKAGE = "candata.policies"

__all__ = [
    "Motion",
    "MotionFile",
    "Plan",
    "Policy",
    "Variant",
    "command_limits",
    "motion_plan",
    "policy",
    "policy_names",
    "read_motions",
    "write_motions",
]


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
    registered_policy: Policy = load(PACKAGE, "POLICY", name)
    return registered_policy
