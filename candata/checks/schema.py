"""Rule: channels are known, of the right type and shape, and say who, what, when."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.datasets import RawEpisode
from candata.errors import UsageError
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import EpisodeMeta, problems


def _schema(episode: RawEpisode) -> Iterator[Finding]:
    """Yield what the record, the types and the shapes of an episode violate."""
    try:
        meta = episode.meta()
    except (UsageError, ValueError) as error:
        yield Finding("error", "schema", str(error).splitlines()[0], episode=episode.id)
        return
    if meta.id != episode.id:
        yield Finding("error", "schema", f"the record names the episode {meta.id!r}", episode=episode.id)
    yield from _types(episode)
    yield from _shapes(episode, meta)


def _types(episode: RawEpisode) -> Iterator[Finding]:
    """Yield columns of another type than the schema's."""
    for name, array in episode.arrays.items():
        channel = CHANNELS.get(name.removesuffix(VALID_SUFFIX))
        wanted = "bool" if name.endswith(VALID_SUFFIX) else channel.dtype if channel else None
        if wanted and array.dtype != wanted:
            text = f"type {array.dtype}, expected {wanted}"
            yield Finding("error", "schema", text, episode=episode.id, channel=name)


def _shapes(episode: RawEpisode, meta: EpisodeMeta) -> Iterator[Finding]:
    """Yield unknown and missing channels and wrong shapes: all that is left to say once values are fine."""
    sound: dict[str, NDArray] = {
        name: np.broadcast_to(np.int8(0), array.shape) for name, array in episode.arrays.items()
    }
    if "time_ns" in sound:
        sound["time_ns"] = np.arange(len(episode.arrays["time_ns"]))
    for problem in problems(meta, sound):
        text = problem.problem
        text += f": found {problem.found}" if problem.found else ""
        text += f", expected {problem.expected}" if problem.expected else ""
        yield Finding("error", "schema", text, episode=episode.id, channel=problem.where.channel)


RULE = Rule(meaning="known channels of the right type and shape", episode=_schema)
