"""What to change in a simulator, in words: the amount, the place, and the MJCF attribute where there is one."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from candata.effects import EFFECTS, effect, effect_names
from candata.gap.fit.folds import FEWEST
from candata.reports import words
from candata.reports.numbers import digits, format_estimate, unit_of
from candata.schema.report import Estimate, NamedEffect, Report

#: Said of an effect that MJCF has no attribute for.
NO_ATTRIBUTE = "MJCF has no attribute for it, effects.yaml holds it"
#: The record's words for a candidate whose probes changed nothing in the readings.
NO_RESPONSE = "moves nothing in these motions"
#: Reason of the record to the fuller one of the page.
REASONS = {"best left out": "tested: the recordings fit best without it", NO_RESPONSE: f"not tested: it {NO_RESPONSE}"}
#: Longest vector that is spelled out.
MOST_NUMBERS = 6
#: Names of files in the folder of a report.
EFFECTS_FILE = "effects.yaml"


@dataclass(frozen=True)
class SimulatorChange:
    """A change of the simulator: a sentence without its full stop, and how MJCF says it (empty when it cannot)."""

    instruction: str
    mjcf: str

    def __str__(self) -> str:
        """Return both as one sentence."""
        return f"{self.instruction}; in MJCF: {self.mjcf}." if self.mjcf else f"{self.instruction}; {NO_ATTRIBUTE}."


@dataclass(frozen=True)
class ReportContext:
    """What advice needs beside the record.

    Attributes
    ----------
    folder : Path
        Where the report's files lie, as seen from where its reader stands. A page is read in it: see `beside_files`.
    groups : mapping of str to tuple of str
        The joints of each group of the scene.
    mjcf_lines : tuple of str
        The elements of the MJCF that the named effects change, as they are to be; empty where MJCF holds none of them.
    """

    folder: Path = Path()
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mjcf_lines: tuple[str, ...] = ()

    def beside_files(self) -> ReportContext:
        """Return the same for a reader who stands in the folder: nothing of it depends on where the folder lies."""
        return replace(self, folder=Path())

    def path(self, file: str) -> str:
        """Return the path of a file of the report, as a shell takes it."""
        return shlex.quote(str(self.folder / file))


def changes(report: Report, context: ReportContext | None = None) -> list[SimulatorChange]:
    """Return what to change for each named effect, in the order of the record."""
    groups = None if context is None else context.groups
    return [change(effect_found, groups) for effect_found in report.effects]


def commands(report: Report, context: ReportContext) -> list[tuple[str, str]]:
    """Return commands that use the repair, as (what for, command); empty when no effect is named."""
    if not report.effects:
        return []
    effects_file = context.path(EFFECTS_FILE)
    repaired = [("simulate with it", f"candata generate-sim --effects {effects_file} --episodes 8 --out repaired")]
    if context.mjcf_lines:
        repaired.append(
            ("write it into your MJCF", f"candata scene export --effects {effects_file} --out repaired_model")
        )
    return repaired


def change(effect_found: NamedEffect, groups: Mapping[str, tuple[str, ...]] | None = None) -> SimulatorChange:
    """Return what to change for one named effect; `groups` holds the joints of each group of the scene, if any."""
    values = [_value(effect_found, parameter, estimate) for parameter, estimate in effect_found.parameters.items()]
    text, si_numbers = words.enumeration([v for v, _ in values]), " ".join(r for _, r in values)
    element = effect_found.element
    members = words.enumeration((groups or {}).get(element, ())) if element else ""
    all_joints = "every jaw" if any(e.unit for e in effect_found.parameters.values()) else "every driven joint"
    places = {
        "joint": f"joint {element}" if element else all_joints,
        "servo": f"the servo of {element}" if element else "every servo",
        "link": f"link {element}" if element else "every moving link",
        "tip": f"fingertip {element}" if element else "every fingertip",
        "surface": f"{element}" if element else "object, fingertips and support",
    }
    if members:
        places |= {
            "joint": f"joints {members} (group {element})",
            "servo": f"the servos of {members} (group {element})",
        }
    kind = EFFECTS.load(effect_found.name) if effect_found.name in EFFECTS else None
    if kind is None or kind.advice is None:
        about = f"{kind.about}, " if kind else ""
        return SimulatorChange(f"Add {words.effect_title(effect_found.name, element)}: {about}{text}", "")
    return SimulatorChange(kind.advice.change.format(x=text, **places), kind.advice.mjcf.format(raw=si_numbers))


def next_motion(report: Report, context: ReportContext) -> str:
    """Return what to record next, and the path of its commands; empty when nothing is proposed."""
    file = report.next_motion.file if report.next_motion else None
    return words.next_motion_sentence(report, context.path(file) if file else None)


def next_step(report: Report) -> str:
    """Return what to do with the simulator when no effect is named; empty when one is."""
    missing_count = max(0, FEWEST - report.data.episodes.total)
    return {
        "no_gap": "Nothing: keep the simulator as it is.",
        "ambiguous": "Nothing yet: changing either of the tied effects would fit these recordings and may be wrong for "
        "others. Record the next motion first.",
        "unknown_effect": "No parameter of the library: fitting one would hide the cause.",
        "too_little_data": f"Nothing yet: record {f'{missing_count} ' if missing_count else ''}more episodes and "
        "diagnose again.",
        "out_of_budget": "Nothing yet: diagnose again with a larger --budget.",
    }.get(report.verdict, "")


def untested_effects(report: Report) -> list[tuple[str, str]]:
    """Return the effects that could not be tested, and why, as (effects, reason).

    A named effect is left out: it was tested beside the others.
    """
    names_by_reason: dict[str, list[str]] = {}
    named_effects = {effect_found.name for effect_found in report.effects}
    for candidate in report.ranking:
        if candidate.reason and candidate.name not in named_effects:
            reason = REASONS.get(candidate.reason, candidate.reason)
            names_by_reason.setdefault(reason, []).append(candidate.name)
    unranked_names = set(effect_names()) - {candidate.name.split(" ")[0] for candidate in report.ranking}
    for name in sorted(unranked_names) if report.ranking else ():
        channels = effect(name).moves
        reason = "not a candidate here: the scene has nothing for it to act on"
        if channels and not set(channels) & set(report.data.channels):
            reason = f"{words.enumeration([words.readable_name(c) for c in channels], 'or')} was not recorded"
        names_by_reason.setdefault(reason, []).append(name)
    return [
        (words.enumeration(list(map(words.readable_name, names))), reason) for reason, names in names_by_reason.items()
    ]


def missing_channels(report: Report) -> list[str]:
    """Return the channels that were not compared because they were not recorded."""
    compared_channels = ("joint_position", "object_pose", "fingertip_force")
    return [c for c in compared_channels if report.data.channels and c not in report.data.channels]


def _value(effect_found: NamedEffect, parameter: str, estimate: Estimate) -> tuple[str, str]:
    """Return a parameter for people, with its interval, and as the SI number that a file takes."""
    if isinstance(estimate.value, str):
        return estimate.value, estimate.value
    unit = unit_of(effect_found.name, parameter, estimate)
    if isinstance(estimate.value, tuple):
        if len(estimate.value) > MOST_NUMBERS:
            return f"the {len(estimate.value)} values of effects.yaml", "the values of effects.yaml"
        value = format_estimate(Estimate(value=estimate.value), unit)
        return str(value), " ".join(digits(v) for v in estimate.value)
    text = format_estimate(estimate, unit)
    equally_good = f"; {text.equally_good} explains as well" if text.equally_good else ""
    interval = f" ({text.interval}{equally_good})" if text.interval else ""
    return f"{text.value} {text.unit}".strip() + interval, digits(float(estimate.value)).replace(",", "")
