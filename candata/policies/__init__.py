"""Policies: one file each; the folder is the registry."""

from candata.plugins import Registry
from candata.policies._contract import Motion, Plan, Policy, Variant
from candata.policies._motion_file import MotionFile, command_limits, motion_plan, read_motions, write_motions

POLICIES = Registry("policies", "candata.policies", "POLICY", Policy, "about")

__all__ = [
    "POLICIES",
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
    """Return the names of all policies: the files of the folder, and those of other packages."""
    return POLICIES.names()


def policy(name: str) -> Policy:
    """Return the policy called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    PluginError
        When it comes from another package and cannot be used.
    """
    return POLICIES.load(name)
