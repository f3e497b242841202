"""Formats for learning: what candata exports comes back bit for bit."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from candata.datasets.encode import content_hash
from candata.errors import DataError
from candata.formats import Reading, Writing
from candata.plugins import load
from candata.schema.episode import Episode
from tests.formats._episodes import episode_sets

pytest.importorskip("h5py")
#: Format and variant.
WAYS = [("lerobot", None), ("lerobot", "v21"), ("robomimic", None), ("diffusion_policy", None)]


def export(name: str, episodes, folder: Path, variant: str | None = None, note=lambda line: None) -> Path:
    folder.mkdir()
    load("candata.formats", "FORMAT", name).write(episodes, folder, Writing("set", "d" * 64, (), variant, note))
    return folder


def read(name: str, source: Path, **told):
    return load("candata.formats", "FORMAT", name).read(source, Reading(**told))


@pytest.mark.parametrize(("name", "variant"), WAYS)
@settings(max_examples=15)
@given(episodes=episode_sets())
def test_episodes_come_back_bit_for_bit(name, variant, episodes):
    with tempfile.TemporaryDirectory() as folder:
        out = export(name, episodes, Path(folder) / "out", variant)
        back = list(read(name, out))
    assert [one.meta for one in back] == [one.meta for one in episodes]
    assert [content_hash(one) for one in back] == [content_hash(one) for one in episodes]


@pytest.mark.parametrize(("name", "variant"), WAYS)
def test_rates_that_differ_are_refused(name, variant, episode, tmp_path):
    with pytest.raises(DataError, match="the episodes differ in rate_hz"):
        export(name, [episode("a"), episode("b", rate_hz=50.0)], tmp_path / "out", variant)


@pytest.mark.parametrize(("name", "variant"), WAYS)
def test_an_export_without_episodes_is_refused(name, variant, tmp_path):
    with pytest.raises(DataError, match="no episode to export"):
        export(name, [], tmp_path / "out", variant)


@pytest.mark.parametrize(("name", "variant"), WAYS)
def test_uneven_stamps_and_missing_channels_are_said(name, variant, episode, tmp_path):
    whole, other = episode("a"), episode("b", contact=False)
    late = Episode(other.meta, {**other.arrays, "time_ns": other["time_ns"] + 10**6 * (np.arange(20) > 9)})
    notes = []
    out = export(name, [whole, late], tmp_path / "out", variant, notes.append)
    text = "\n".join(notes)
    assert "1 of 2 episodes have stamps off the beat" in text
    assert "1 of 2 episodes have no contact: filled with zeros, marked as not valid" in text
    assert [content_hash(one) for one in read(name, out)] == [content_hash(whole), content_hash(late)]
