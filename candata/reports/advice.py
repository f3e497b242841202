"""What to change in a simulator, in words: the amount, the place, and the MJCF attribute where there is one."""

from __future__ import annotations

from dataclasses import dataclass

from candata.effects import EFFECTS, effect, effect_names
from candata.reports import words
from candata.reports.numbers import digits, reading, unit_of
from candata.schema.report import Estimate, NamedEffect, Report

#: Said of an effect that MJCF has no attribute for.
NO_ATTRIBUTE = "MJCF has no attribute for it: candata generate-sim --effects effects.yaml adds it"
#: The record's words for a candidate that its probes could not bring to show.
SILENT = "moves nothing in these motions"
#: Such words where the page says more.
REASONS = {"best left out": "tested: the recordings fit best without it", SILENT: f"not tested: it {SILENT}"}
#: Longest vector that is spelled out.
MOST_NUMBERS = 6


@dataclass(frozen=True)
class Change:
    """One change: a sentence without its full stop, and how MJCF says it (empty where it cannot)."""

    what: str
    mjcf: str

    def __str__(self) -> str:
        """Return both as one sentence."""
        return f"{self.what}; in MJCF: {self.mjcf}." if self.mjcf else f"{self.what}; {NO_ATTRIBUTE}."


def changes(report: Report) -> list[Change]:
    """Return what to change for each named effect, in the order of the record."""
    return [change(effect) for effect in report.effects]


def change(named: NamedEffect) -> Change:
    """Return what to change for one named effect."""
    values = [_value(named, parameter, estimate) for parameter, estimate in named.parameters.items()]
    shown, raw = words.listed([v for v, _ in values]), " ".join(r for _, r in values)
    every = "every jaw" if any(estimate.unit for estimate in named.parameters.values()) else "every driven joint"
    places = {
        "joint": f"joint {named.element}" if named.element else every,
        "servo": f"the servo of {named.element}" if named.element else "every servo",
        "tip": f"fingertip {named.element}" if named.element else "every fingertip",
        "surface": f"{named.element}" if named.element else "object, fingertips and support",
    }
    kind = EFFECTS.load(named.name) if named.name in EFFECTS else None
    if kind is None or kind.advice is None:
        about = f"{kind.about}, " if kind else ""
        return Change(f"Add {words.title(named.name, named.element)}: {about}{shown}", "")
    return Change(kind.advice.change.format(x=shown, **places), kind.advice.mjcf.format(raw=raw))


def next_step(report: Report) -> str:
    """Return the sentence that says what to do with the simulator when nothing is named; empty else."""
    missing = max(0, 8 - report.data.episodes.total)
    return {
        "no_gap": "Nothing: keep the simulator as it is.",
        "ambiguous": "Nothing yet: changing either of the tied effects would fit these recordings and may be wrong for "
        "others. Record the next motion first.",
        "unknown_effect": "No parameter of the library: fitting one would hide the cause.",
        "too_little_data": f"Nothing yet: record {missing or 'more'} more episodes and diagnose again."
        if missing
        else "Nothing yet: record more episodes and diagnose again.",
        "out_of_budget": "Nothing yet: diagnose again with a larger --budget.",
    }.get(report.verdict, "")


def untested(report: Report) -> list[tuple[str, str]]:
    """Return what could not be tested and why, as (what, why); what is named was tested beside the others."""
    rows = []
    grouped: dict[str, list[str]] = {}
    named = {effect.name for effect in report.effects}
    for one in report.ranking:
        if one.reason and one.name not in named:
            grouped.setdefault(one.reason, []).append(words.plain(one.name))
    rows += [(words.listed(names), REASONS.get(reason, reason)) for reason, names in grouped.items()]
    if not report.ranking:
        return rows
    blind: dict[str, list[str]] = {}
    for name in sorted(set(effect_names()) - {one.name.split(" ")[0] for one in report.ranking}):
        moves = effect(name).moves
        lacking = moves and not set(moves) & set(report.data.channels)
        why = f"{words.listed([words.plain(c) for c in moves], 'or')} was not recorded" if lacking else ""
        blind.setdefault(why or "not a candidate here: the scene has nothing for it to act on", []).append(name)
    return rows + [(words.listed([words.plain(n) for n in names]), why) for why, names in blind.items()]


def missing_channels(report: Report) -> list[str]:
    """Return the channels that were not compared because they were not recorded."""
    wanted = ("joint_position", "object_pose", "fingertip_force")
    return [c for c in wanted if report.data.channels and c not in report.data.channels]


def _value(named: NamedEffect, parameter: str, estimate: Estimate) -> tuple[str, str]:
    """Return a parameter for people, with its interval, and as the SI number that a file takes."""
    if isinstance(estimate.value, str):
        return estimate.value, estimate.value
    unit = unit_of(named.name, parameter, estimate)
    if isinstance(estimate.value, tuple):
        if len(estimate.value) > MOST_NUMBERS:
            return f"the {len(estimate.value)} values of effects.yaml", "the values of effects.yaml"
        return str(reading(Estimate(value=estimate.value), unit)), " ".join(digits(v) for v in estimate.value)
    read = reading(estimate, unit)
    as_well = f"; {read.as_well} explains as well" if read.as_well else ""
    interval = f" ({read.interval}{as_well})" if read.interval else ""
    return f"{read.value} {read.unit}".strip() + interval, digits(float(estimate.value)).replace(",", "")
