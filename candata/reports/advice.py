"""What to change in a simulator, in words: the amount, the place, and the MJCF attribute where there is one."""

from __future__ import annotations

from dataclasses import dataclass

from candata.effects import effect, effect_names
from candata.errors import UnknownNameError
from candata.reports import words
from candata.reports.numbers import digits, reading, unit_of
from candata.schema.report import Estimate, NamedEffect, Report

#: What to do, and how MJCF says it, by effect. `{x}` is the value with its interval, `{raw}` the SI number, `{joint}`,
#: `{tip}` and `{surface}` what it acts on. An effect that is not listed is said by its own `about` line.
#: Source of the attributes: MuJoCo manual, XML reference.
PHRASES: dict[str, tuple[str, str]] = {
    "joint_dry_friction": ("Add joint dry friction of {x} to {joint}", "add {raw} to frictionloss of the <joint>"),
    "joint_damping": ("Add joint damping of {x} to {joint}", "add {raw} to damping of the <joint>"),
    "armature": ("Add rotor inertia of {x} to {joint}", "add {raw} to armature of the <joint>"),
    "servo_gain": ("Multiply the position gain of {servo} by {x}", "multiply kp of the <position> actuator by {raw}"),
    "servo_damping": (
        "Multiply the velocity gain of {servo} by {x}",
        "multiply kv of the <position> actuator by {raw}",
    ),
    "torque_limit": ("Limit the torque of {servo} to {x}", 'forcerange="-{raw} {raw}" of the actuator'),
    "object_mass": (
        "Multiply the object's mass and inertia by {x}",
        "multiply mass or density of its <geom>s, or mass and diaginertia of its <inertial>",
    ),
    "object_com": ("Move the object's centre of mass by {x}, in its own frame", "add {raw} to pos of its <inertial>"),
    "object_size": ("Multiply the object's lengths by {x}, its mass unchanged", "multiply size and pos of its <geom>s"),
    "object_inertia": (
        "Multiply the object's inertia by {x}, its mass unchanged",
        "multiply diaginertia of its <inertial>",
    ),
    "sliding_friction": (
        "Multiply the sliding friction of {surface} by {x}",
        "multiply the first number of friction of the <geom>s (a contact takes the larger of its two: change all, or "
        "give one a higher priority)",
    ),
    "torsional_friction": (
        "Set the torsional friction of {tip} to {x}",
        "{raw} as the second number of friction of the <geom>, condim 4 or more, and a higher priority",
    ),
    "rolling_friction": (
        "Set the rolling friction of {surface} to {x}",
        "{raw} as the third number of friction of the <geom>s, condim 6",
    ),
    "anisotropic_friction": (
        "Make friction in the second sliding direction {x} times that in the first",
        "the second number of friction of the <pair>s",
    ),
    "contact_compliance": (
        "Set the time constant of contacts at {surface} to {x}",
        "{raw} as the first number of solref of the <geom>s that touch, the second as it is",
    ),
    "contact_damping": (
        "Set the damping ratio of contacts at {surface} to {x}",
        "{raw} as the second number of solref of the <geom>s that touch",
    ),
    "solimp_width": (
        "Let contacts with the object reach full stiffness over {x}",
        "{raw} as the third number of solimp of the object's <geom>s, and in proportion of those that touch it",
    ),
    "friction_cone": ("Use the {x} friction cone", '<option cone="{raw}"/>'),
    "impratio": ("Set impratio to {x}", '<option impratio="{raw}"/>'),
    "integrator": ("Use the {x} integrator", '<option integrator="{raw}"/>'),
    "time_step": ("Use a physics step of {x}", '<option timestep="{raw}"/>'),
    "gravity_tilt": ("Tilt gravity by {x}: table or base are not level", "turn gravity of <option>"),
    "support_height": ("Move the support by {x} along world z", "add {raw} to z in pos of its <geom>"),
    "actuation_delay": ("Delay the commands of {servo} by {x}", ""),
    "backlash": ("Give the gears of {joint} a play of {x}", ""),
    "joint_offset": ("Correct the encoders of {joint}: they read {x} too much", ""),
    "pose_bias": ("Correct the object tracker: its positions are off by {x} along world x, y, z", ""),
    "pose_rotation_bias": ("Correct the object tracker: its rotations are turned by {x} about world x, y, z", ""),
    "pose_scale": ("Correct the scale of the object tracker: its positions are {x} times the true ones", ""),
    "pose_latency": ("Correct the time stamps of the object tracker: its poses come {x} late", ""),
    "clock_drift": ("Correct the clock of the readings: it is off by {x}", ""),
    "tactile_gain": ("Correct the calibration of {tip}: forces read {x} times the true ones", ""),
    "tactile_bias": ("Correct the zero of {tip}: forces are off by {x}", ""),
    "tactile_dead_band": ("Allow for the dead band of {tip}: forces below {x} read zero", ""),
    "tactile_lag": ("Allow for the lag of {tip}: forces follow with a time constant of {x}", ""),
}
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
    if named.name not in PHRASES:
        return Change(f"Add {words.title(named.name, named.element)}: {_about(named.name)}{shown}", "")
    what, mjcf = PHRASES[named.name]
    return Change(what.format(x=shown, **places), mjcf.format(raw=raw))


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


def _about(name: str) -> str:
    """Return an effect's own line; empty for one that this version does not have."""
    try:
        return f"{effect(name).about}, "
    except UnknownNameError:
        return ""
