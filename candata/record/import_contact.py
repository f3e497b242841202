"""Contact of an imported log: flags by the forces, and what they would be at other scales."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.schema.channels import VALID_SUFFIX
from candata.schema.contact import fingertip_contact
from candata.schema.episode import Episode

#: Scales, relative to the one in use, at which the share of contact is reported: public sources differ by two.
SCALES = (0.5, 1.0, 2.0)


def add_contact(arrays: dict[str, NDArray], threshold_n: float, release_n: float | None) -> None:
    """Add contact by the forces, valid where they are."""
    if "fingertip_force" not in arrays:
        return
    arrays["fingertip_contact"] = fingertip_contact(arrays["fingertip_force"], threshold_n, release_n)
    arrays["contact"] = np.asarray(arrays["fingertip_contact"].any(axis=1))
    for name in ("fingertip_contact", "contact"):
        arrays[name + VALID_SUFFIX] = arrays["fingertip_force" + VALID_SUFFIX]


def contact_shares(episode: Episode, scale: float) -> dict[str, float]:
    """Return the share of rows in contact if a count were worth half, as much, and twice as much."""
    rule = episode.meta.contact_rule
    if rule is None:
        return {}
    force = episode["fingertip_force"][episode.valid("fingertip_force")]
    shares = {f"{k * scale:g}": fingertip_contact(k * force, rule.threshold_n, rule.release_n) for k in SCALES}
    return {label: float(flags.any(axis=1).mean()) if len(force) else 0.0 for label, flags in shares.items()}
