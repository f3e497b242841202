"""A normal DataLoader takes whole batches; their tensors share the batch's memory."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from candata.errors import MissingExtraError
from candata.loaders import Sampler, as_tensors, windows


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


def test_tensors_hold_what_the_batch_holds(hand, store):
    pytest.importorskip("torch")
    feed = windows(store(hand("a", 50)), 3, 2, stride=2)
    batch = feed.batch(Sampler(len(feed), 8).indices(3))
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
