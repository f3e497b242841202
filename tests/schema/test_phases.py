from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.schema.phases import CONTACT_PHASES, contact_phases


def letters(contact, rate_hz=40.0):
    """Return f, o, s, r a row; at 40 Hz 100 ms are 4 rows."""
    flags = [c == "#" for c in contact]
    return "".join(phase[0] for phase in contact_phases(flags, rate_hz))


@pytest.mark.parametrize(
    ("contact", "phases"),
    [
        ("..........", "ffffffffff"),
        ("##########", "ssssssssss"),
        ("...######...", "fffoooorrrrf"),
        ("...############...", "fffoooossssssrrrrf"),
        ("..##......", "ffoorrffff"),
        ("#####.#####", "sssrrroooos"),
        ("", ""),
        ("#", "s"),
    ],
)
def test_phases_of_a_contact(contact, phases):
    assert letters(contact) == phases


@given(st.lists(st.booleans(), max_size=60), st.floats(1, 1000))
def test_free_has_no_contact_and_sustained_and_onset_have_it(contact, rate_hz):
    flags, phases = np.array(contact, bool), contact_phases(contact, rate_hz)
    assert len(phases) == len(flags)
    assert set(phases) <= set(CONTACT_PHASES)
    assert not flags[phases == "free"].any()
    assert flags[(phases == "sustained") | (phases == "onset")].all()


@pytest.mark.parametrize(("contact", "rate_hz"), [([[True]], 80.0), ([True], 0.0)])
def test_wrong_input_is_refused(contact, rate_hz):
    with pytest.raises(ValueError, match="expected contact"):
        contact_phases(contact, rate_hz)
