"""npz tables whose arrays hold objects, or that are no npz: our words, and nothing is unpickled."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from candata.errors import DataError
from candata.formats import table
from tests.formats.made_sets import write_map


@pytest.fixture
def read(tmp_path):
    """Reads the table t.npz, of which `data` are the bytes or the arrays."""

    def reading(data):
        if isinstance(data, bytes):
            (tmp_path / "t.npz").write_bytes(data)
        else:
            np.savez(tmp_path / "t.npz", **data)
        fields = {"file": "t.npz", "time_s": "t", "rate_hz": 50, "channels": {"joint_position": ["q"]}}
        return list(table.read(write_map(tmp_path / "map.yaml", **fields)))

    return reading


def columns(**more):
    return {"t": np.arange(5) / 50, "q": np.zeros(5)} | more


def test_an_array_of_objects_is_refused_where_it_is_asked_for(read):
    with pytest.raises(DataError) as caught:
        read(columns(q=np.array([None] * 5)))
    assert str(caught.value).splitlines()[:3] == [
        "the table cannot be read",
        "  expected: a npz file",
        "  found: Python objects in the array q, which are not unpickled: they could run anything",
    ]
    assert "pickle=" not in str(caught.value)
    assert len(read(columns(others=np.array([None] * 5)))) == 1


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (b"", "no bytes"),
        (b"t,q\n0,1\n", "a file that begins b't,q\\n0,1\\n'"),
        (b"PK\x03\x04 and no end", "a zip file without its end: it was cut"),
        (pickle.dumps([1]), "a file that begins "),
    ],
)
def test_a_file_that_is_no_npz_says_what_it_is(read, data, found):
    with pytest.raises(DataError, match="the table cannot be read") as caught:
        read(data)
    assert caught.value.found.startswith(found)
    assert "pickle=" not in str(caught.value)
