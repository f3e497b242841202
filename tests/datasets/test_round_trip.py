"""Whatever an Episode can hold comes back bit for bit."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from candata.datasets import append, content_hash, create_dataset, open_dataset
from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


@st.composite
def arrays(draw):
    sizes = {"T": draw(st.integers(1, 6)), "J": draw(st.integers(0, 3)), "A": 2, "F": draw(st.integers(1, 3)), "N": 4}
    state = draw(st.sampled_from(["object_pose", "joint_position"]))
    names = draw(st.sets(st.sampled_from([n for n in CHANNELS if n != "time_ns"]))) | {state, "time_ns"}
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    found = {name: _values(name, sizes, rng) for name in names}
    for name in draw(st.sets(st.sampled_from(sorted(names - {"time_ns"})))):
        valid = rng.random(sizes["T"]) > 0.5
        found[name + "_valid"] = valid
        if found[name].dtype.kind == "f":
            found[name][~valid] = draw(st.sampled_from([np.nan, np.inf, -0.0]))
    return found


def _values(name, sizes, rng):
    if name == "time_ns":
        return np.cumsum(rng.integers(1, 2**40, sizes["T"]))
    shape = tuple(sizes[d] if isinstance(d, str) else d for d in CHANNELS[name].shape)
    if CHANNELS[name].dtype == "bool":
        return rng.random(shape) > 0.5
    if CHANNELS[name].dtype == "int16":
        return rng.integers(-(2**15), 2**15, shape).astype(np.int16)
    values = rng.normal(size=shape).astype(np.float32)
    if name in QUATERNION:
        values[:, QUATERNION[name]] = [1, 0, 0, 0]
    return values


metas = st.builds(
    EpisodeMeta,
    id=st.text(min_size=1, max_size=8).filter(lambda t: t.isprintable()),
    source=st.sampled_from(["sim", "real"]),
    rate_hz=st.floats(1, 1000),
    seed=st.none() | st.integers(0, 2**80),
    object=st.none() | st.text(max_size=3).filter(lambda t: t.isprintable()),
    effects=st.none() | st.just((EffectSetting(name="x", parameters={"v": (1.0, 2.0), "w": "cone"}),)),
    invalid_counts=st.dictionaries(st.sampled_from(list(CHANNELS)), st.integers(0, 9), max_size=2),
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(metas, arrays()), min_size=1, max_size=4, unique_by=lambda pair: pair[0].id))
def test_round_trip(pairs):
    written = {meta.id: Episode(meta, found) for meta, found in pairs}
    with tempfile.TemporaryDirectory() as folder:
        root = create_dataset(Path(folder) / "ds")
        append(root, written.values(), Lineage(operation="test"), part_size=2)
        dataset = open_dataset(root)
        assert dataset.ids == tuple(sorted(written))
        for episode in dataset:
            original = written[episode.meta.id]
            assert episode.meta == original.meta
            assert list(episode.arrays) == list(original.arrays)
            assert all(a.tobytes() == original[n].tobytes() for n, a in episode.arrays.items())
            assert content_hash(episode) == content_hash(original)
        assert len(dataset.catalog()) == len(written)
