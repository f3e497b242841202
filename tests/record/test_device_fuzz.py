"""Ten thousand mutated inputs: no framer or decoder breaks, and no wrong frame passes beyond its check's odds."""

import pytest

from tests.mutated.streams import CHECK_BITS, fuzz

#: 1e4 inputs in all; `benchmarks/fuzz_devices.py` runs a million.
INPUTS = 10_000 // len(CHECK_BITS)


@pytest.mark.parametrize("name", sorted(CHECK_BITS))
def test_mutated_streams_break_nothing(name):
    tally = fuzz(name, INPUTS, seed=11)
    assert tally.sound > INPUTS / 2
    if bits := CHECK_BITS[name]:
        assert tally.refused > INPUTS / 2
        assert tally.wrong <= tally.most_wrong(bits)
