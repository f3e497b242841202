"""The edit test: what was named in one world is tried in another, as it is."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, UnknownNameError, UsageError
from candata.gap.data.recordings import recordings
from candata.gap.measure import floor
from candata.gap.replay import replayer
from candata.gap.replay.replayer import Replayer
from candata.gap.run.streams import Streams
from candata.gap.verdict import edit_test as edit
from candata.gap.verdict.edit_test import KEPT, edit_test
from candata.schema.effect import EffectSetting
from candata.simulate import rollout

#: The damping planted in the real arm [N m s/rad], large beside the modelled 0.05.
TRUE = 0.4
#: Rows of an episode: one second.
ROWS = 100


def damping(value: float, element: str | None = None) -> tuple[EffectSetting, ...]:
    return (EffectSetting(name="joint_damping", element=element, parameters={"damping_Nms_rad": value}),)


@pytest.fixture(scope="module")
def other(arm_episodes, as_dataset):
    """Recordings of other motions in the damped world."""
    return as_dataset(arm_episodes(damping(TRUE), seed=9, rows=ROWS))


@pytest.fixture(scope="module")
def kept(arm, other):
    """The test of the true effect."""
    return edit_test(other, arm, damping(TRUE), reference=0.97)


def test_the_true_effect_keeps_what_it_closed(arm, kept):
    found = kept
    assert found.before > 2
    # The same world but for noise: what remains is the floor, within the luck of eight episodes.
    assert found.after == pytest.approx(1, abs=0.3)
    assert found.closed > KEPT * 0.97
    assert found.low > 0
    assert (found.kept, found.episodes, found.scene) == (True, 8, arm.name)


def test_an_effect_that_only_looked_right_elsewhere_is_not_kept(arm, other):
    found = edit_test(other, arm, damping(0.1), reference=0.97)
    assert 0 < found.closed < 0.6
    assert found.kept is False
    # It would do if no more had closed there.
    assert found.closed > KEPT * 0.3
    assert edit_test(other, arm, damping(0.1), reference=0.3).kept is True


def test_a_wrong_effect_is_not_kept(arm, other):
    wrong = (EffectSetting(name="servo_gain", parameters={"kp_scale": 2.0}),)
    assert edit_test(other, arm, wrong, reference=0.97).kept is False


def test_without_a_gap_there_is_nothing_to_keep(arm, arm_episodes, as_dataset):
    same = as_dataset(arm_episodes(seed=4, rows=ROWS))
    mild = edit_test(same, arm, damping(0.0))
    assert (mild.closed, mild.kept) == (None, None)
    harmful = edit_test(same, arm, damping(TRUE))
    assert harmful.after > 2
    assert (harmful.closed, harmful.kept) == (None, False)


def test_it_does_not_depend_on_the_number_of_threads(arm, other, kept):
    assert edit_test(other, arm, damping(TRUE), reference=0.97, jobs=2) == kept


@pytest.mark.parametrize("count", [9, 13])
def test_however_many_episodes_few_are_simulated_at_a_time(arm, arm_episodes, monkeypatch, count):
    recs, worlds = recordings(arm, arm_episodes(damping(TRUE), count=count, rows=ROWS)), []
    args = Replayer(arm), recs, damping(TRUE)
    whole = edit.replayed(*args, Streams(1), 2)
    monkeypatch.setattr(edit, "MANY", 4)
    for module in (replayer, floor):
        monkeypatch.setattr(module, "rollout", lambda *a, **k: (worlds.append(len(a[1])), rollout(*a, **k))[1])
    found = edit.replayed(*args, Streams(1), 2)
    # A block of at most four episodes: with and without the effect, or two nulls of each.
    assert max(worlds) <= 8
    assert found.recs is recs
    for name, values in whole.after.items():
        np.testing.assert_array_equal(found.after[name], values)
    assert found.score.null.shape == whole.score.null.shape
    # The floors are of other noise: two nulls of an episode tell its spread to about a third.
    np.testing.assert_allclose(found.size_before, whole.size_before, rtol=0.6)


def test_what_does_not_fit_is_refused(arm, cube, other, arm_episodes, as_dataset):
    with pytest.raises(UsageError, match="no effects"):
        edit_test(other, arm, ())
    with pytest.raises(UsageError, match="cannot act"):
        edit_test(other, cube, damping(TRUE))
    with pytest.raises(UnknownNameError, match="wrist"):
        edit_test(other, arm, damping(TRUE, "wrist"))
    with pytest.raises(DataError, match="too few"):
        edit_test(as_dataset(arm_episodes(count=3)), arm, damping(TRUE))
    friction = (EffectSetting(name="sliding_friction", parameters={"scale": 0.5}),)
    with pytest.raises(DataError, match="rate"):
        edit_test(other, cube, friction)
