"""Rule: contact flags say what the forces say, by the threshold of the record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._forces import Forces, flags, forces
from candata.checks._view import View

Array = NDArray[np.float64]
#: Share of rows in which flags may differ: a force right at the threshold, rounded to float32.
ROUNDING = 0.01
#: Fewest rows that count as a difference.
FEWEST = 5
#: Share of rows beyond which flags say the opposite of the forces.
OPPOSITE = 0.9
#: Share of rows beyond which stated flags cannot have come from these forces.
ANOTHER = 0.1
#: Agreement that some threshold must reach where the record states none.
SOME = 0.9
REMEDY = "derive the flags again from the forces, or state their rule (contact_rule)"


def _episode(view: View) -> Iterator[Finding]:
    """Yield flags that differ from the forces, and `contact` that differs from the fingertips' flags."""
    force = forces(view)
    tips = None if force is None else flags(view, force.total.shape[1])
    whole = view.values("contact")
    if force is not None and tips is not None:
        yield from _tips(view, force, tips)
    elif force is not None and whole is not None:
        yield from _compared(view, "contact", whole, _any(force.touch.astype(float), force.seen), force)
    own = view.values("fingertip_contact")
    if own is not None and whole is not None:
        yield from _summed(view, whole, _any(own, np.isfinite(own)))


def _any(touch: Array, seen: NDArray[np.bool_]) -> Array:
    """Return `(T,)` 1 where any touches, 0 where none does, NaN where that is not known."""
    some = (np.nan_to_num(touch) > 0).any(axis=1)
    return np.where(some | seen.all(axis=1), some.astype(float), np.nan)


def _tips(view: View, force: Forces, tips: Array) -> Iterator[Finding]:
    """Yield what is wrong with the flags of fingertips, all of them together first."""
    touch = np.where(force.seen, force.touch.astype(float), np.nan)
    yield from _compared(view, "fingertip_contact", tips, touch, force)


def _compared(view: View, channel: str, flag: Array, touch: Array, force: Forces) -> Iterator[Finding]:
    """Yield that flags are the opposite of the forces' touch, or differ from it more than rounding does."""
    seen = np.isfinite(flag) & np.isfinite(touch)
    off = seen & (flag != touch)
    count, share = int(off.sum()), float(off.sum() / max(seen.sum(), 1))
    rows = off.reshape(len(off), -1).any(axis=1)
    if count <= FEWEST or share <= ROUNDING:
        return
    numbers = f"{count} of {seen.sum()} readings ({share:.0%}), threshold {force.threshold_n:g} N"
    evidence = {"differing_share": share, "threshold_N": force.threshold_n}
    if share > OPPOSITE:
        yield view.finding(
            "error", "contact_flags", "contact flags are inverted", numbers, channel, rows, "invert the flags",
            **evidence,
        )  # fmt: skip
        return
    best, agreement = _threshold(flag, touch, force, channel)
    if force.stated and share > ANOTHER:
        yield view.finding(
            "error", "contact_flags", "contact flags do not come from these forces", numbers, channel, rows, REMEDY,
            **evidence, best_agreement=agreement, best_threshold_N=best,
        )  # fmt: skip
    elif force.stated or agreement < SOME:
        yield view.finding(
            "warning", "contact_flags", "contact flags and forces disagree", numbers, channel, rows, REMEDY,
            **evidence, best_agreement=agreement, best_threshold_N=best,
        )  # fmt: skip
    else:
        text = f"{agreement:.0%} of the readings agree at {best:.3g} N, {1 - share:.0%} at {force.threshold_n:g} N"
        yield view.finding(
            "info", "contact_flags", "contact flags were made by another threshold", text, channel, None,
            "state it as contact_rule", **evidence, best_agreement=agreement, best_threshold_N=best,
        )  # fmt: skip


def _threshold(flag: Array, touch: Array, force: Forces, channel: str) -> tuple[float, float]:
    """Return the threshold [N] by which forces make the flags best, and the share that agrees then.

    The share is balanced: the mean of that in and out of contact, so that rare contact counts.
    """
    size = force.total if channel == "fingertip_contact" else np.nan_to_num(force.total).max(axis=1)
    seen = np.isfinite(flag) & np.isfinite(touch) & np.isfinite(size)
    values, marked = size[seen], flag[seen] > 0
    if not marked.any() or marked.all():
        return force.threshold_n, float((marked == (values > force.threshold_n)).mean()) if len(values) else 0.0
    tried = np.unique(np.quantile(values, np.linspace(0, 1, 200)))
    scores = [0.5 * ((values[marked] > t).mean() + (values[~marked] <= t).mean()) for t in tried]
    best = int(np.argmax(scores))
    return float(tried[best]), float(scores[best])


def _summed(view: View, whole: Array, tips: Array) -> Iterator[Finding]:
    """Yield that `contact` does not say what the fingertips' flags say."""
    seen = np.isfinite(whole) & np.isfinite(tips)
    lost, more = seen & (tips > whole), seen & (whole > tips)
    share = float((lost | more).sum() / max(seen.sum(), 1))
    if share > OPPOSITE:
        yield view.finding(
            "error", "contact_flags", "contact is the opposite of the fingertips' flags", f"{share:.0%} of rows",
            "contact", lost | more, "derive contact again: any fingertip touches", differing_share=share,
        )  # fmt: skip
    elif lost.sum() > FEWEST and lost.sum() > ROUNDING * seen.sum():
        yield view.finding(
            "warning", "contact_flags", "contact is off while a fingertip's flag is on", f"{lost.sum()} rows",
            "contact", lost, "derive contact again: any fingertip touches", rows=int(lost.sum()),
        )  # fmt: skip
    elif more.sum() > FEWEST and more.sum() > ROUNDING * seen.sum():
        yield view.finding(
            "info", "contact_flags", "contact is on while no fingertip's flag is", f"{more.sum()} rows", "contact",
            more, "the schema's contact is that of any fingertip; other links may touch too", rows=int(more.sum()),
        )  # fmt: skip


RULE = Rule(meaning="contact flags say what the forces say", episode=_episode)
