"""The closed list of units: factors to SI, and readable names."""

from __future__ import annotations

import math

from candata.errors import UnknownNameError, Where

#: Factor that turns a value of the unit into SI (CGPM SI brochure, 9th edition; degrees by definition).
TO_SI: dict[str, float] = {
    "1": 1.0,
    "count": 1.0,
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": math.pi / 180.0,
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "m/s": 1.0,
    "mm/s": 1e-3,
    "rad/s": 1.0,
    "deg/s": math.pi / 180.0,
    "N": 1.0,
    "mN": 1e-3,
    "N m": 1.0,
    "mN m": 1e-3,
    "N m/rad": 1.0,
    "N m s/rad": 1.0,
    "N s/m": 1.0,
    "N/m": 1.0,
    "A": 1.0,
    "mA": 1e-3,
    "V": 1.0,
    "mV": 1e-3,
    "kg": 1.0,
    "g": 1e-3,
    "kg m^2": 1.0,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "ppm": 1e-6,
}


def to_si(unit: str, location: Where | None = None) -> float:
    """Return the factor from `unit` to SI.

    Raises
    ------
    UnknownNameError
        When the unit is not in the list.
    """
    if unit not in TO_SI:
        raise UnknownNameError("unit", unit, TO_SI, location)
    return TO_SI[unit]
