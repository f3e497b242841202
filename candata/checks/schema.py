"""Rule: channels are known, of the right type and shape, and say who, what, when."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView
from candata.errors import UsageError
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import EpisodeMeta, problems


def _schema(view: EpisodeView) -> Iterator[Finding]:
    """Yield what the record, the types and the shapes of an episode violate."""
    try:
        meta = view.raw.meta()
    except (UsageError, ValueError) as error:
        yield view.finding("error", "schema", "the record is not readable", str(error).splitlines()[0])
        return
    if meta.id != view.id:
        yield view.finding("error", "schema", "the record names another episode", repr(meta.id))
    yield from _types(view)
    yield from _shapes(view, meta)


def _types(view: EpisodeView) -> Iterator[Finding]:
    """Yield columns of another type than the schema's."""
    for name, array in view.raw.arrays.items():
        channel = CHANNELS.get(name.removesuffix(VALID_SUFFIX))
        expected_type = "bool" if name.endswith(VALID_SUFFIX) else channel.dtype if channel else None
        if expected_type and array.dtype != expected_type:
            text = f"type {array.dtype}, expected {expected_type}"
            yield view.finding("error", "schema", "a column of another type", text, name)


def _shapes(view: EpisodeView, meta: EpisodeMeta) -> Iterator[Finding]:
    """Yield unknown and missing channels and wrong shapes: all that is left to say once values are fine."""
    stand_ins: dict[str, NDArray] = {
        name: np.broadcast_to(np.int8(0), array.shape) for name, array in view.raw.arrays.items()
    }
    if "time_ns" in stand_ins:
        stand_ins["time_ns"] = np.arange(len(view.raw.arrays["time_ns"]))
    for problem in problems(meta, stand_ins):
        text = f"found {problem.found}" if problem.found else ""
        text += f", expected {problem.expected}" if problem.expected else ""
        yield view.finding("error", "schema", problem.problem, text, problem.where.channel, remedy=problem.fix or "")


RULE = Rule(meaning="known channels of the right type and shape", episode=_schema)
