"""The filmstrip beside the traces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.reports.filmstrip import COLUMNS, filmstrip, moments
from candata.reports.render import DRAWN_NOTE, RenderedFrames


def test_three_rows_of_six_and_a_note_without_gl(full_evidence, hand, no_gl, small_pictures):
    text = filmstrip(hand, full_evidence.example, "repaired")
    assert text.count("<img ") == 3 * COLUMNS
    assert text.count("data:image/png;base64,") == 3 * COLUMNS
    assert DRAWN_NOTE in text


def test_the_recording_is_a_ghost_over_the_simulations(monkeypatch, full_evidence, hand):
    """None stands over the recording itself; each simulation has the recording of its moment."""
    ghosts = []

    def render(model, qpos, camera, width, height, ghost):
        ghosts.append((qpos, ghost))
        return RenderedFrames(tuple(np.zeros((2, 2, 3), np.uint8) for _ in qpos), None)

    monkeypatch.setattr("candata.reports.filmstrip.render_frames", render)
    filmstrip(hand, full_evidence.example, "repaired")
    ((qpos, ghost),) = ghosts
    recorded, nominal, repaired = np.split(ghost.qpos, 3)
    assert np.isnan(recorded).all()
    assert np.array_equal(nominal, qpos[:COLUMNS])
    assert np.array_equal(repaired, qpos[:COLUMNS])
    assert hand.ngeom - len(ghost.geoms) == 2, "floor and table stand still"


def test_it_is_left_out_without_a_model_or_with_other_positions(full_evidence, hand):
    example = full_evidence.example
    assert filmstrip(None, example, "repaired") == ""
    assert filmstrip(hand, replace(example, qpos_before=np.zeros((3, 2))), "repaired") == ""
    invalid_example = replace(example, qpos_real=np.full_like(example.qpos_real, np.nan))
    assert filmstrip(hand, invalid_example, "repaired") == ""


def test_moments_spread_over_the_rows_that_are_known(full_evidence):
    example = full_evidence.example
    real = example.qpos_real.copy()
    real[:100] = np.nan
    steps = moments(replace(example, qpos_real=real))
    assert len(steps) == COLUMNS
    assert steps[0] == 100
    assert steps[-1] == len(example.time_s) - 1


def test_a_short_episode_shows_each_moment_once(full_evidence):
    example = full_evidence.example
    short_example = replace(
        example,
        time_s=example.time_s[:3],
        qpos_real=example.qpos_real[:3],
        qpos_before=example.qpos_before[:3],
        qpos_after=None,
    )
    assert moments(short_example).tolist() == [0, 1, 2]
