"""Episodes with everything optional, for round trips through foreign formats."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.episode import Episode, EpisodeMeta

#: Names as people give them; the surrogates of JSON are no text.
_WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=6)
_OPTIONAL = sorted(set(CHANNELS) - {"time_ns", "object_pose", "joint_position"})


@st.composite
def episode_sets(draw) -> list[Episode]:
    """Return one to three episodes of one rate and one hand, with channels that come and go."""
    sizes = {"J": draw(st.integers(0, 3)), "A": draw(st.integers(0, 2)), "F": draw(st.integers(0, 2)), "N": 2}
    named = draw(st.booleans())
    unique = st.lists(_WORDS, min_size=3, max_size=3, unique=True)
    fields = {
        "rate_hz": draw(st.sampled_from([30.0, 80.0, 12.5])),
        "joint_names": tuple(draw(unique)[: sizes["J"]]) if named else (),
        "actuator_names": tuple(draw(unique)[: sizes["A"]]) if named else (),
        "fingertip_names": tuple(draw(unique)[: sizes["F"]]) if named else (),
    }
    ids = draw(st.lists(_WORDS, min_size=1, max_size=3, unique=True))
    return [draw(_episodes(name, sizes, fields)) for name in ids]


@st.composite
def _episodes(draw, name: str, sizes: dict[str, int], fields: dict) -> Episode:
    """Return one episode."""
    rows = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    always = ["object_pose"] if draw(st.booleans()) or not sizes["J"] else ["joint_position"]
    chosen = draw(st.lists(st.sampled_from([*_OPTIONAL, "joint_position"]), unique=True))
    step = rng.integers(1, 10**8, rows) if draw(st.booleans()) else np.full(rows, round(1e9 / fields["rate_hz"]))
    arrays = {"time_ns": draw(st.integers(0, 2**60)) + np.cumsum(step)}
    for channel in dict.fromkeys(always + chosen):
        shape = (rows, *(sizes.get(n, n) for n in CHANNELS[channel].shape[1:]))
        arrays[channel] = _values(rng, channel, shape)
        if draw(st.integers(0, 3)) == 0:
            valid = rng.random(rows) < 0.5
            arrays[channel + "_valid"] = valid
            if arrays[channel].dtype.kind == "f":
                arrays[channel][~valid] = draw(st.sampled_from([np.nan, np.inf, 0.0]))
    meta = EpisodeMeta(
        id=name,
        source=draw(st.sampled_from(["sim", "real"])),
        task=draw(st.none() | _WORDS),
        object=draw(st.none() | _WORDS),
        seed=draw(st.none() | st.integers(0, 2**70)),
        outcome=draw(st.none() | _WORDS),
        newton_per_count=0.1 if "taxels" in chosen else None,
        invalid_counts=draw(st.dictionaries(st.sampled_from(_OPTIONAL), st.integers(0, 9), max_size=2)),
        **fields,
    )
    return Episode(meta, arrays)


def _values(rng: np.random.Generator, channel: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return values of a channel, among them a negative zero and the smallest number."""
    kind = CHANNELS[channel].dtype
    if kind == "bool":
        return rng.random(shape) < 0.5
    if kind == "int16":
        return rng.integers(-(2**15), 2**15, shape).astype(np.int16)
    values = rng.choice([-0.0, 1e-45, 3e38, 1.0], shape) * rng.normal(size=shape).clip(-1, 1)
    if channel in QUATERNION:
        values[:, 3:] = rng.normal(size=(len(values), 4))
        values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return values.astype(np.float32)
