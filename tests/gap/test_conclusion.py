"""What a report says of a name: its support, and a number that stopped at the end of what is possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.problem import fit_one
from candata.gap.fit.stage import Stage
from candata.gap.preparation import _problem
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.screening.signature_screen import respond
from candata.gap.search.attribution import Attribution
from candata.gap.validation.closure import held_out
from candata.gap.verdict import conclusion
from candata.gap.verdict.conclusion import concluded
from candata.gap.verdict.findings import Findings


@pytest.mark.parametrize(("part", "stopped"), [(0.5, False), (0.001, False), (0.999, True), (1.0, True)])
def test_a_little_more_than_nothing_is_not_at_its_bound(arm, part, stopped):
    """Of a friction that cannot be less than none."""
    c = candidate("joint_dry_friction", arm)
    assert c.low == c.neutral
    assert conclusion._is_at_bound(c, c.low + part * (c.high - c.low)) is stopped


@pytest.mark.parametrize("end", ["low", "high"])
def test_either_end_of_what_lies_around_the_model_s_own_is_a_bound(arm, end):
    c = candidate("servo_gain", arm)
    assert c.low < c.neutral < c.high
    assert conclusion._is_at_bound(c, getattr(c, end))


def test_one_number_of_several_is_enough_and_a_choice_has_no_bound(arm):
    c = candidate("joint_offset", arm)
    u = c.neutral.copy()
    assert not conclusion._is_at_bound(c, u)
    u[1] = c.high[1]
    assert conclusion._is_at_bound(c, u)
    choice = candidate("integrator", arm)
    assert not conclusion._is_at_bound(choice, choice.high)


@pytest.fixture(scope="module")
def named_alone(arm, arm_episodes, planted, as_dataset):
    """The function that returns the support of one of three effects, named alone, on recordings with damped joints."""
    made = arm_episodes(planted("joint_damping", damping_Nms_rad=0.3), count=8)
    recs = recordings(arm, made)
    problem = _problem(Replayer(arm), recs, Streams(0), None, lambda stage: None)
    base = problem.score.loss(problem.nominal)
    effects = [candidate(name, arm) for name in ("joint_damping", "servo_damping", "armature")]
    fits = {c.name: fit_one(problem, c, r, base) for c, r in respond(problem, problem.nominal, effects)[0]}
    fits = dict(sorted(fits.items(), key=lambda pair: -pair[1].gain))

    def ask(name: str, looked_at: tuple[str, ...]) -> float:
        first = Stage(base, np.zeros((1, len(base))), tuple(fits[n] for n in fits if n in looked_at), 0, (), (), (), 0)
        found = Attribution(first, fits[name], (fits[name],), problem.score, True)
        # What it leaves is set to little, so that any name is claimed: the support is what is asked for.
        held = replace(held_out(problem, fits[name]), size_before=np.full(8, 3.0), size_after=np.full(8, 1.01))
        (effect,) = concluded(Findings(as_dataset(made), arm, problem, found, problem, held, 8)).report.effects
        return effect.support

    return ask, tuple(fits)


def test_a_single_name_has_its_own_support_not_that_of_the_best_effect(named_alone):
    support, names = named_alone
    best, worst = names[0], names[-1]
    assert support(best, names) > 0.9
    assert support(worst, names) < 0.1


def test_a_name_that_was_not_looked_at_alone_is_compared_with_those_that_were(named_alone):
    support, names = named_alone
    best, worst = names[0], names[-1]
    assert support(best, names[1:]) > 0.9
    assert support(worst, names[:-1]) < 0.1
