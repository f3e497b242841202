"""Rule: channels hold values; a recording that lost much is reported, though its gaps are marked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView, valid_rows
from candata.schema.channels import VALID_SUFFIX

#: Share of invalid rows from which a channel is reported. Chosen: a dropout now and then is what gaps are for.
INVALID_SHARE = 0.1
REMEDY = "nothing, if the losses are known; else look for what was lost while recording"


def _gaps(view: EpisodeView) -> Iterator[Finding]:
    """Yield each channel of which many rows are marked invalid."""
    for name, array in view.raw.arrays.items():
        if name.endswith(VALID_SUFFIX) or array.ndim == 0 or not len(array):
            continue
        is_invalid = np.asarray(~valid_rows(view.raw, name))
        if is_invalid.mean() > INVALID_SHARE:
            text = f"{is_invalid.sum()} of {len(array)} rows ({is_invalid.mean():.0%})"
            yield view.finding(
                "info",
                "gaps",
                "rows are marked as invalid",
                text,
                name,
                is_invalid,
                REMEDY,
                rows=int(is_invalid.sum()),
                share=float(is_invalid.mean()),
            )


RULE = Rule(meaning="channels hold values in most rows", episode=_gaps)
