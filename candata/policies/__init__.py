"""Policies: one file each; the folder is the registry."""

from candata.plugins import Registry
from candata.policies._carrier import carrier
from candata.policies._contract import Goal, Motion, Observation, Plan, Policy, Step, Variant
from candata.policies._drive import carriers, command_range, position_servo_columns
from candata.policies._motion_file import MotionFile, command_limits, motion_plan, read_motions, write_motions
from candata.policies._step import StepPolicy, opening_plan, read_step_policy

POLICIES = Registry("policies", "candata.policies", "POLICY", Policy, "about")

__all__ = [
    "POLICIES",
    "Goal",
    "Motion",
    "MotionFile",
    "Observation",
    "Plan",
    "Policy",
    "Step",
    "StepPolicy",
    "Variant",
    "carrier",
    "carriers",
    "command_limits",
    "command_range",
    "motion_plan",
    "opening_plan",
    "policy",
    "policy_names",
    "position_servo_columns",
    "read_motions",
    "read_step_policy",
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
