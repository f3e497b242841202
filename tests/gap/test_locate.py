"""Where: the cell that leaves the nulls stands out, and nothing stands out by chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.measure.symptoms import FLIPS, LEVEL, HeatMap, acts_on, locate, symptoms
from candata.schema.report import Symptom

E, BLOCKS, COLUMNS = 12, 12, 3
PHASES = ("free", "onset")


def case(white_score, one_phase, rng):
    """A layout of two phases and three columns, and the score of white nulls."""
    return one_phase(E, BLOCKS, COLUMNS, PHASES), white_score(rng, E, BLOCKS * COLUMNS, columns=COLUMNS)


def recorded(rng, column: int | None = None, phase: int = 0, size: float = 0.0) -> np.ndarray:
    """White residuals `(E, K)`, larger by `size` in one column and phase."""
    z = rng.standard_normal((E, BLOCKS, COLUMNS))
    if column is not None:
        z[:, np.arange(BLOCKS) % 2 == phase, column] += size
    return z.reshape(E, -1).astype(np.float32)


@pytest.mark.parametrize(("column", "phase"), [(0, 0), (2, 1)])
def test_a_planted_excess_has_the_smallest_p(white_score, one_phase, rng, column, phase):
    plan, level = case(white_score, one_phase, rng)
    heat = locate(plan, level, recorded(rng, column, phase, 3.0), rng)
    assert heat.rows == ("joint_position j0", "joint_position j1", "joint_position j2")
    assert np.unravel_index(np.argmin(heat.p), heat.p.shape) == (column, phase)
    assert heat.p[column, phase] < 0.01
    others = np.delete(heat.p.ravel(), column * 2 + phase)
    assert others.min() > LEVEL
    assert heat.ratio.argmax() == column * 2 + phase


def test_the_ratio_is_loss_over_the_nulls_loss(white_score, one_phase, rng):
    plan, level = case(white_score, one_phase, rng)
    heat = locate(plan, level, recorded(rng), rng)
    # Means of 72 losses, whose spread is about their mean, over those of 16 nulls.
    assert np.abs(heat.ratio - 1).max() < 5 / np.sqrt(72)


def test_no_p_is_zero(white_score, one_phase, rng):
    plan, level = case(white_score, one_phase, rng)
    heat = locate(plan, level, recorded(rng, 1, 0, 1e4), rng)
    assert heat.p.min() >= 1 / (FLIPS + 1)
    # Two signs of twelve episodes: the very largest mean comes up by chance once in 4096 flips.
    assert heat.p[1, 0] < 5 / FLIPS


def test_nulls_are_rarely_called_a_gap(white_score, one_phase):
    smallest = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        plan, level = case(white_score, one_phase, rng)
        smallest.append(locate(plan, level, recorded(rng), rng).p.min())
    # Family-wise 5 %: of 60 null sets three are meant, eight come up once in a hundred.
    assert (np.array(smallest) <= LEVEL).sum() <= 8
    assert np.median(smallest) > 0.2


def test_episodes_are_the_unit_of_inference(white_score, one_phase, rng):
    plan, level = case(white_score, one_phase, rng)
    z = recorded(rng)
    z.reshape(E, BLOCKS, COLUMNS)[0, :, 1] += 20.0
    # One wild episode of twelve, however wild, is no evidence.
    assert locate(plan, level, z, rng).p.min() > LEVEL


def test_a_cell_without_data_is_neither_high_nor_low(white_score, one_phase, rng):
    plan, level = case(white_score, one_phase, rng)
    phase = plan.phase.copy()
    phase[:] = 0
    mask = level.mask.reshape(E, BLOCKS, COLUMNS).copy()
    mask[:, :, 2] = False
    heat = locate(replace(plan, phase=phase), replace(level, mask=mask.reshape(E, -1)), recorded(rng), rng)
    assert np.isnan(heat.ratio[:, 1]).all()
    assert np.isnan(heat.p[2]).all()
    assert np.isfinite(heat.p[:2, 0]).all()


def test_symptoms_are_the_cells_that_leave_the_nulls_largest_first(one_phase):
    ratio = np.array([[1.5, 9.0], [4.0, 0.2], [6.0, np.nan]])
    p = np.array([[0.5, 0.001], [0.03, 0.01], [0.2, np.nan]])
    plan = one_phase(2, 2, 3, PHASES)
    found = symptoms(plan, HeatMap(("a", "b", "c"), PHASES, ratio, p))
    assert [(s.element, s.phase, s.ratio, s.p) for s in found] == [
        ("j0", "onset", 9.0, 0.001),
        ("j1", "free", 4.0, 0.03),
    ]


@pytest.mark.parametrize(
    ("channel", "element", "place"),
    [
        ("joint_position", "index2", "joint"),
        ("joint_position", "wrist_x", "wrist"),
        ("fingertip_force", "index2 z", "fingertip"),
        ("object_pose", "rotation x", "object"),
    ],
)
def test_the_worst_symptom_says_what_it_acts_on(channel, element, place):
    worst = Symptom(channel=channel, element=element, ratio=3.0, p=0.001)
    other = Symptom(channel="joint_position", element="thumb1", ratio=2.0, p=0.001)
    assert acts_on((worst, other), ["wrist_x"]) == place
    assert acts_on((), ["wrist_x"]) is None
