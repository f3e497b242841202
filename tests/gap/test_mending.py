"""A force that explains clearly more than names do ends the search for more of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.force import remedy
from candata.gap.force.remedy import Doubt, LoneForce
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.episodes import brief
from candata.gap.screening.refinement import joint
from candata.gap.search.attribution import attribute
from tests.gap import hidden


@pytest.fixture(scope="module")
def posed(arm, arm_episodes):
    """The function that poses the problem of an arm with some effects."""

    def pose(effects, count: int = 12):
        recs = recordings(arm, arm_episodes(effects, count=count))
        return _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)

    return pose


@pytest.fixture(scope="module")
def cogs(posed):
    """The problem that an elbow poses which cogs: no effect of the library does."""
    with pytest.MonkeyPatch.context() as patch:
        cause = hidden.on_joint("elbow", lambda q, u, memory: 0.3 * np.sin(12 * q + 0.4))
        yield posed(hidden.hider(patch)(cause))


@pytest.fixture(scope="module")
def named(cogs, arm):
    """The nearest effect, fitted to it."""
    c = candidate("joint_dry_friction", arm)
    return joint(cogs, ((c, np.full(1, 0.1)),), cogs.score.loss(cogs.nominal))


def test_a_force_that_explains_clearly_more_than_a_name_stands(cogs, named):
    doubt = Doubt(LoneForce(cogs))
    assert doubt.of(cogs, named.plane.z).best.suspects[0].element == "elbow"


def test_a_force_that_explains_no_more_than_what_is_named_does_not(posed, planted):
    """Damping is a force along the speed, which closes as much; the name says more."""
    truth = planted("joint_damping", damping_Nms_rad=0.3)
    problem = posed(truth)
    doubt = Doubt(LoneForce(problem))
    assert doubt.of(problem, problem.nominal), "beside nothing it would"
    assert doubt.of(problem, problem.residuals([truth])[0]) is None


def mending_half(monkeypatch) -> list[int]:
    """Let a force mend half of the gap; the list of how many episodes it is played on."""
    played: list[int] = []

    def half(problem, world):
        played.append(len(problem.recs))
        return SimpleNamespace(best=SimpleNamespace(closed=0.5, suspects=[SimpleNamespace(place="joint")]))

    monkeypatch.setattr(remedy, "mended", half)
    return played


def test_where_it_closes_little_of_a_few_episodes_it_is_not_played_on_all(cogs, named, monkeypatch):
    played = mending_half(monkeypatch)
    doubt = Doubt(LoneForce(cogs))
    assert not doubt.of(cogs, named.plane.z)
    assert not doubt.of(cogs, cogs.nominal)
    assert played == [6], "once, on a few of the twelve"


@pytest.mark.parametrize(("place", "stands"), [("fingertip", False), ("object", True), ("wrist", True)])
def test_a_correction_of_what_fingertips_read_is_no_cause_by_itself(cogs, named, monkeypatch, place, stands):
    force = SimpleNamespace(best=SimpleNamespace(closed=0.99, suspects=[SimpleNamespace(place=place)]))
    monkeypatch.setattr(remedy, "mended", lambda *a: force)
    assert bool(Doubt(LoneForce(cogs)).of(cogs, named.plane.z)) is stands


def test_a_search_that_it_ends_says_which_force_and_names_no_more(cogs):
    found = attribute(cogs)
    assert found.force.best.suspects[0].element == "elbow"
    assert found.remains
    assert len(found.chosen.members) <= 2


def test_what_was_named_before_counts_where_less_is_named_later(cogs, named):
    """A second search may hold a poorer set than the first one found."""
    doubt = Doubt(LoneForce(cogs))
    nearly = named.plane.z * np.float32(0.01)
    assert doubt.of(cogs, nearly) is None
    assert doubt.beyond(cogs, nearly).of(cogs, named.plane.z) is None
    assert doubt.of(cogs, named.plane.z), "what was asked before changes nothing"


def test_it_is_not_played_where_names_leave_it_no_room(cogs, named, monkeypatch):
    """What names leave must be more than what a force has to close beyond them."""
    monkeypatch.setattr(remedy, "mended", lambda *a: pytest.fail("it is played"))
    assert not Doubt(LoneForce(cogs)).of(cogs, named.plane.z * np.float32(0.01))


def test_what_mends_little_of_a_few_episodes_may_close_no_more_of_all(cogs, monkeypatch):
    played = mending_half(monkeypatch)
    doubt = Doubt(LoneForce(cogs))
    assert (doubt.may_close(0.6), doubt.may_close(0.7)) == (True, False)
    assert doubt.lone.of_all is doubt.lone.of_all
    assert played == [6, 12]


def test_which_force_mends_most_is_decided_on_half_of_the_episodes_and_judged_on_all(cogs, monkeypatch):
    played, real = [], remedy.stopgap

    def counted(problem, world, nominal, some, index=None):
        played.append(len(problem.recs) if index is None else len(index))
        return real(problem, world, nominal, some, index)

    monkeypatch.setattr(remedy, "stopgap", counted)
    found = remedy.mended(cogs, ())
    assert found.best.size.shape == (12,)
    assert set(played[:-1]) == {8}, "two of the three of each fold"
    assert played[-1] == 12
    played.clear()
    assert len(remedy.mended(brief(cogs)[0], ()).best.size) == 6
    assert set(played) == {6}


def test_what_names_leave_is_described_from_fewer_episodes(cogs, named, monkeypatch):
    monkeypatch.setattr(remedy, "LEFT_OVER", 8)
    looked: list[int] = []

    def nothing(problem, world):
        looked.append(len(problem.recs))
        return [], []

    monkeypatch.setattr(remedy, "_standing_out", nothing)
    remedy.mended(cogs, cogs.setting(named.members))
    remedy.mended(cogs, ())
    assert looked == [8, 12]


def test_shares_are_told_in_the_floors_that_the_force_is_judged_by(cogs, named):
    """A world in which all is ten times as uncertain closes no more of the gap."""
    calm = replace(cogs, score=replace(cogs.score, sigma=10 * cogs.score.sigma))
    doubt = Doubt(LoneForce(cogs))
    assert doubt._closed(calm, named.plane.z / 10) == pytest.approx(doubt._closed(cogs, named.plane.z), abs=1e-3)


def test_with_more_motions_than_episodes_are_looked_at_one_of_each_is(cogs):
    index, parts = np.arange(30) % 12, [np.array([i]) for i in range(30)]
    taken = {name: getattr(cogs, name).take(index) for name in ("recs", "begin", "plan", "score", "library")}
    taken |= {"before": {name: values[index] for name, values in cogs.before.items()}, "raw": cogs.raw[index]}
    some, which = remedy._some(replace(cogs, parts=parts, **taken))
    assert len(some.recs) == len(which) == 30
