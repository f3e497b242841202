"""Rows of the table of a run: shares, quantiles and means of cases."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from candata.schema.bench import BenchRow


def percent(measure: str, hits: Iterable[bool], low: float | None = None, high: float | None = None) -> BenchRow:
    """Return a row that counts, in percent."""
    counted = list(hits)
    value = 100 * float(np.mean(counted)) if counted else None
    return BenchRow(measure=measure, value=value, n=len(counted), low=low, high=high)


def quantile(
    measure: str, values: Sequence[float], q: float, low: float | None = None, high: float | None = None
) -> BenchRow:
    """Return a row that is a quantile of shares, in percent."""
    value = 100 * float(np.quantile(values, q)) if len(values) else None
    return BenchRow(measure=measure, value=value, n=len(values), low=low, high=high)


def mean(measure: str, values: Sequence[float], unit: Literal["%", ""] = "") -> BenchRow:
    """Return a row that is a mean of values in a unit."""
    return BenchRow(measure=measure, value=float(np.mean(values)) if len(values) else None, n=len(values), unit=unit)
