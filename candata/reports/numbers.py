"""Numbers as people read them: a few digits, a readable unit, an interval in the same unit."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from candata.effects import EFFECTS
from candata.errors import UnknownNameError
from candata.schema.effect import Value
from candata.schema.report import Estimate, IntervalEnd, KnownEnds

#: Unit that a parameter's name ends in (the naming rule of effects), the longest ending first.
SUFFIX_UNITS = (
    ("_Nms_rad", "N m s/rad"),
    ("_Nm_rad", "N m/rad"),
    ("_kgm2", "kg m^2"),
    ("_rad", "rad"),
    ("_ppm", "ppm"),
    ("_Nm", "N m"),
    ("_kg", "kg"),
    ("_N", "N"),
    ("_s", "s"),
    ("_m", "m"),
)
#: SI unit to the unit shown for small values, and the factor to it.
SMALL_UNITS = {"s": ("ms", 1e3), "m": ("mm", 1e3), "rad": ("mrad", 1e3), "kg": ("g", 1e3)}
#: What explains the recordings as well as a value of which only this end is known.
EQUALLY_GOOD: dict[KnownEnds | None, str] = {"low": "more", "high": "less"}
#: Below this SI value the small unit reads better.
SMALL_BELOW = {"s": 1.0, "m": 0.5, "rad": 0.5, "kg": 0.5}


@dataclass(frozen=True)
class FormattedEstimate:
    """An estimated parameter as text.

    Attributes
    ----------
    value : str
    interval : str
        `11.9 to 13.1`, or `at least 11.9` where only that end is known; empty when there is none.
    unit : str
        Empty for 1.
    equally_good : str
        What explains as well as the value, `more` or `less`; empty when both ends are known.
    """

    value: str
    interval: str
    unit: str
    equally_good: str = ""

    def __str__(self) -> str:
        """Return `12.5 ms (90 % interval 11.9 to 13.1)`, or `at least 11.9 ms (12.5 taken; more explains as well)`."""
        if self.equally_good:
            interval = f"{self.interval} {self.unit}".strip()
            return f"{interval} ({self.value} taken; {self.equally_good} explains as well)"
        text = f"{self.value} {self.unit}".strip()
        return f"{text} (90 % interval {self.interval})" if self.interval else text


def unit_of(effect: str, parameter: str, estimate: Estimate | None = None) -> str:
    """Return the SI unit of an effect's parameter: the estimate's or the effect's word, else its name's ending."""
    if estimate is not None and estimate.unit:
        return estimate.unit
    try:
        parameters = EFFECTS.load(effect).parameters
    except UnknownNameError:
        parameters = ()
    for candidate in parameters:
        if candidate.name == parameter:
            return str(candidate.unit)
    if parameter == "ppm":
        return "ppm"
    return next((unit for ending, unit in SUFFIX_UNITS if parameter.endswith(ending)), "1")


def format_estimate(estimate: Estimate, unit: str) -> FormattedEstimate:
    """Return the estimate in its most readable unit, vectors in brackets."""
    values = _numbers(estimate.value)
    if values is None:
        return FormattedEstimate(str(estimate.value), "", "")
    readable_unit, factor = _readable_unit(unit, values)
    ends = [_numbers(end) for end in (estimate.low, estimate.high)]
    interval = ""
    if ends[0] is not None and ends[1] is not None:
        pairs = zip(ends[0], ends[1], strict=True)
        interval = _in_brackets(f"{digits(factor * low)} to {digits(factor * high)}" for low, high in pairs)
    elif ends[0] is not None:
        interval = f"at least {_in_brackets(digits(factor * v) for v in ends[0])}"
    elif ends[1] is not None:
        interval = f"at most {_in_brackets(digits(factor * v) for v in ends[1])}"
    value = _in_brackets(digits(factor * v) for v in values)
    equally_good = EQUALLY_GOOD.get(estimate.bounded, "")
    return FormattedEstimate(value, interval, "" if readable_unit == "1" else readable_unit, equally_good)


def digits(value: float) -> str:
    """Return three significant digits, without an exponent where it stays short."""
    if not math.isfinite(value):
        return "?"
    if value == 0:
        return "0"
    places = 2 - math.floor(math.log10(abs(value)))
    if places > 7:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    text = f"{round(value, places):,.{max(places, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def percent(share: float) -> str:
    """Return a share as `98 %`, with a decimal only near the ends, never a rounded-up 100."""
    if 0.99 < share < 1 or 0 < abs(share) < 0.01:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.0f} %"


def _numbers(value: Value | IntervalEnd) -> tuple[float, ...] | None:
    """Return the value as numbers, or None when it is a word or missing."""
    if value is None or isinstance(value, str):
        return None
    return tuple(float(v) for v in value) if isinstance(value, tuple) else (float(value),)


def _readable_unit(unit: str, values: tuple[float, ...]) -> tuple[str, float]:
    """Return the unit to show and the factor from SI to it."""
    largest_value = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    if unit in SMALL_UNITS and 0 < largest_value < SMALL_BELOW[unit]:
        return SMALL_UNITS[unit]
    return unit, 1.0


def _in_brackets(parts: Iterable[str]) -> str:
    """Return a single part as it is, several in brackets."""
    texts = list(parts)
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"
