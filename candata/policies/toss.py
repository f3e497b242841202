"""Throw the object: no actuators, only an initial pose and velocity."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Plan, Policy
from candata.rotation import normalise
from candata.scenes import Scene

#: Speeds and spins of the real cube tosses: 0.91 to 1.37 m/s, 0.6 to 10.8 rad/s (ContactNets data set).
SPEED_MPS, SPIN_RADPS = (0.9, 1.4), (0.6, 10.0)


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan: a random attitude 9 to 24 cm up, a throw along the support."""
    t = p.times(scene, min(duration_s, 0.8))
    qpos, qvel = np.array(scene.model.qpos0, float), np.zeros(scene.model.nv)
    at, dof = scene.object_qpos, scene.object_dof
    qpos[at + 2] = rng.uniform(0.12, 0.24)
    qpos[at + 3 : at + 7] = normalise(rng.standard_normal(4))
    heading = rng.uniform(0, 2 * np.pi)
    speed = rng.uniform(*SPEED_MPS)
    qvel[dof : dof + 3] = speed * np.array([np.cos(heading), np.sin(heading), rng.uniform(-0.3, 0.1)])
    axis = rng.standard_normal(3)
    qvel[dof + 3 : dof + 6] = rng.uniform(*SPIN_RADPS) * axis / np.linalg.norm(axis)
    return Plan(np.zeros((len(t), 0)), qpos, qvel, 0.0)


POLICY = Policy("throw the object", lambda scene: scene.object_id is not None and not p.has_hand(scene), _plan)
