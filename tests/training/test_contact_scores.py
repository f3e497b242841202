"""When contacts begin and end, against the recording; AUROC by ranks."""

from __future__ import annotations

import numpy as np
import pytest

from candata.training.contact_scores import contact_scores, event_timing
from candata.training.metrics import auroc

RATE_HZ = 10.0


def flags(text: str) -> np.ndarray:
    return np.array([[character == "#" for character in text]])


def timing(forecast: str, truth: str, is_onset: bool, valid: str | None = None):
    present = np.zeros(1, bool)
    valid_rows = np.ones((1, len(truth)), bool) if valid is None else flags(valid)
    return event_timing(flags(forecast).astype(float), flags(truth), present, valid_rows, RATE_HZ, is_onset)


def test_a_late_onset_and_an_early_release_are_signed_seconds():
    onset, release = (timing("....####....", "..########..", is_onset) for is_onset in (True, False))
    assert (onset.recorded, onset.matched, onset.spurious) == (1, 1, 0)
    assert onset.median_s == pytest.approx(0.2)
    assert release.median_s == pytest.approx(-0.2)


def test_each_event_answers_once_and_far_ones_not_at_all():
    found = timing(".#.#" + 30 * ".", "..##" + 20 * "." + "##" + 8 * ".", is_onset=True)
    # The recorded onsets are at steps 2 and 24: the first is answered by one of those at 1 and 3, the second by none.
    assert (found.recorded, found.matched, found.spurious) == (2, 1, 1)
    assert abs(found.median_s) == pytest.approx(0.1)


def test_a_change_across_rows_that_do_not_count_is_no_event():
    assert timing("....####", "...#####", True, valid="##..####").recorded == 0


def test_no_event_has_no_lateness_and_no_contact_no_timing():
    found = timing("........", "........", is_onset=True)
    assert (found.recorded, found.median_s, found.q25_s) == (0, None, None)
    assert event_timing(None, flags("#"), np.zeros(1, bool), flags("#"), RATE_HZ, True) is None
    assert contact_scores(None, flags("#"), flags("#")) is None


def test_auroc_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    scores, truth = rng.integers(0, 5, 60) / 4, rng.random(60) < 0.4
    true_scores, false_scores = scores[truth][:, None], scores[~truth][None]
    by_pairs = ((true_scores > false_scores) + 0.5 * (true_scores == false_scores)).mean()
    assert auroc(scores, truth) == pytest.approx(by_pairs, abs=1e-12)
    assert auroc(truth.astype(float), truth) == 1.0
    assert auroc(np.ones(60), truth) == pytest.approx(0.5)
    assert auroc(scores, np.ones(60, bool)) is None
