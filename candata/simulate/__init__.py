"""Simulation: the stepping loop and what feeds it."""

from candata.simulate.loop import Trajectory, at_rest, rollout
from candata.simulate.observer import Observer, Prescribed
from candata.simulate.seal import open_seal
from candata.simulate.world import followed_readings, true_state, with_effects

__all__ = [
    "Observer",
    "Prescribed",
    "Trajectory",
    "at_rest",
    "followed_readings",
    "open_seal",
    "rollout",
    "true_state",
    "with_effects",
]
