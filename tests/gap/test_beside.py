"""Beside other causes: what a world far from the nominal one hides from signatures is simulated there."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.signatures import Library
from candata.gap.preparation import _problem
from candata.gap.replay import replayer as replays
from candata.gap.replay.replayer import Replayer, needs_simulation, replay
from candata.gap.run.streams import Streams
from candata.gap.screening import refinement, set_slopes
from candata.gap.screening.demand import wanted
from candata.gap.screening.signature_screen import respond, screening
from tests.effects.gripper import ROLES, write_scene

NOISE = "noise: {object_pose: [0.0005, 0.004], joint_position: 0.001, fingertip_force: 0.02}\n"


@pytest.fixture(scope="module")
def slippery(tmp_path_factory, played, planted):
    """The problem that a gripper with slippery fingertips poses."""
    scene = write_scene(tmp_path_factory.mktemp("gripper"), roles=ROLES + NOISE)
    recs = recordings(scene, played(scene, planted("sliding_friction", scale=0.3), policies=("squeeze",)))
    return _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)


READ = ("tactile_bias", "tactile_gain", "tactile_lag", "tactile_dead_band")


@pytest.mark.parametrize("name", READ)
@pytest.mark.parametrize("beside", [False, True])
def test_what_alters_forces_as_they_are_read_is_computed_exactly(slippery, monkeypatch, name, beside):
    problem, scene = slippery, slippery.replayer.scene
    held = ((candidate("sliding_friction", scene), np.log([0.3])),) if beside else ()
    here = problem.residuals([problem.setting(held)])[0]
    c = candidate(name, scene)
    monkeypatch.setattr(Library, "_signature", None)  # nothing is read off signatures
    ((_, response),), dead = respond(problem, here, [c], held)
    assert not dead
    u = next(u for u in screening(c, problem) if not c.is_neutral(u))
    (there,) = problem.residuals([problem.setting((*held, (c, u)))])
    assert np.abs(there - here).max() > 1
    assert response.read(u) == pytest.approx(there, abs=1e-3)


def test_numbers_that_alter_forces_as_they_are_read_share_one_simulation(slippery, monkeypatch):
    problem, scene = slippery, slippery.replayer.scene
    mass, bias = candidate("object_mass", scene), candidate("tactile_bias", scene)
    members = ((mass, np.log([1.2])), (bias, np.full(bias.size, 0.02)))
    world = partial(refinement.divided, members)
    z = problem.residuals([problem.setting(members)])[0]
    known = refinement.slopes_of(problem, members, world, z)
    simulated = []
    monkeypatch.setattr(replays, "replay", lambda *a, **k: simulated.append(len(a[3])) or once(*a, **k))
    once = replay
    slope = set_slopes.differences(problem, members, world, z, 0.5, known)
    assert simulated == [2], "one for the mass, one for all of the bias"
    assert slope[1:] == pytest.approx(known[1:], abs=0.01 * float(np.abs(known[1:]).max()))


def test_no_signature_is_simulated_of_what_needs_none(slippery):
    some = [effects for _, effects in wanted(slippery, "all")]
    assert not {s.name for effects in some for s in effects} & set(READ)
    assert all(needs_simulation(effects) for effects in some)
