"""Where signatures explain little, effects are simulated on the recording itself, and the better search counts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit import problem as search
from candata.gap.fit.candidates import candidate, first_probes
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer, name_of
from candata.gap.run.streams import Streams
from candata.gap.screening import shortlist
from candata.gap.screening.episodes import brief, few, looked_into
from candata.gap.screening.look import look, unheld
from candata.gap.screening.shortlist import SIMULATED, screened
from candata.gap.screening.signature_screen import _places, respond, screening
from candata.gap.search import attribution
from candata.gap.search.attribution import Attribution, attribute


@pytest.fixture(scope="module")
def problem(arm, arm_episodes, planted):
    """The problem that an arm with dry joints poses."""
    episodes = arm_episodes(planted("joint_dry_friction", frictionloss_Nm=0.3), count=12)
    return _problem(Replayer(arm), recordings(arm, episodes), Streams(0), None, lambda stage: None)


@pytest.fixture(scope="module")
def poor(problem):
    """A search that names nothing."""
    return Attribution(look(problem), None, (), problem.score, True)


def searches(monkeypatch, *, first, second):
    """Let the search by signatures find `first`, the one by simulations `second`; return which were made."""
    made, real = [], attribution._search

    def searched(problem, stage, doubt):
        made.append(problem.simulated)
        found = second if problem.simulated else first
        return real(problem, stage, doubt) if found is None else found

    monkeypatch.setattr(attribution, "_search", searched)
    return made


def test_effects_are_simulated_where_most_is_left(problem, poor, monkeypatch):
    made = searches(monkeypatch, first=poor, second=None)
    assert attribute(problem).chosen.labels == ("joint_dry_friction",)
    assert made == [False, True]


@pytest.mark.parametrize(
    ("named", "share", "floors", "again"),
    [(True, 0.9, 0.6, True), (True, 0.9, 0.4, False), (True, 0.4, 0.6, False), (False, 1.0, 0.1, True)],
)
def test_a_search_is_made_again_of_half_the_gap_and_half_a_floor_or_where_nothing_is_named(
    problem, poor, monkeypatch, named, share, floors, again
):
    first = replace(poor, chosen=poor.first.fits[0]) if named else poor
    made = searches(monkeypatch, first=first, second=poor)
    monkeypatch.setattr(attribution, "_left", lambda problem, found: (share, floors))
    monkeypatch.setattr(attribution, "gains_share", lambda *a: True)
    attribute(problem)
    assert made == [False, True][: 1 + again]


def test_a_small_gap_is_given_to_what_passes_when_all_is_simulated(problem, poor, monkeypatch):
    """Of so little no share is told; a cause that passes there is better than one that is called unknown."""
    found = replace(poor, chosen=poor.first.fits[0])
    monkeypatch.setattr(attribution, "_left", lambda problem, found: (0.0, 0.05))
    searches(monkeypatch, first=poor, second=found)
    assert attribute(problem).chosen is found.chosen
    searches(monkeypatch, first=poor, second=poor)
    assert attribute(problem).chosen is None


@pytest.mark.parametrize("named", [True, False])
def test_where_nothing_was_named_episodes_are_counted_again_by_what_was_simulated(problem, poor, monkeypatch, named):
    first = replace(poor, chosen=poor.first.fits[0]) if named else poor
    made = searches(monkeypatch, first=first, second=poor)
    monkeypatch.setattr(attribution, "_left", lambda problem, found: (0.9, 0.6))
    monkeypatch.setattr(attribution, "gains_share", lambda *a: True)
    found = ("one value", SimpleNamespace(score="another floor"))
    monkeypatch.setattr(attribution, "recentred", lambda problem, *a: found if problem.simulated else None)
    after = attribute(problem)
    assert made == [False, True]
    assert (after.chosen, after.remains) == ((first.chosen, True) if named else ("one value", False))


@pytest.mark.parametrize(("hidden", "hides"), [(True, True), (False, True), (True, False)])
def test_where_little_is_explained_effects_are_also_simulated_without_what_was_named(
    problem, poor, monkeypatch, hidden, hides
):
    """Beside a wrong cause a true one may gain nothing; alone it counts if it leaves less than what was named does.

    What explains less than a tenth hides nothing.
    """
    wrong = candidate("joint_dry_friction", problem.replayer.scene, "elbow")
    tenth = 0.1 * float((poor.first.base - 1).mean())
    named = SimpleNamespace(members=((wrong, np.full(1, 0.01)),), gain=(1.1 if hides else 0.9) * tenth)
    first = replace(poor, chosen=named, first=replace(poor.first, fits=(named,)))
    asked = []

    def gains_share(deeper, here, found, held, now):
        asked.append((len(held), deeper.simulated, float(problem.score.loss(here).mean()), now is here))
        return real(deeper, here, found, held, now) if not held else not hidden

    real = attribution.gains_share
    made = searches(monkeypatch, first=first, second=poor)
    monkeypatch.setattr(attribution, "_left", lambda problem, found: (0.9, 0.6))
    monkeypatch.setattr(attribution, "recentred", lambda problem, *a: None)
    monkeypatch.setattr(attribution, "gains_share", gains_share)
    attribute(problem)
    beside = float(problem.score.loss(problem.residuals([problem.setting(named.members)])[0]).mean())
    alone = float(problem.score.loss(problem.nominal).mean())
    ways = [(1, True, pytest.approx(beside), True), (0, True, pytest.approx(alone), False)]
    assert asked == ways[: 1 + (hidden and hides)]
    assert made == [False, True][: 1 + (hides or not hidden)], "dry joints are seen without what was named"


def test_a_share_that_is_gained_counts_from_what_was_named(problem, planted):
    dry = candidate("joint_dry_friction", problem.replayer.scene)
    deeper = looked_into(problem, problem.nominal)
    assert shortlist.gains_share(deeper, problem.nominal, [dry], ())
    (truth,) = problem.residuals([planted("joint_dry_friction", frictionloss_Nm=0.3)])
    assert not shortlist.gains_share(deeper, problem.nominal, [dry], (), truth)


def test_what_only_the_most_telling_episodes_promise_is_not_searched_among(problem, poor, monkeypatch):
    made = searches(monkeypatch, first=poor, second=poor)
    monkeypatch.setattr(attribution, "gains_share", lambda *a: True)
    monkeypatch.setattr(attribution, "recentred", lambda problem, first, chosen: None)
    promised = attribution.WORTH * float((poor.first.base - 1).mean())
    for gain, again in ((0.9 * promised, False), (1.1 * promised, True)):
        evidence = SimpleNamespace(gain=np.full(12, gain))
        stage = replace(poor.first, fits=(SimpleNamespace(gain=gain, evidence=evidence),))
        monkeypatch.setattr(attribution, "look", lambda problem, before=None, stage=stage: stage)
        made.clear()
        found = attribute(problem)
        assert made == [False, True][: 1 + again]
        assert again or found.chosen is None


def test_alone_on_the_recording_a_scalar_is_looked_at_nearer_and_between(arm, problem):
    c = candidate("joint_dry_friction", arm)
    usual = {float(u[0]) for u in screening(c, problem)}
    nearest = min(usual - {0.0})
    simulated = replace(problem, simulated=True)
    (_, curve), *_ = respond(simulated, problem.nominal, [c])[0]
    first = sorted({float(u[0]) for u in screening(c, replace(problem, brief=True))})
    assert len(first) == 3
    between = [(a + b) / 2 for a, b in pairwise(first)]
    assert sorted(set(curve.at) - usual - {0.0}) == pytest.approx([nearest / 4, *between])
    held = ((candidate("actuation_delay", arm), np.full(1, 0.01)),)
    (_, curve), *_ = respond(simulated, problem.nominal, [c], held)[0]
    assert not set(curve.at) - usual - {0.0}
    assert sorted(set(curve.at) - {0.0}) == pytest.approx(first[1:])  # beside others the middle and the farthest


def test_alone_on_the_recording_a_few_numbers_are_looked_at_nearer(cube, hand):
    c = candidate("object_com", cube)
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=cube), simulated=True)
    far = first_probes(c, cube)
    assert [u.tolist() for u in _places(c, problem, ())] == [u.tolist() for u in (*far, *(u / 4 for u in far))]
    assert len(_places(c, problem, ((c, far[0]),))) == len(far)
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=hand), simulated=True)
    many = candidate("joint_offset", hand)
    assert len(_places(many, problem, ())) == len(first_probes(many, hand))


def test_only_the_newest_of_what_was_simulated_is_kept(problem, monkeypatch):
    monkeypatch.setattr(search, "KEPT", len(problem.recs))
    watched = replace(problem, played={})
    c = candidate("joint_damping", problem.replayer.scene)
    old, new = (watched.setting([(c, np.full(1, value))]) for value in (0.1, 0.2))
    both = watched.residuals([old, new])
    assert len(watched.played) == len(problem.recs)
    assert {name for name, _ in watched.played} == {name_of(new)}
    assert all(np.array_equal(a, b) for a, b in zip(both, watched.residuals([old, new]), strict=True))


def test_what_was_simulated_on_a_few_episodes_is_not_simulated_again(problem):
    stepped = []
    watched = replace(problem, replayer=replace(problem.replayer, count=stepped.append), played={})
    part, _ = brief(replace(watched, simulated=True))
    worlds = [problem.setting([(c, u)]) for c in unheld(part, ()) for u in screening(c, part)]
    first = part.residuals(worlds)
    assert stepped
    stepped.clear()
    again = brief(watched)[0].residuals(worlds)
    assert not stepped
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    watched.residuals(worlds[:1])  # of all episodes: the others are missing
    each = watched.recs.commands.shape[1] * watched.replayer.scene.substeps
    assert sum(stepped) == each * (len(watched.recs) - len(part.recs))
    stepped.clear()
    part.losses_from([part.begin], worlds[:1])  # from given starts: the caller wants those
    assert stepped


def test_a_search_that_explains_most_is_not_made_again(problem, poor, monkeypatch):
    made = searches(monkeypatch, first=None, second=poor)
    assert attribute(problem).chosen.labels == ("joint_dry_friction",)
    assert made == [False]


def test_a_second_search_that_leaves_as_much_is_not_believed(problem, poor, monkeypatch):
    made = searches(monkeypatch, first=poor, second=replace(poor))
    assert attribute(problem).chosen is None
    assert made == [False, True]


def test_where_no_simulated_effect_closes_enough_no_second_search_is_made(problem, poor, monkeypatch):
    monkeypatch.setattr(shortlist, "WORTH", 1.01)
    made = searches(monkeypatch, first=poor, second=None)
    assert attribute(problem).chosen is None
    assert made == [False]


def test_simulated_responses_are_what_rollouts_leave(arm, problem):
    c = candidate("armature", arm)
    ((_, curve),), dead = respond(replace(problem, simulated=True), problem.nominal, [c])
    assert not dead
    for u in screening(c, replace(problem, brief=True)):
        (there,) = problem.residuals([problem.setting([(c, u)])])
        assert np.allclose(curve.read(u), there, atol=1e-4)
        assert curve.nearest_sure(u) == 0


def test_where_all_is_simulated_only_the_fewest_are_on_every_episode_and_none_on_one_element(problem):
    base = problem.score.loss(problem.nominal)
    found = unheld(problem, ())
    seen = screened(replace(problem, simulated=True), found, base)
    assert len(seen.responses) == SIMULATED < seen.tried
    assert all(c.element is None for c, _ in seen.responses)
    assert "joint_dry_friction" in {c.name for c, _ in seen.responses}


def test_what_closes_next_to_nothing_where_it_is_simulated_is_not_looked_at_further(problem, monkeypatch):
    monkeypatch.setattr(shortlist, "TRIED", 1.01)
    stage = look(replace(problem, simulated=True))
    assert stage.fits == ()
    assert stage.passing() is None
    assert "joint_dry_friction" in stage.faint


@pytest.mark.parametrize("silent", ["clock_drift", None])
def test_what_closes_next_to_nothing_of_half_is_not_simulated_on_the_other_half(problem, monkeypatch, silent):
    """But for choices, which may show only once what is held has moved; it counts as tried, and is told as faint."""
    real, scene = shortlist.fitted, problem.replayer.scene

    def fitted(part, response, base):
        return (0.0, response.who.neutral) if response.who.name == silent else real(part, response, base)

    monkeypatch.setattr(shortlist, "fitted", fitted)
    monkeypatch.setattr(shortlist, "SILENT", 0.0 if silent else -np.inf)
    posed = replace(problem, simulated=True, played={})
    found = [candidate(name, scene) for name in ("joint_dry_friction", "clock_drift", "time_step")]
    seen = screened(posed, found, problem.score.loss(problem.nominal))

    def episodes(name):
        return len({i for text, i in posed.played if f'"{name}"' in text})

    count = len(few(problem.recs.tasks))
    assert episodes("joint_dry_friction") == len(problem.recs)
    assert episodes("time_step") >= count
    assert (episodes("clock_drift") == count // 2) == bool(silent)
    assert ("clock_drift" in {c.label for c, _ in seen.rough}) != bool(silent)
    assert seen.tried == len(found) - len(seen.dead)
    assert "clock_drift" in seen.faint or not silent


def test_a_share_is_gained_by_what_shows_on_half_too(problem, monkeypatch):
    dry, drift = (candidate(name, problem.replayer.scene) for name in ("joint_dry_friction", "clock_drift"))
    posed = replace(problem, simulated=True)
    assert shortlist.gains_share(posed, problem.nominal, [dry, drift], ())
    assert not shortlist.gains_share(posed, problem.nominal, [drift], ())
    monkeypatch.setattr(shortlist, "SILENT", 1.01)
    assert not shortlist.gains_share(posed, problem.nominal, [dry, drift], ()), "nothing closes more than all"
