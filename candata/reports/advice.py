"""What to change in a simulator, in words: the amount, the place, and the MJCF attribute where there is one."""

from __future__ import annotations

from dataclasses import dataclass

from candata.effects import effect, effect_names
from candata.errors import UnknownNameError
from candata.gap.verdict import FEWEST
from candata.reports import words
from candata.reports.numbers import digits, format_estimate, unit_of
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
#: What is said of an effect that MJCF has no attribute for.
NO_ATTRIBUTE = "MJCF has no attribute for it: candata generate-sim --effects effects.yaml adds it"
#: The record's words for a candidate whose probes changed nothing in the readings.
NO_RESPONSE = "moves nothing in these motions"
#: Reason of the record to the fuller one of the page.
REASONS = {"best left out": "tested: the recordings fit best without it", NO_RESPONSE: f"not tested: it {NO_RESPONSE}"}
#: Longest vector that is spelled out.
MOST_NUMBERS = 6


@dataclass(frozen=True)
class SimulatorChange:
    """A change of the simulator: a sentence without its full stop, and how MJCF says it (empty when it cannot)."""

    instruction: str
    mjcf: str

    def __str__(self) -> str:
        """Return both as one sentence."""
        return f"{self.instruction}; in MJCF: {self.mjcf}." if self.mjcf else f"{self.instruction}; {NO_ATTRIBUTE}."


def changes(report: Report) -> list[SimulatorChange]:
    """Return what to change for each named effect, in the order of the record."""
    return [change(effect_found) for effect_found in report.effects]


def change(effect_found: NamedEffect) -> SimulatorChange:
    """Return what to change for one named effect."""
    values = [_value(effect_found, parameter, estimate) for parameter, estimate in effect_found.parameters.items()]
    text, si_numbers = words.enumeration([v for v, _ in values]), " ".join(r for _, r in values)
    element = effect_found.element
    all_joints = "every jaw" if any(e.unit for e in effect_found.parameters.values()) else "every driven joint"
    places = {
        "joint": f"joint {element}" if element else all_joints,
        "servo": f"the servo of {element}" if element else "every servo",
        "tip": f"fingertip {element}" if element else "every fingertip",
        "surface": f"{element}" if element else "object, fingertips and support",
    }
    if effect_found.name not in PHRASES:
        title = words.effect_title(effect_found.name, element)
        return SimulatorChange(f"Add {title}: {_description(effect_found.name)}{text}", "")
    instruction, mjcf = PHRASES[effect_found.name]
    return SimulatorChange(instruction.format(x=text, **places), mjcf.format(raw=si_numbers))


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


def _description(name: str) -> str:
    """Return an effect's own line; empty for an effect that this version does not have."""
    try:
        return f"{effect(name).about}, "
    except UnknownNameError:
        return ""
