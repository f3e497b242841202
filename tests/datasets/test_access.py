"""Episodes by place, slice and id, and what a notebook shows of a dataset."""

from __future__ import annotations

import pytest

from candata.datasets import open_dataset
from candata.errors import UnknownNameError


@pytest.fixture
def data(dataset):
    return open_dataset(dataset("cups", "dbca", object="cup <b>"))


def test_places_follow_the_order_of_ids(data):
    assert [data[i].meta.id for i in range(len(data))] == list(data.ids) == [e.meta.id for e in data]
    assert data[-1].meta.id == "d"


def test_a_slice_is_a_list_of_episodes(data):
    assert [e.meta.id for e in data[1:3]] == ["b", "c"]
    assert [e.meta.id for e in data[::-2]] == ["d", "b"]
    assert data[9:] == []


def test_an_id_is_a_key(data):
    assert data["c"].meta.id == "c"
    assert "c" in data
    assert "e" not in data
    with pytest.raises(UnknownNameError, match="unknown episode 'e'"):
        data["e"]


@pytest.mark.parametrize("place", [4, -5])
def test_a_place_outside_is_an_index_error(data, place):
    with pytest.raises(IndexError, match=r"of cups: it has 4 \(0 to 3\)"):
        data[place]


def test_a_dataset_is_one_line(data):
    assert repr(data) == f"Dataset('cups', version 1, 4 episodes, digest {data.digest[:12]})"


def test_a_notebook_shows_the_first_episodes_as_text(dataset):
    html = open_dataset(dataset("many", "abcdefghijklmnop", object="cup <b>"))._repr_html_()
    assert html.count("cup &lt;b&gt;") == 12
    assert "<b>cup" not in html
    assert "4 more rows are not shown" in html
