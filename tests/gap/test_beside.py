"""Beside other causes: what a world far from the nominal one hides from signatures is simulated there."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import added, refine, sets
from candata.gap import replay as replays
from candata.gap.candidates import candidate
from candata.gap.diagnosis import _problem
from candata.gap.pace import Pace
from candata.gap.recordings import recordings
from candata.gap.refine import joint
from candata.gap.replay import Replayer, needs_simulation, replay
from candata.gap.screen import respond, screening
from candata.gap.shortlist import brief, looked_into
from candata.gap.signatures import Library
from candata.gap.stage import Stage, as_simulated, look
from candata.gap.streams import Streams
from candata.gap.together import Sum
from candata.gap.wanted import wanted
from tests.effects.gripper import ROLES, write_scene

NOISE = "noise: {object_pose: [0.0005, 0.004], joint_position: 0.001, fingertip_force: 0.02}\n"


@pytest.fixture(scope="module")
def late(arm, arm_episodes, planted):
    """The problem that an arm with a delay of 0.12 s and dry joints poses, and the fit of the delay alone."""
    effects = (*planted("actuation_delay", delay_s=0.12), *planted("joint_dry_friction", frictionloss_Nm=0.3))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    delay = (candidate("actuation_delay", arm), np.full(1, 0.12))
    return problem, joint(problem, (delay,), problem.score.loss(problem.nominal))


@pytest.mark.parametrize("looked_again", [True, False])
def test_a_cause_that_signatures_miss_beside_a_long_delay_is_found_by_simulation(late, monkeypatch, looked_again):
    if not looked_again:
        monkeypatch.setattr(sets, "BELIEVED", -np.inf)
    problem, delay = late
    (found, _, _), _ = sets.forward(problem, delay, ())
    assert (set(found.labels) == {"actuation_delay", "joint_dry_friction"}) is looked_again


@pytest.mark.parametrize(
    ("promised", "simulated", "left", "looks"),
    [(0.4, 0.9, 1.0, 2), (0.4, 0.3, 1.0, 2), (0.6, 0.9, 1.0, 1), (0.05, 0.9, 0.15, 1), (None, 0.9, 1.0, 2)],
)
def test_effects_are_simulated_only_where_signatures_leave_much(late, monkeypatch, promised, simulated, left, looks):
    problem, fit = late
    made, told = [], []

    def fits(gain):
        return () if gain is None else (replace(fit, evidence=replace(fit.evidence, gain=np.full(12, gain))),)

    def looked(problem, here, held, before=None):
        assert (before is not None) is problem.simulated  # the typical loss there is known
        made.append(problem.simulated)
        found = fits(simulated if problem.simulated else promised)
        return Stage(np.full(12, 1 + left), np.zeros((4, 12)), found, 0.0, (), (), (), 0.0)

    monkeypatch.setattr(sets, "look", looked)
    stage, seen = sets._beside(replace(problem, pace=Pace(told.append, 1.0)), fit.members, fit.plane.z, True)
    assert len(told) == looks - 1
    assert all("about 20 to 65 s" in line for line in told)
    assert made == [False, True][:looks]
    assert seen.simulated is (looks == 2 and simulated > (promised or 0.0))
    assert stage.best_gain == pytest.approx(max(promised or 0.0, simulated) if looks == 2 else promised)


def test_where_signatures_were_seen_to_promise_nothing_effects_are_simulated_at_once(late, monkeypatch):
    """Beside a long delay dry friction promises nothing, and is worth all that is left."""
    problem, fit = late
    made, real = [], sets.look

    def looked(problem, *rest):
        made.append(problem.simulated)
        return real(problem, *rest)

    monkeypatch.setattr(sets, "look", looked)
    stage, seen = sets._beside(problem, fit.members, fit.plane.z, False)
    assert made == [True]
    assert seen.simulated
    assert stage.passing().labels == ("joint_dry_friction",)


@pytest.mark.parametrize(("faint", "named"), [(0.0, True), (np.inf, False)])
def test_what_is_left_of_a_large_gap_is_simulated_too_where_signatures_promise_nothing(late, monkeypatch, faint, named):
    problem, fit = late
    monkeypatch.setattr(sets, "has_room", lambda best: False)
    monkeypatch.setattr(sets, "gains_share", lambda problem, here, found, held: False)
    monkeypatch.setattr(sets, "FAINT", faint)
    (found, _, _), _ = sets.forward(problem, fit, ())
    assert (set(found.labels) == {"actuation_delay", "joint_dry_friction"}) is named


def test_what_comes_in_a_members_place_is_fitted_by_simulated_slopes(late, arm):
    """Beside a long delay the signature of dry friction leads nowhere."""
    problem, delay = late
    part, index = brief(problem)
    assert len(index) < len(problem.recs)
    damping, dry = (
        (candidate(name, arm), np.full(1, value))
        for name, value in (("joint_damping", 0.3), ("joint_dry_friction", 0.2))
    )
    (found,) = added._nearest(part, (*delay.members, damping), [(*delay.members, dry)])
    assert found[1][1][0] == pytest.approx(0.3, rel=0.03)


def test_of_much_that_is_left_what_comes_in_a_members_place_is_fitted_from_however_far(late, arm):
    """The others made up for what was wrong, and must move before the right one shows what it is worth."""
    problem, delay = late
    part, _ = brief(problem)
    damping, dry = (
        (candidate(name, arm), np.full(1, value))
        for name, value in (("joint_damping", 0.3), ("joint_dry_friction", 0.02))
    )
    ((c, u),) = delay.members
    far = [((c, u - 0.02), dry)]
    assert added._nearest(part, (*delay.members, damping), far) == []
    (found,) = added._nearest(part, (*delay.members, damping), far, much=True)
    assert found[1][1][0] == pytest.approx(0.3, rel=0.03)


@pytest.fixture(scope="module")
def off(late):
    """The delay read 4 ms off, what every effect does beside it on a few episodes, and these."""
    problem, delay = late
    ((c, u),) = delay.members
    z = problem.residuals([problem.setting([(c, u - 0.004)])])[0]
    held = replace(delay, members=((c, u - 0.004),), response=replace(delay.plane, at=u - 0.004, z=z))
    seen = looked_into(problem, z)
    return held, as_simulated(seen, look(seen, z, held.members)), brief(seen)


def test_for_what_little_is_left_of_a_large_gap_what_is_held_moves_along_too(late, off, monkeypatch):
    problem, _ = late
    held, *_ = off
    asked, real = [], sets._moved_along
    monkeypatch.setattr(sets, "has_room", lambda best: False)
    monkeypatch.setattr(sets, "_moved_along", lambda *a: asked.append(a) or real(*a))
    found = sets._next(problem, held, seems=False)
    assert asked
    assert set(found.labels) == {"actuation_delay", "joint_dry_friction"}
    assert abs(found.members[0][1][0] - 0.12) < 0.002  # it was read 4 ms off


def test_another_effect_is_found_with_what_is_held_moved_along(late, off):
    problem, (held, rough, some) = late[0], off
    found = sets._along(problem, held, some[0], *sets._moved_along(problem, held, rough, some))
    assert set(found.labels) == {"actuation_delay", "joint_dry_friction"}
    assert found.members[0][1] == pytest.approx([0.12], abs=0.001)
    assert sets._along(problem, held, some[0], *sets._moved_along(problem, held, (), some)) is None


def test_what_explains_as_much_once_what_is_held_moves_is_tried_beside_what_passes(late, off):
    """The true one comes along with a wrong one that explains less, and begins where what is held moved."""
    problem, (held, rough, some) = late[0], off
    now, sums = sets._moved_along(problem, held, rough, some)
    wrong, right = (
        (*held.members, (candidate(n, problem.replayer.scene), np.full(1, v)))
        for n, v in (("armature", 0.0005), ("joint_dry_friction", 0.3))
    )
    begun = sets._moving(some[0], [wrong], now, sums)
    assert begun[0] is wrong
    for found in (begun[1], sets._moving(some[0], [], now, sums)[0], sets._moving(some[0], [right], now, sums)[0]):
        assert [m.label for m, _ in found] == ["actuation_delay", "joint_dry_friction"]
        assert found[0][1] == pytest.approx([0.12], abs=0.001)
    assert sets._moving(some[0], [right], now, [one for one in sums if one.loss >= now]) == [right]


def test_a_choice_is_fitted_whatever_is_read_off(late, monkeypatch):
    problem, delay = late
    step = candidate("time_step", problem.replayer.scene)
    sums = [
        Sum((*delay.members, (candidate("armature", problem.replayer.scene), np.full(1, 0.0005))), np.inf),
        Sum((*delay.members, (step, step.low)), np.inf),
    ]
    fitted = []
    monkeypatch.setattr(sets, "joint", lambda problem, members, *a, **k: fitted.append(members) or delay)
    now = float(problem.score.loss(delay.plane.z).mean())
    assert sets._along(problem, delay, problem, now, sums) is None, "the delay alone is no more than it was"
    assert [c.name for c, _ in fitted[0]] == ["actuation_delay", "time_step"]


def test_a_choice_that_is_fitted_again_takes_no_other_effects_place(late, arm, monkeypatch):
    problem, delay = late
    loss = {"time_step": 1.5, "armature": 1.6, "joint_damping": 1.7}
    sums = [Sum((*delay.members, (c, c.low)), 1.0) for c in (candidate(name, arm) for name in loss)]
    tried = []

    def light(part, members, widths=()):
        return loss[members[-1][0].name] - 0.1 * len(widths), members

    monkeypatch.setattr(sets, "lightly", lambda part, sets: [light(part, members) for members in sets])
    monkeypatch.setattr(sets, "lightly_fitted", light)
    monkeypatch.setattr(sets, "joint", lambda problem, members, *a, **k: tried.append(members[-1][0].name) or delay)
    sets._along(problem, delay, problem, 2.0, sums)
    assert tried == list(loss)


def test_beside_a_choice_what_is_held_moves_by_simulated_slopes(tmp_path, played, planted):
    """Beside a pyramidal cone signatures of an `impratio`, made beside an elliptic one, move it nowhere."""
    scene = write_scene(tmp_path, roles=ROLES + NOISE)
    effects = (*planted("friction_cone", cone="pyramidal"), *planted("impratio", impratio=0.1))
    recs = recordings(scene, played(scene, effects, policies=("grasp_lift_shake", "push")))
    problem = _problem(Replayer(scene), recs, Streams(0), None, lambda stage: None)
    base = problem.score.loss(problem.nominal)
    impratio, cone = (candidate(name, scene) for name in ("impratio", "friction_cone"))
    alone = joint(problem, ((impratio, np.log([0.1])),), base)
    now = float(problem.score.loss(alone.plane.z).mean())
    both = Sum((*alone.members, (cone, 1 - cone.neutral)), np.inf)
    found = sets._along(problem, alone, problem, now, [both])
    assert set(found.labels) == {"impratio", "friction_cone"}
    assert found.members[0][1] == pytest.approx(np.log([0.1]), abs=0.2)
    assert found.gain > alone.gain


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
    world = partial(refine.divided, members)
    z = problem.residuals([problem.setting(members)])[0]
    known = refine.slopes_of(problem, members, world, z)
    simulated = []
    monkeypatch.setattr(replays, "replay", lambda *a, **k: simulated.append(len(a[3])) or once(*a, **k))
    once = replay
    slope = refine._differences(problem, members, world, z, 0.5, known)
    assert simulated == [2], "one for the mass, one for all of the bias"
    assert slope[1:] == pytest.approx(known[1:], abs=0.01 * float(np.abs(known[1:]).max()))


def test_no_signature_is_simulated_of_what_needs_none(slippery):
    some = [effects for _, effects in wanted(slippery, "all")]
    assert not {s.name for effects in some for s in effects} & set(READ)
    assert all(needs_simulation(effects) for effects in some)


class _Lightly:
    """A problem in which sets leave what a table says of their time step and cone; it keeps what was fitted."""

    def __init__(self, leaves):
        self.leaves, self.fitted = leaves, []
        self.nominal = None
        self.score = SimpleNamespace(loss=lambda z: np.zeros(1) if z is None else z)

    def joint(self, problem, members, base, widths):
        key = members[-1][0].name, float(members[-1][1][0])
        self.fitted.append(key)
        return SimpleNamespace(plane=SimpleNamespace(z=np.array([self.leaves[key]])), members=members)


@pytest.mark.parametrize(
    ("losses", "unfitted"),
    [
        ((1.0, 0.8, 0.9, 1.1, 1.2), {"coarsest"}),  # 0: finest ... 4: coarsest
        ((0.5, 0.6, 0.7, 1.0, 1.1), {"coarsest"}),
        ((1.3, 1.2, 1.1, 0.9, 0.4), {"finest", "finer"}),
        ((0.1, 1.2, 1.1, 1.3, 0.1), {"finest", "coarsest"}),
    ],
)
def test_an_ordered_choice_is_fitted_outwards_while_it_explains_more(arm, monkeypatch, losses, unfitted):
    step, cone = candidate("time_step", arm), candidate("friction_cone", arm)
    own = float(step.neutral[0])
    values = [own + float(np.log(s)) for s in (0.2, 0.25, 0.5, 1.6, 2.5)]
    names = dict(zip(("finest", "finer", "fine", "coarse", "coarsest"), values, strict=True))
    other = float(1 - cone.neutral[0])
    steps = {("time_step", v): x for v, x in zip(values, losses, strict=True)}
    problem = _Lightly(steps | {("friction_cone", other): 2.0})
    monkeypatch.setattr(added, "joint", problem.joint)
    some = [((step, np.array([v])),) for v in values] + [((cone, np.array([other])),)]
    found = added.lightly(problem, some)
    assert {v for name, v in problem.fitted if name == "time_step"} == set(values) - {names[n] for n in unfitted}
    assert [loss for loss, _ in found] == sorted(loss for loss, _ in found)
    assert len(problem.fitted) == len(found)
    assert ("friction_cone", other) in problem.fitted


def test_a_choice_is_fitted_however_far_it_is_where_it_begins(arm, arm_episodes, planted):
    effects = (*planted("integrator", integrator="euler"), *planted("joint_dry_friction", frictionloss_Nm=0.3))
    recs = recordings(arm, arm_episodes(effects, count=12))
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    dry, damped, choice = (candidate(n, arm) for n in ("joint_dry_friction", "joint_damping", "integrator"))
    held = ((dry, np.full(1, 0.2)), (damped, np.full(1, 0.05)))
    euler = ((choice, choice.low), (dry, np.full(1, 0.1)))
    base, far, own = (added.by_loss(problem, [members])[0][0] for members in ((), euler, held))
    assert far > own + added.ALIKE * (base - own)  # as another effect it would not be fitted
    assert added._nearest(problem, held, [euler]) == []
    (found,) = added._nearest(problem, held, [], [euler])
    assert {c.name: u[0] for c, u in found} == pytest.approx(
        {"integrator": choice.low[0], "joint_dry_friction": 0.3}, rel=0.05
    )
