"""Misses: why a case counts as one, and what excuses it."""

from __future__ import annotations

from candata.gap.blind.outcomes import FAINT, Outcome
from candata.schema.bench import Miss

#: Cosine above which two causes are said to look alike.
ALIKE = 0.8


def miss(o: Outcome) -> Miss | None:
    """Return what went wrong in a case; None where nothing did."""
    why = why_missed(o)
    if why is None:
        return None
    report = o.result.report
    named = ", ".join(o.named) or (", ".join(report.ambiguous_class) if report else "") or "-"
    truth = o.label.outside.name if o.label.outside else ", ".join(o.truth)
    if o.kind == "background":
        truth = f"{o.label.main} in a background, largest {o.largest}"
    gap = report.gap.before if report and report.gap else None
    why = "; ".join((why, *_excuses(o)))
    return Miss(case=o.label.case, kind=o.kind, truth=truth or "none", verdict=o.verdict, named=named, why=why, gap=gap)


def _excuses(o: Outcome) -> list[str]:
    """Return what makes a set of causes hard: one that is worth little, two that look alike."""
    if o.shares is None or o.kind == "background":
        return []
    left = {name: rise for name, rise in o.shares.rises.items() if name not in o.named}
    found = [f"{name} is worth {rise:.2g} floors" for name, rise in left.items() if rise < FAINT]
    if o.shares.alike is not None and o.shares.alike > ALIKE:
        found.append(f"two look alike, cosine {o.shares.alike:.2f}")
    return found


def why_missed(o: Outcome) -> str | None:
    """Return why a case counts as a miss; None where it is right."""
    if o.result.error is not None:
        return o.result.error
    if o.kind == "null":
        return "an effect named" if o.named else _why_alarm(o)
    if o.kind == "outside":
        return _why_outside(o)
    if o.kind in ("pair", "triple"):
        return None if set(o.named) == set(o.truth) else ("a wrong name" if o.wrong_names else "not all named")
    if o.kind == "solver":
        heavy = "object_mass" in o.truth and "object_mass" not in o.named[:2]
        return "the mass is not first or second" if heavy else (None if o.flagged else "not found, not flagged")
    if o.first and o.label.trait is not None and o.wrong_names:
        return "a wrong name beside"
    return None if o.first else "not first"


def _why_alarm(o: Outcome) -> str | None:
    """Return why a null with no effect named is a miss: in a random small scene any verdict but `no_gap` is."""
    return None if o.label.trait is None or o.verdict == "no_gap" else f"no gap is there ({o.label.trait})"


def _why_outside(o: Outcome) -> str | None:
    """Return why an outside cause counts as a miss: it was explained away, overlooked, or put elsewhere."""
    if not o.abstains:
        return "overlooked" if o.verdict == "no_gap" else "explained by the library"
    unknown, truth = o.result.report.unknown if o.result.report else None, o.label.outside
    place = unknown.acts_on if unknown else None
    return None if truth and place == truth.acts_on else f"said to act on {place}, acts on {truth and truth.acts_on}"
