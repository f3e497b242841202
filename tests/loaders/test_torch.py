"""A normal DataLoader takes whole batches, with any number of workers; a resident copy gives the same, bit for bit."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from candata.errors import MissingExtraError, SetupError
from candata.loaders import as_tensors, batches, mix, resident, windows


def test_a_dataloader_gives_every_window_once(hand, store):
    torch = pytest.importorskip("torch")
    feed = windows(store(hand("a", 50), hand("b", 40)), 3, 2, stride=2)
    generator = torch.Generator().manual_seed(0)
    loader = torch.utils.data.DataLoader(
        feed, batch_size=16, shuffle=True, collate_fn=as_tensors, num_workers=0, generator=generator
    )
    batches = list(loader)
    assert batches[0]["history/fingertip_force"].shape == (16, 3, 1, 3)
    assert batches[0]["future/contact"].dtype == torch.bool
    met = sorted((int(e), int(r)) for b in batches for e, r in zip(b["episode"], b["row"], strict=True))
    assert met == [(0, r) for r in range(46)] + [(1, r) for r in range(36)]


def test_a_plain_dataloader_gives_the_same_batches(mixed):
    pytest.importorskip("torch")
    sampler = mixed.sampler(16, seed=2)
    plain = loaded(mixed, sampler, collate_fn=None)
    assert len(plain) == 6
    for step, batch in enumerate(plain, 3):
        equal(batch, mixed.batch(sampler.indices(step)))


def test_windows_are_one_line(mixed):
    feed = mixed.sources[1]
    assert repr(feed) == f"Windows('other', {len(feed)} windows, 3 rows of history, 2 steps ahead at 40 Hz)"
    assert repr(feed) in repr(mixed)


def test_tensors_hold_what_the_batch_holds(hand, store):
    pytest.importorskip("torch")
    feed = windows(store(hand("a", 50)), 3, 2, stride=2)
    batch = feed.batch(feed.sampler(8).indices(3))
    tensors = as_tensors(batch)
    assert set(tensors) == set(batch)
    for name, values in batch.items():
        np.testing.assert_array_equal(tensors[name].numpy(), values)
        assert np.shares_memory(tensors[name].numpy(), values)


def test_without_torch_only_the_tensors_are_missing(hand, store, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    feed = windows(store(hand("a", 50)), 3, 2, stride=2)
    with pytest.raises(MissingExtraError, match=r"candata\[train\]"):
        as_tensors(feed.batch([0]))
    with pytest.raises(MissingExtraError, match=r"candata\[train\]"):
        feed.resident("cpu")


@pytest.fixture
def mixed(hand, store):
    """Two sources, one of them with invalid rows and a break."""
    time_ns = np.arange(50) * 12_500_000 + np.where(np.arange(50) < 20, 0, 500_000_000)
    arrays = {"object_pose_valid": np.arange(50) != 12, "time_ns": time_ns}
    one = store(hand("a", 50, arrays=arrays), hand("b", 40, offset=100), name="one")
    other = store(hand("a", 40, offset=1000), name="other")
    feeds = {name: windows(dataset, 3, 2, stride=2) for name, dataset in (("one", one), ("other", other))}
    return mix(feeds, "one:0.75,other:0.25")


def equal(batch, expected):
    assert set(batch) == set(expected)
    for name, values in batch.items():
        assert values.numpy().dtype == expected[name].dtype
        np.testing.assert_array_equal(values.numpy(), expected[name])


def loaded(feed, sampler, **how):
    from torch.utils.data import DataLoader

    return list(DataLoader(feed, batch_sampler=sampler.steps(3, 9), **{"collate_fn": as_tensors} | how))


@pytest.mark.filterwarnings("ignore:This DataLoader will create")  # on a machine of one core
def test_workers_change_no_bit(mixed):
    """Steps 3 to 8 of a run, read directly, by a DataLoader in this process, and by forked workers."""
    pytest.importorskip("torch")
    sampler = mixed.sampler(16, seed=11, rank=1, world=2)
    direct = [mixed.batch(sampler.indices(step)) for step in range(3, 9)]
    for how in ({}, {"num_workers": 2, "multiprocessing_context": "fork", "prefetch_factor": 3}):
        for sent in ({}, {"collate_fn": dict}):
            found = loaded(mixed, sampler, **how, **sent)
            assert len(found) == len(direct)
            for batch, expected in zip(found, direct, strict=True):
                equal(as_tensors(batch) if sent else batch, expected)


@pytest.mark.slow
def test_a_spawned_worker_changes_no_bit(mixed):
    """It knows nothing of this process and maps the caches anew; it imports torch, which takes seconds."""
    sampler = mixed.sampler(16, seed=11)
    found = loaded(mixed, sampler, num_workers=1, multiprocessing_context="spawn")
    for step, batch in enumerate(found, 3):
        equal(batch, mixed.batch(sampler.indices(step)))


def test_steps_may_be_read_again(mixed):
    steps = mixed.sampler(16).steps(3, 9)
    assert len(steps) == 6
    first, again = (np.concatenate(list(steps)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len(mixed.sampler(16).steps(9, 3)) == len(list(mixed.sampler(16).steps(9, 3))) == 0


def test_a_resident_copy_gives_the_same_batches(mixed):
    pytest.importorskip("torch")
    for feed in (*mixed.sources, mixed):
        copy, numbers = feed.resident("cpu"), np.random.default_rng(0).permutation(len(feed))
        assert len(copy) == len(feed)
        equal(copy.batch(numbers), feed.batch(numbers))
        equal(copy.batch([-1]), feed.batch([-1]))
    sampler = mixed.sampler(8, seed=1)
    equal(next(batches(mixed.resident("cpu"), sampler, 5)), next(batches(mixed, sampler, 5)))


def test_a_number_out_of_range_is_refused_by_every_feed(mixed):
    pytest.importorskip("torch")
    for feed in (mixed, mixed.sources[0], mixed.resident("cpu")):
        for number in (len(feed), -len(feed) - 1):
            with pytest.raises(IndexError):
                feed.batch([0, number])


def test_rows_that_do_not_fit_are_refused(mixed, monkeypatch):
    """No GPU at hand: what one would say is put in its place."""
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (1000, 2000))
    with pytest.raises(SetupError, match=r"do not fit on cuda:0") as caught:
        resident.move(mixed.gather, [one.cache.rows for one in mixed.sources], "cuda:0")
    assert caught.value.exit_code == 3
    assert resident.free_bytes("cpu") is None
