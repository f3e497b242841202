"""Mutated files of every format, store and text: whatever is read is refused by an error of candata's, or sound."""

from __future__ import annotations

import pytest

from tests.mutated.readers import FORMATS, MESHES, READERS, STORES, TEXTS
from tests.mutated.running import MOST_BYTES, READ, REFUSED, run_readers, tally

GROUPS = {"formats": tuple(FORMATS), "stores": tuple(STORES), "texts": tuple(TEXTS), "meshes": tuple(MESHES)}
#: Inputs of the long test, of all readers together.
INPUTS = 10_000


def check(names, seed, each, out):
    """Read mutated inputs of some readers, each within its bounds of memory and time."""
    run_readers(names, seed, each, out)
    for name in names:
        found = tally(name, out)
        assert not found.failures, f"python benchmarks/mutated_inputs.py --show {found.failures[0][0]}"
        assert found.counts[READ.decode()] + found.counts[REFUSED.decode()] == each
        assert found.peak_bytes <= MOST_BYTES


@pytest.mark.hard
@pytest.mark.parametrize("group", GROUPS)
def test_a_few_mutated_inputs_of_every_reader(group, tmp_path):
    check(GROUPS[group], 1, 15, tmp_path)


@pytest.mark.hard
@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_ten_thousand_mutated_inputs(name, tmp_path):
    check([name], 2, -(-INPUTS // len(READERS)), tmp_path)
