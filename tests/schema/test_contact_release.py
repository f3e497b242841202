"""Contact with a release: on above the threshold, off below the release, held between."""

from __future__ import annotations

import numpy as np

from candata.schema.contact import contact_of_totals, fingertip_contact
from candata.schema.episode import ContactRule

TOTAL = np.array([0.25, 0.31, 0.3, 0.2, 0.19, 0.25, 0.4, np.nan, 0.25])


def test_contact_is_held_between_release_and_threshold_and_ends_at_what_was_not_read():
    flags = contact_of_totals(TOTAL[:, None], 0.3, 0.2)[:, 0]
    assert flags.astype(int).tolist() == [0, 1, 1, 1, 0, 0, 1, 0, 0]
    assert contact_of_totals(TOTAL[:, None], 0.3)[:, 0].astype(int).tolist() == [0, 1, 0, 0, 0, 0, 1, 0, 0]


def test_it_goes_on_from_the_flags_before_as_if_it_were_one_recording(rng):
    force = rng.uniform(0, 0.2, (200, 3, 3))
    whole = fingertip_contact(force, 0.3, 0.25)
    first = fingertip_contact(force[:70], 0.3, 0.25)
    rest = fingertip_contact(force[70:], 0.3, 0.25, first[-1])
    assert np.array_equal(np.concatenate([first, rest]), whole)
    assert (np.diff(whole.astype(int), axis=0) != 0).sum() < (
        np.diff(fingertip_contact(force, 0.3).astype(int), axis=0) != 0
    ).sum()


def test_a_rule_without_a_release_reads_and_writes_as_before():
    assert "release_n" not in ContactRule().model_dump()
    assert ContactRule(release_n=0.2).model_dump()["release_n"] == 0.2
