"""Policies judged before they meet the robot: the same policies from the same real starts in several worlds."""

from candata.policy_evaluation.contract import Orders, Played, PlayedPolicy, RealStarts, World
from candata.policy_evaluation.policies import EvaluatedPolicy, GivenCommands, read_policies

__all__ = [
    "EvaluatedPolicy",
    "GivenCommands",
    "Orders",
    "Played",
    "PlayedPolicy",
    "RealStarts",
    "World",
    "read_policies",
]
