"""Formats for learning: what candata exports comes back bit for bit; damage to it is one clear error."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from candata.datasets.encode import content_hash
from candata.errors import CandataError, DataError
from candata.formats import Reading, Writing
from candata.plugins import load
from candata.schema.episode import Episode
from tests.conftest import make_episode
from tests.formats._damage import damaged_copy, damages, only_own_errors
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


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    """An export in each way, of three episodes, and what they were."""
    episodes = [make_episode(f"e{k}", seed=k, rows=40, task="pick") for k in range(3)]
    root = tmp_path_factory.mktemp("exports")
    made = {(n, v): export(n, episodes, root / f"{n}-{v}", v) for n, v in WAYS}
    return made, {one.meta.id: content_hash(one) for one in episodes}


def check_damaged(way, damage, exports, target):
    """Import a damaged export: its own errors alone, and no exported episode with other content."""
    made, intact = exports
    damaged_copy(made[way], target, damage)
    found = only_own_errors(lambda: read(way[0], target))
    if not isinstance(found, CandataError):
        for one in found:
            assert intact.get(one.meta.id) in (None, content_hash(one))


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=25)
@given(damage=damages())
def test_a_damaged_export_is_refused_or_read_whole(way, damage, exports, tmp_path_factory):
    check_damaged(way, damage, exports, tmp_path_factory.getbasetemp() / f"damaged-{way[0]}-{way[1]}")


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=1000)
@given(damage=damages())
def test_much_damage_is_refused_or_read_whole(way, damage, exports, tmp_path_factory):
    check_damaged(way, damage, exports, tmp_path_factory.getbasetemp() / f"worse-{way[0]}-{way[1]}")


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
