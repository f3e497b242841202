"""A scalar cause is found by how many episodes it explains, where its own world foretells what the others leave."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate, local_candidates
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.look import look
from candata.gap.search import attribution, episode_counts

#: What most episodes were recorded with, and the few others: as if an object had slipped there.
MOST, OTHERS = 0.02, 0.08


@pytest.fixture(scope="module")
def torn(arm, arm_episodes, planted):
    """The problem that two thirds of the episodes pose with one delay and a third with another, and a fit between."""
    episodes = [
        arm_episodes(planted("actuation_delay", delay_s=OTHERS if i % 3 == 0 else MOST), count=12)[i] for i in range(12)
    ]
    problem = _problem(Replayer(arm), recordings(arm, episodes), Streams(0), None, lambda stage: None)
    stage = look(problem)
    (fit,) = [f for f in stage.fits if f.labels == ("actuation_delay",)]
    between = replace(fit, members=((fit.members[0][0], np.array([(MOST + OTHERS) / 2])),))
    return problem, replace(stage, fits=(between, *(f for f in stage.fits if f is not fit)))


def test_what_explains_two_of_three_episodes_comes_before_what_explains_half_of_each():
    losses = {"half": np.array([2.0, 2.0, 2.0]), "two": np.array([1.0, 1.0, 6.0])}
    problem = SimpleNamespace(
        setting=lambda members: members[0],
        residuals=lambda settings: settings,
        score=SimpleNamespace(loss=lambda name: losses[name]),
    )
    assert losses["half"].mean() < losses["two"].mean()
    ((left, point, _),) = episode_counts._least(problem, ["half", "two"], 1)
    assert (point, left) == ("two", pytest.approx(np.log(6) / 3))


def test_the_value_that_explains_most_episodes_is_found(torn, monkeypatch):
    problem, stage = torn
    monkeypatch.setattr(episode_counts, "_leaves", lambda *a: False)
    best, world = episode_counts.recentred(problem, stage, None)
    assert best.labels == ("actuation_delay",)
    assert best.members[0][1][0] == pytest.approx(MOST, rel=0.15)
    assert world.score is not problem.score, "in units of the floor of its own world"
    for part, u in zip(problem.parts, best.evidence.points, strict=True):
        (z,) = world.residuals([world.setting([(best.members[0][0], u)])])
        assert best.evidence.loss[part] == pytest.approx(world.score.loss(z)[part])


def test_an_episode_has_no_say_in_the_value_that_it_is_held_out_by(torn):
    """Of two values the better one of all episodes is so by the first fold alone, which is held out by the other."""
    problem, stage = torn
    c = stage.fits[0].members[0][0]
    points = [(c, np.array([u])) for u in (MOST, OTHERS)]
    logs = {MOST: np.zeros(12), OTHERS: np.full(12, 0.1)}
    logs[OTHERS][problem.parts[0]] = -3.0
    posed = replace(problem, score=SimpleNamespace(loss=lambda name: np.exp(logs[name])))
    fit = episode_counts._fitted(posed, problem, [(0.0, p, p[1][0]) for p in reversed(points)])
    assert fit.members == (points[1],)
    assert fit.evidence.points[:, 0].tolist() == [MOST, OTHERS, OTHERS, OTHERS]


def test_a_world_that_does_not_foretell_what_is_left_is_none(torn):
    problem, stage = torn
    assert episode_counts.recentred(problem, stage, None) is None


def test_what_foretells_no_more_surely_than_another_effect_is_none(torn, monkeypatch):
    problem, stage = torn
    other = next(f for f in stage.fits if f.labels != ("actuation_delay",))
    monkeypatch.setattr(episode_counts, "_leaves", lambda *a: False)
    best, _ = episode_counts._counted(problem, stage, other)
    assert best.labels == ("actuation_delay",)
    assert episode_counts._counted(problem, stage, best) is None, "no better value than the best"
    monkeypatch.setattr(episode_counts, "_foretold", lambda world, members: np.zeros(len(problem.recs)))
    assert episode_counts._counted(problem, stage, other) is None
    assert episode_counts._counted(problem, stage, None) is None, "nor than the same one, where nothing was chosen"
    again, _ = episode_counts._counted(problem, stage, stage.fits[0])
    assert again.members == best.members, "what was chosen needs no more than a better value that leaves no gap"


@pytest.fixture(scope="module")
def delayed(arm, arm_episodes, planted):
    """The problem that a delay poses, its evidence alone, and another effect's."""
    episodes = arm_episodes(planted("actuation_delay", delay_s=MOST), count=12)
    problem = _problem(Replayer(arm), recordings(arm, episodes), Streams(0), None, lambda stage: None)
    stage = look(problem)
    return problem, stage, next(f for f in stage.fits if f.labels != ("actuation_delay",))


def test_where_counting_finds_none_the_likeliest_value_in_its_own_world_is_found(delayed, monkeypatch):
    problem, stage, other = delayed
    monkeypatch.setattr(episode_counts, "_counted", lambda *a: None)
    best, world = episode_counts.recentred(problem, stage, other)
    assert best.labels == ("actuation_delay",)
    assert best.members[0][1][0] == pytest.approx(MOST, rel=0.1)
    assert world.score is not problem.score, "in units of the floor of its own world"
    assert (best.evidence.points == best.members[0][1]).all()


def test_where_each_value_leaves_a_gap_or_foretells_no_more_there_is_none_likeliest(delayed, torn, monkeypatch):
    problem, stage, other = delayed
    assert episode_counts._likeliest(*torn, None) is None, "a third of the episodes have another delay"
    assert episode_counts._likeliest(problem, replace(stage, fits=()), other) is None
    monkeypatch.setattr(episode_counts, "_foretells_more", lambda *a: False)
    assert episode_counts._likeliest(problem, stage, other) is None
    monkeypatch.setattr(episode_counts, "_foretells_more", lambda *a: True)
    assert episode_counts._likeliest(problem, stage, other)
    # What a few episodes promise all of them must keep.
    monkeypatch.setattr(episode_counts, "_leaves", lambda world, point: len(world.recs) == len(problem.recs))
    assert episode_counts._likeliest(problem, stage, other) is None


def test_where_no_value_asked_leaves_no_gap_the_likeliest_one_is_climbed_from(delayed, monkeypatch):
    problem, stage, other = delayed
    c = stage.fits[0].members[0][0]
    assert c.label == "actuation_delay"
    step = episode_counts._step(c, np.array([MOST]), problem)
    far = (c, np.array([MOST + 4.3 * step]))
    _, near = episode_counts._likelier(problem, far, (2.0,))
    assert abs(near[0] - MOST) < 1.5 * step
    real = episode_counts._least
    monkeypatch.setattr(episode_counts, "_leaves", lambda world, point: abs(point[1][0] - MOST) > 1.5 * step)
    monkeypatch.setattr(
        episode_counts, "_least", lambda posed, points, count: real(posed, [far] if count > 1 else points, 1)
    )
    best, _ = episode_counts._likeliest(problem, stage, other)
    assert best.members[0][1][0] == pytest.approx(MOST, rel=0.1)


@pytest.fixture
def pair(torn, arm):
    """A delay that most episodes have, after damping that makes up for nothing."""
    problem, stage = torn
    members = ((candidate("joint_damping", arm), np.array([0.01])), (stage.fits[0].members[0][0], np.array([MOST])))
    return problem, replace(stage.fits[0], members=members)


def only_delay_fits(world, point):
    return point[0].name != "actuation_delay"


def test_in_a_chaotic_world_one_that_leaves_no_gap_alone_stands_for_a_set(pair, monkeypatch):
    problem, found = pair
    monkeypatch.setattr(episode_counts, "null_level", lambda *a: 1.4)
    monkeypatch.setattr(episode_counts, "_leaves", only_delay_fits)
    best, world = episode_counts.alone(problem, found, problem.score)
    assert best.members == found.members[1:]
    assert world.score is not problem.score, "in units of the floor of its own world"
    assert (best.evidence.points == MOST).all()

    def surely(world, members):
        return np.full(len(problem.recs), float(len(members))) + 0.01 * np.arange(len(problem.recs))

    monkeypatch.setattr(episode_counts, "_foretold", surely)
    assert episode_counts.alone(problem, found, problem.score) is None, "the set foretells the recording more surely"


def test_where_contact_is_no_chaos_or_one_alone_leaves_a_gap_a_set_stands(pair, monkeypatch, arm):
    problem, found = pair
    monkeypatch.setattr(episode_counts, "_leaves", only_delay_fits)
    assert episode_counts.alone(problem, found, problem.score) is None, "null sets reach no more than usual"
    monkeypatch.setattr(episode_counts, "null_level", lambda *a: 1.4)
    measured = replace(problem, measured=found.members[:1])
    assert episode_counts.alone(measured, found, problem.score) is None
    assert episode_counts.alone(problem, replace(found, members=found.members[1:]), problem.score) is None
    choice = (candidate("friction_cone", arm), np.array([1.0]))
    vector = (candidate("joint_offset", arm), np.repeat(MOST, 2))
    assert episode_counts.alone(problem, replace(found, members=(choice, vector)), problem.score) is None
    monkeypatch.setattr(episode_counts, "_leaves", lambda *a: True)
    assert episode_counts.alone(problem, found, problem.score) is None


def test_vectors_and_choices_are_not_tried(torn, arm):
    problem, stage = torn
    ((_, u),) = stage.fits[0].members
    vector = replace(stage.fits[0], members=((candidate("joint_offset", arm), np.repeat(u, 2)),))
    assert episode_counts.recentred(problem, replace(stage, fits=(vector,)), None) is None
    assert episode_counts.recentred(problem, replace(stage, fits=()), None) is None


def test_where_one_element_was_found_all_of_them_are_tried_too(torn, arm):
    """By the mean loss one may gain where all of them gain nothing."""
    problem, stage = torn
    whole = stage.fits[0].members[0]
    (elbow,) = [c for c in local_candidates(whole[0], arm) if c.element == "elbow"]
    found = episode_counts._with_all(problem, [(elbow, np.array([0.03]))])
    assert {(c.element, u[0]) for c, u in found} == {(None, 0.03), ("elbow", 0.03)}
    both = episode_counts._with_all(problem, [whole, (elbow, np.array([0.03]))])
    assert {(c.element, u[0]) for c, u in both} == {(None, whole[1][0]), ("elbow", 0.03)}, "each effect once, as found"


def test_values_lie_on_the_side_of_the_fit_and_end_at_the_farthest_probe(torn):
    problem, stage = torn
    best = next(f for f in stage.fits if f.members[0][0].label == "actuation_delay")
    c, u = best.members[0]
    values = [v[0] for _, v in episode_counts._values(c, u, problem)]
    assert len(values) == episode_counts.VALUES
    assert values == sorted(values)
    assert values[0] > 0
    # No probe lies below none.
    beyond = replace(best, members=((c, c.neutral - 0.01),))
    assert episode_counts._values(*beyond.members[0], problem) == []
    assert episode_counts.recentred(problem, replace(stage, fits=(beyond,)), None) is None


@pytest.mark.parametrize(
    ("left", "floors", "remains", "asked"),
    [
        (0.3, 0.1, True, True),
        (0.2, 0.3, True, False),
        (0.9, 0.3, False, True),  # the floor of a chaotic world is high
        (0.9, 0.1, False, False),
    ],
)
def test_episodes_are_counted_where_a_quarter_of_the_gap_is_left(arm, monkeypatch, left, floors, remains, asked):
    found = attribution.Attribution("first look", "a set", ("a set",), "its floor", remains)
    monkeypatch.setattr(attribution, "look", lambda *a: "first look")
    monkeypatch.setattr(attribution, "_search", lambda *a: found)
    monkeypatch.setattr(attribution, "_left", lambda *a: (left, floors))
    monkeypatch.setattr(attribution, "recentred", lambda *a: ("one value", SimpleNamespace(score="another floor")))
    monkeypatch.setattr(attribution, "alone", lambda *a: None)
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=arm), nominal=None, score=None)
    after = attribution.attribute(problem)
    if not asked:
        assert after == replace(found, doubt=after.doubt)
        return
    assert (after.chosen, after.tied, after.score, after.remains) == (
        "one value",
        ("one value",),
        "another floor",
        False,
    )


@pytest.mark.parametrize("tied", [("a set",), ("a set", "another")])
def test_one_of_a_set_is_looked_for_where_nothing_is_tied_with_it(arm, monkeypatch, tied):
    found = attribution.Attribution("first look", "a set", tied, "its floor", False)
    monkeypatch.setattr(attribution, "look", lambda *a: "first look")
    monkeypatch.setattr(attribution, "_search", lambda *a: found)
    monkeypatch.setattr(attribution, "_left", lambda *a: (0.1, 0.3))
    asked = []
    monkeypatch.setattr(attribution, "alone", lambda problem, *a: asked.append(a))
    problem = SimpleNamespace(replayer=SimpleNamespace(scene=arm), nominal=None, score=None)
    assert attribution.attribute(problem).chosen == "a set"
    assert asked == ([("a set", "its floor")] if len(tied) == 1 else [])
