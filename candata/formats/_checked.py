"""The last steps of every import: contact that is missing, and an episode whose problems name the file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.schema.channels import VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.episode import ContactRule, Episode, EpisodeMeta


def checked(meta: EpisodeMeta, arrays: Mapping[str, NDArray], path: Path) -> Episode:
    """Return the episode; what is wrong with it is said with the file's name.

    Raises
    ------
    DataError
        When the arrays are no episode.
    """
    try:
        return Episode(meta, arrays)
    except DataError as error:
        where = dataclasses.replace(error.where, path=str(path))
        facts = {"expected": error.expected, "found": error.found, "fix": error.fix}
        raise DataError(error.problem, where=where, **facts) from None


def derive_contact(arrays: dict[str, NDArray], invalid: dict[str, int]) -> ContactRule | None:
    """Add the contact channels that are missing; return the rule if a threshold was applied.

    Parameters
    ----------
    arrays : dict of str to ndarray
        Channels and their `_valid` flags; added to.
    invalid : dict of str to int
        Invalid rows by channel; added to.
    """
    rule = None
    if "fingertip_force" in arrays and "fingertip_contact" not in arrays:
        rule = ContactRule()
        arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], rule.threshold_n)
        _inherit(arrays, invalid, "fingertip_force", "fingertip_contact")
    if "fingertip_contact" in arrays and "contact" not in arrays:
        arrays["contact"] = np.asarray(arrays["fingertip_contact"].any(axis=1))
        _inherit(arrays, invalid, "fingertip_contact", "contact")
    return rule


def _inherit(arrays: dict[str, NDArray], invalid: dict[str, int], origin: str, derived: str) -> None:
    """Mark a derived channel invalid where the one it comes from is."""
    if origin in invalid:
        arrays[derived + VALID_SUFFIX] = arrays[origin + VALID_SUFFIX]
        invalid[derived] = invalid[origin]
