"""Rule: channels hold values: a recording of which much was lost is told, though its gaps are marked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import View, valid_rows
from candata.schema.channels import VALID_SUFFIX

#: Share of invalid rows from which a channel is told of. Chosen: a dropout now and then is what gaps are for.
MUCH = 0.1
REMEDY = "nothing, if the losses are known; else look for what was lost while recording"


def _gaps(view: View) -> Iterator[Finding]:
    """Yield each channel of which many rows are marked invalid."""
    for name, array in view.raw.arrays.items():
        if name.endswith(VALID_SUFFIX) or array.ndim == 0 or not len(array):
            continue
        lost = np.asarray(~valid_rows(view.raw, name))
        if lost.mean() > MUCH:
            text = f"{lost.sum()} of {len(array)} rows ({lost.mean():.0%})"
            yield view.finding("info", "gaps", "rows are marked as invalid", text, name, lost, REMEDY,
                               rows=int(lost.sum()), share=float(lost.mean()))  # fmt: skip


RULE = Rule(meaning="channels hold values in most rows", episode=_gaps)
