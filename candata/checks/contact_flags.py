"""Rule: contact flags say what the forces say, by the threshold of the record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._forces import FingertipForces, flags, forces
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
#: Share of rows in which flags may differ: a force right at the threshold, rounded to float32.
ROUNDING_SHARE = 0.01
#: Fewest rows that count as a difference.
FEWEST = 5
#: Share of rows beyond which flags say the opposite of the forces.
OPPOSITE_SHARE = 0.9
#: Share of rows beyond which stated flags cannot have come from these forces.
UNRELATED_SHARE = 0.1
#: Agreement that some threshold must reach where the record states none.
LEAST_AGREEMENT = 0.9
REMEDY = "derive the flags again from the forces, or state their rule (contact_rule)"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield flags that differ from the forces, and `contact` that differs from the fingertips' flags."""
    force = forces(view)
    tips = None if force is None else flags(view, force.total.shape[1])
    contact = view.values("contact")
    if force is not None and tips is not None:
        yield from _tip_findings(view, force, tips)
    elif force is not None and contact is not None:
        yield from _force_findings(
            view, "contact", contact, _any_tip(force.touch.astype(float), force.has_value), force
        )
    tip_flags = view.values("fingertip_contact")
    if tip_flags is not None and contact is not None:
        yield from _contact_findings(view, contact, _any_tip(tip_flags, np.isfinite(tip_flags)))


def _any_tip(touch: Array, has_value: NDArray[np.bool_]) -> Array:
    """Return `(T,)` 1 where any touches, 0 where none does, NaN where that is not known."""
    is_touching = (np.nan_to_num(touch) > 0).any(axis=1)
    return np.where(is_touching | has_value.all(axis=1), is_touching.astype(float), np.nan)


def _tip_findings(view: EpisodeView, force: FingertipForces, tips: Array) -> Iterator[Finding]:
    """Yield what is wrong with the flags of fingertips, all of them together first."""
    touch = np.where(force.has_value, force.touch.astype(float), np.nan)
    yield from _force_findings(view, "fingertip_contact", tips, touch, force)


def _force_findings(
    view: EpisodeView, channel: str, flag: Array, touch: Array, force: FingertipForces
) -> Iterator[Finding]:
    """Yield that flags are the opposite of the forces' touch, or differ from it more than rounding does."""
    has_both = np.isfinite(flag) & np.isfinite(touch)
    differs = has_both & (flag != touch)
    count, share = int(differs.sum()), float(differs.sum() / max(has_both.sum(), 1))
    rows = differs.reshape(len(differs), -1).any(axis=1)
    if count <= FEWEST or share <= ROUNDING_SHARE:
        return
    numbers = f"{count} of {has_both.sum()} readings ({share:.0%}), threshold {force.threshold_n:g} N"
    evidence = {"differing_share": share, "threshold_N": force.threshold_n}
    if share > OPPOSITE_SHARE:
        problem, remedy = "contact flags are inverted", "invert the flags"
        yield view.finding("error", "contact_flags", problem, numbers, channel, rows, remedy, **evidence)
        return
    best_threshold, agreement = _threshold(flag, touch, force, channel)
    evidence |= {"best_agreement": agreement, "best_threshold_N": best_threshold}
    if force.is_rule_stated and share > UNRELATED_SHARE:
        problem = "contact flags do not come from these forces"
        yield view.finding("error", "contact_flags", problem, numbers, channel, rows, REMEDY, **evidence)
    elif force.is_rule_stated or agreement < LEAST_AGREEMENT:
        problem = "contact flags and forces disagree"
        yield view.finding("warning", "contact_flags", problem, numbers, channel, rows, REMEDY, **evidence)
    else:
        problem, remedy = "contact flags were made by another threshold", "state it as contact_rule"
        text = f"{agreement:.0%} of the readings agree at {best_threshold:.3g} N, "
        text += f"{1 - share:.0%} at {force.threshold_n:g} N"
        yield view.finding("info", "contact_flags", problem, text, channel, None, remedy, **evidence)


def _threshold(flag: Array, touch: Array, force: FingertipForces, channel: str) -> tuple[float, float]:
    """Return the threshold [N] by which forces make the flags best, and the share that agrees then.

    The share is balanced: the mean of that in and out of contact, so that rare contact counts.
    """
    size = force.total if channel == "fingertip_contact" else np.nan_to_num(force.total).max(axis=1)
    has_both = np.isfinite(flag) & np.isfinite(touch) & np.isfinite(size)
    values, is_flagged = size[has_both], flag[has_both] > 0
    if not is_flagged.any() or is_flagged.all():
        return force.threshold_n, float((is_flagged == (values > force.threshold_n)).mean()) if len(values) else 0.0
    thresholds = np.unique(np.quantile(values, np.linspace(0, 1, 200)))
    scores = [0.5 * ((values[is_flagged] > t).mean() + (values[~is_flagged] <= t).mean()) for t in thresholds]
    best_index = int(np.argmax(scores))
    return float(thresholds[best_index]), float(scores[best_index])


def _contact_findings(view: EpisodeView, contact: Array, tips: Array) -> Iterator[Finding]:
    """Yield that `contact` does not say what the fingertips' flags say."""
    has_both = np.isfinite(contact) & np.isfinite(tips)
    lacks_contact, lacks_tip = has_both & (tips > contact), has_both & (contact > tips)
    share = float((lacks_contact | lacks_tip).sum() / max(has_both.sum(), 1))
    if share > OPPOSITE_SHARE:
        yield view.finding(
            "error",
            "contact_flags",
            "contact is the opposite of the fingertips' flags",
            f"{share:.0%} of rows",
            "contact",
            lacks_contact | lacks_tip,
            "derive contact again: any fingertip touches",
            differing_share=share,
        )
    elif lacks_contact.sum() > FEWEST and lacks_contact.sum() > ROUNDING_SHARE * has_both.sum():
        yield view.finding(
            "warning",
            "contact_flags",
            "contact is off while a fingertip's flag is on",
            f"{lacks_contact.sum()} rows",
            "contact",
            lacks_contact,
            "derive contact again: any fingertip touches",
            rows=int(lacks_contact.sum()),
        )
    elif lacks_tip.sum() > FEWEST and lacks_tip.sum() > ROUNDING_SHARE * has_both.sum():
        yield view.finding(
            "info",
            "contact_flags",
            "contact is on while no fingertip's flag is",
            f"{lacks_tip.sum()} rows",
            "contact",
            lacks_tip,
            "the schema's contact is that of any fingertip; other links may touch too",
            rows=int(lacks_tip.sum()),
        )


RULE = Rule(meaning="contact flags say what the forces say", episode=_episode)
