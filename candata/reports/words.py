"""A report in plain English: one sentence each for where, which, how far and what is not known."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from candata.reports.numbers import EQUALLY_GOOD, SUFFIX_UNITS, digits, format_estimate, percent, unit_of
from candata.schema.report import EditTest, NamedEffect, Report, SharedGap, Symptom

#: A space at which no line ends.
TIE = "\N{NO-BREAK SPACE}"
#: Most episodes that a sentence names.
NAMED_EPISODES = 3
#: Remainder of the gap [floors] below which a sentence does not speak of it.
SMALLEST_REMAINDER = 0.05
_CHANNELS = {
    "object_pose": "the object's pose",
    "object_position": "the object's position",
    "object_rotation": "the object's rotation",
    "object_velocity": "the object's velocity",
    "joint_position": "joint position",
    "joint_velocity": "joint velocity",
    "joint_effort": "joint effort",
    "hand_pose": "the hand's pose",
    "fingertip_force": "fingertip force",
}

#: Phases of contact as a sentence speaks of them; a name of its own where there is no entry.
_PHASES = {
    "free": "free motion",
    "onset": "the onset of contact",
    "sustained": "sustained contact",
    "slip": "slip",
    "release": "release",
}
#: Regimes that go without saying in a phase.
_IMPLIED_REGIMES = {"onset": "loaded", "sustained": "loaded", "slip": "loaded", "free": "free"}

#: Where the excess of an element lies, by the regime of the record.
_REGIMES = {
    "moving": "while it moves",
    "moving +": "while it moves up (+)",
    "moving -": "while it moves down (-)",
    "reversal": "where it turns back",
    "still": "while it stands still",
    "loaded": "under contact",
    "free": "out of contact",
    "pulling": "where its motor pulls",
    "idle": "where its motor hardly pulls",
}


def where_sentence(report: Report) -> str:
    """Return the sentence that says in which channels and phases the gap shows."""
    if report.verdict == "too_little_data" and not report.where:
        return "Not examined: there are too few episodes."
    if report.verdict == "out_of_budget" and report.gap is None:
        return "Not examined: the budget was spent before."
    if not report.where:
        return "No channel leaves the range that sensor noise alone explains."
    strongest_symptom, *weaker_symptoms = report.where
    size = f"{times_floor(strongest_symptom.ratio)} ({p_text(strongest_symptom.p)})"
    text = f"The gap shows most in {symptom_place(strongest_symptom)}: {size}"
    next_places = list(dict.fromkeys(_next_place(symptom, strongest_symptom) for symptom in weaker_symptoms))[:2]
    return f"{text}; then {enumeration(next_places)}." if next_places else f"{text}."


def _next_place(symptom: Symptom, strongest: Symptom) -> str:
    """Return the place of a weaker symptom, of the same element by its phase alone."""
    same_fields = ("channel", "element", "regime")
    if symptom.phase and all(getattr(symptom, name) == getattr(strongest, name) for name in same_fields):
        return f"during {_phase_words(symptom.phase)}"
    return f"in {symptom_place(symptom)}"


def where_headline(report: Report) -> str:
    """Return the strongest_symptom symptom in a few words; empty when there is none."""
    if not report.where:
        return ""
    strongest_symptom = report.where[0]
    phase = f", {readable_name(strongest_symptom.phase)}" if strongest_symptom.phase else ""
    if strongest_symptom.element and strongest_symptom.channel != "object_pose":
        return strongest_symptom.element + phase  # a name of the model's, written as it is
    return sentence_case(strongest_symptom.element or _channel_words(strongest_symptom.channel)) + phase


def cause_headline(report: Report) -> str:
    """Return the named or tied effects in a few words; empty when none is."""
    if report.verdict == "ambiguous":
        return sentence_case(enumeration([label_title(label) for label in report.ambiguous_class], "or"))
    return sentence_case(enumeration([effect_title(effect.name, effect.element) for effect in report.effects]))


def cause_sentence(report: Report) -> str:
    """Return the sentence that names the effects, or says why none is named."""
    if report.verdict == "no_gap":
        return "None: no effect does better than the unchanged simulation."
    if report.verdict == "too_little_data":
        return "None is named: no effect can be tested on held-out episodes."
    if report.verdict == "out_of_budget":
        return f"None is named: the search was not finished{_best_ranked(report, '; first so far is ')}."
    if report.verdict == "ambiguous":
        candidates = enumeration([label_title(label) for label in report.ambiguous_class], "or") or "several candidates"
        return f"{sentence_case(candidates)}: these recordings cannot tell them apart."
    if not report.effects:
        return f"No effect in the library explains the gap{_best_ranked(report, '; the nearest is ')}."
    return sentence_case(enumeration([effect_phrase(effect) for effect in report.effects])) + "."


def _best_ranked(report: Report, prefix: str) -> str:
    """Return the best tested candidate with words before it; empty when no candidate was tested."""
    best_candidate = next((candidate for candidate in report.ranking if candidate.reason is None), None)
    return prefix + effect_title(best_candidate.name, best_candidate.element) if best_candidate else ""


def closure_sentence(report: Report) -> str:
    """Return the sentence that says how much of the gap closes on held-out episodes."""
    gap = report.gap
    if gap is None:
        return "Not measured."
    mismatch_before, mismatch_after = digits(gap.before), digits(gap.after)
    if gap.closed is None:
        return f"On held-out episodes the mismatch is {mismatch_before} times the floor; noise alone gives about 1."
    if not repair_was_tried(report):
        return f"No candidate passes the held-out test: the mismatch stays at {mismatch_before} times the floor."
    interval = "" if gap.low is None or gap.high is None else f" (90 % interval {_interval(gap.low, gap.high)})"
    subject = "Adding them" if len(report.effects) > 1 else "Adding it"
    subject = subject if report.effects else "The best candidate"
    verb = "would close" if not report.effects else "closes"
    return (
        f"{subject} {verb} {percent(gap.closed)} of the gap on held-out episodes{interval}: "
        f"the mismatch goes from {mismatch_before} to {mismatch_after} times the floor.{_outlier_sentence(report)}"
    )


def _outlier_sentence(report: Report) -> str:
    """Return the sentence about the few episodes that hold most of what remains; empty when there are none."""
    gap = report.gap
    if gap is None or not gap.outlying or gap.closed_elsewhere is None:
        return ""
    episodes, count = gap.outlying[:NAMED_EPISODES], len(gap.outlying)
    subject = f"Episode {episodes[0]} holds" if count == 1 else f"Episodes {enumeration(episodes)} hold"
    if count > len(episodes):
        subject = f"{count} episodes ({', '.join(episodes)} and others) hold"
    return f" {subject} most of what remains; {percent(gap.closed_elsewhere)} of the gap of the others closes."


def repair_was_tried(report: Report) -> bool:
    """Return whether held-out episodes were simulated with an effect; no effect is tried when no candidate passes."""
    gap = report.gap
    return gap is not None and gap.closed is not None and (bool(report.effects) or gap.after != gap.before)


def edit_sentence(report: Report) -> str:
    """Return the sentence that says whether the shrinkage is kept in another world; empty when not tested."""
    return edit_words(report.edit) if report.edit else ""


def learned_sentence(report: Report) -> str:
    """Return the sentence of a trained model beside the repair; empty when no run was named."""
    learned = report.learned
    if learned is None:
        return ""
    name = PurePath(learned.run).name
    if learned.closed.share is None:
        return f"The model {name} has no gap of the object's motion to close: the simulator leaves too little."
    words = f"The model {name} closes {_shared_gap(learned.closed)} of the gap of the object's motion"
    if learned.repair is not None:
        words += f", the repair {_shared_gap(learned.repair)}"
    fitted = ", on which the repair was fitted" if learned.repair is not None else ""
    return f"{words} (ADD-S AUC in closed loop, {learned.episodes} episodes that it was not trained on{fitted})."


def _shared_gap(gap: SharedGap) -> str:
    """Return a share of the gap, with its interval where there is one."""
    if gap.share is None:
        return "nothing"
    interval = "" if gap.low is None or gap.high is None else f" ({_interval(gap.low, gap.high)})"
    return f"{percent(gap.share)}{interval}"


def edit_words(edit: EditTest) -> str:
    """Return the sentence of an edit test."""
    numbers = f"from {digits(edit.before)} to {digits(edit.after)} times the floor, nothing refitted"
    if edit.closed is None:
        predicate = "opens a gap" if edit.kept is False else "finds no gap to close"
        return f"In {edit.dataset} it {predicate}: {numbers}."
    interval = "" if edit.low is None or edit.high is None else f" (90 % interval {_interval(edit.low, edit.high)})"
    predicate = "is kept" if edit.kept else "is not kept"
    return f"It {predicate} in {edit.dataset}: {percent(edit.closed)} closes there{interval}, {numbers}."


def calibration_sentence(report: Report) -> str:
    """Return the sentence that says what a calibration closes, and that it names no causes; empty without one."""
    calibration = report.calibration
    if calibration is None:
        return ""
    size, names = calibration.gap, enumeration([effect_title(e.name, e.element) for e in calibration.effects])
    known = f"{calibration.combinations} combinations" if calibration.combinations < calibration.numbers else "all"
    return (
        f"calibration.yaml closes {percent(size.closed or 0.0)} of the gap on held-out episodes (90 % interval "
        f"{_interval(size.low or 0.0, size.high or 0.0)}): a better simulator, no claim of causes. Fitted together: "
        f"{readable_name(names)}; the recordings tell {known} of their {calibration.numbers} numbers."
    )


def unknowns_sentence(report: Report) -> str:
    """Return what the diagnosis does not know: the unknown part, ties, bounds and a guessed floor."""
    parts = []
    if report.unknown is not None:
        parts.append(report.unknown.words.strip().rstrip("."))
    if report.verdict == "ambiguous":
        parts.append("Which of the tied candidates is the cause" + _deciding_motion(report))
    if report.verdict == "too_little_data":
        parts.append("Everything: record at least eight episodes")
    for effect in report.effects:
        parts += _effect_unknowns(effect)
    if report.data.floor == "assumed":
        parts.append("The floor is assumed from quiet stretches, so the size of the gap is uncertain")
    if not parts:
        parts.append(_default_unknown(report))
    return ". ".join(parts) + "."


def _effect_unknowns(effect: NamedEffect) -> list[str]:
    """Return what is not known of a named effect: what lies beyond its bound, its open end, its rivals."""
    name = sentence_case(effect_title(effect.name, effect.element))
    if effect.at_bound:
        parts = [f"{name} stopped at its bound; its true value may lie beyond"]
    else:
        alternatives = [EQUALLY_GOOD.get(estimate.bounded) for estimate in effect.parameters.values()]
        parts = [
            f"{name} is known from one side: with any {alternative} the simulation comes as near these recordings"
            for alternative in alternatives
            if alternative
        ]
    if effect.rivals:
        rivals = enumeration([label_title(rival) for rival in effect.rivals], "or")
        parts.append(
            f"{name} may be {rivals} instead: beside the other effects these recordings cannot tell them apart"
        )
    return parts


def after_name(report: Report) -> str:
    """Return the name of the simulation after the fit: `repaired` only when effects are named."""
    return "repaired" if report.effects else "best candidate"


def next_motion_sentence(report: Report, file: str | None = None) -> str:
    """Return the sentence that says what to record next, and in which file; empty when nothing is proposed.

    `file` is the path of the motion's file from where the reader stands, the record's own name without it.
    """
    motion = report.next_motion
    if motion is None:
        return ""
    separates = enumeration([label_title(label) for label in motion.separates], "from")
    text = f"Record {readable_name(motion.name)}" + (f" ({file or motion.file})" if motion.file else "")
    text = f"{text}: it separates {separates}." if separates else f"{text}."
    return f"{text} {sentence_case(motion.reason)}." if motion.reason else text


def symptom_place(symptom: Symptom) -> str:
    """Return `joint position of index2 during release, above all while it moves`; the regime only when it is known."""
    text = _channel_words(symptom.channel)
    if symptom.channel == "object_pose" and symptom.element:
        text = f"the object's {symptom.element}"
    elif symptom.element:
        text += f" of {symptom.element}"
    text += f" during {_phase_words(symptom.phase)}" if symptom.phase else ""
    if not symptom.regime or symptom.regime == _IMPLIED_REGIMES.get(symptom.phase or ""):
        return text
    return f"{text}, above all {_REGIMES.get(symptom.regime, readable_name(symptom.regime))}"


def _phase_words(phase: str) -> str:
    """Return a phase of contact as a sentence speaks of it."""
    return _PHASES.get(phase, readable_name(phase))


def label_title(label: str) -> str:
    """Return a record's label of a candidate, `joint_damping left_base`, as `joint damping on left_base`."""
    name, _, element = label.partition(" ")
    return effect_title(name, element or None)


def effect_title(name: str, element: str | None) -> str:
    """Return `joint dry friction on index2`, or the bare effect when it acts everywhere."""
    return readable_name(name) + (f" on {element}" if element else "")


def effect_phrase(effect: NamedEffect) -> str:
    """Return the effect with its parameters, intervals and units."""
    values = [
        f"{parameter_label(parameter)}{format_estimate(estimate, unit_of(effect.name, parameter, estimate))}"
        for parameter, estimate in effect.parameters.items()
    ]
    return effect_title(effect.name, effect.element) + (f", {enumeration(values)}" if values else "")


def parameter_label(parameter: str) -> str:
    """Return the parameter's name without its unit, with a space behind it for a number."""
    ending = next((ending for ending, _ in SUFFIX_UNITS if parameter.endswith(ending)), "")
    return readable_name(parameter.removesuffix(ending)) + " "


def _channel_words(channel: str) -> str:
    """Return a channel in words."""
    return _CHANNELS.get(channel, readable_name(channel))


def times_floor(ratio: float) -> str:
    """Return `4.2 times the floor`."""
    return f"{digits(ratio)} times the floor"


def p_text(p: float) -> str:
    """Return a p-value as `p = 0.004`, never as zero."""
    return f"p = {p:.3g}" if p >= 1e-4 else "p < 0.0001"


def keep_units(text: str) -> str:
    """Return the text with spaces that no line breaks at between a number and its unit, and inside `p = 0.01`."""
    units = r"(?<=\d) (?=(?:%|N|m|mm|ms|s|mrad|rad|kg|g|ppm)(?:\W|$))"
    return (
        re.sub(units, TIE, text)
        .replace("p = ", f"p{TIE}={TIE}")
        .replace("N m", f"N{TIE}m")
        .replace(" m s/rad", f"{TIE}m{TIE}s/rad")
    )


def readable_name(name: str) -> str:
    """Return a registered name with spaces for underscores."""
    return name.replace("_", " ")


def sentence_case(text: str) -> str:
    """Return the text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def enumeration(parts: Sequence[str], conjunction: str = "and") -> str:
    """Return `a`, `a and b` or `a, b and c`; semicolons stand between parts when one of them holds a comma."""
    if len(parts) < 2:
        return "".join(parts)
    separator = "; " if any("," in part for part in parts) else ", "
    last_separator = f"; {conjunction} " if separator == "; " else f" {conjunction} "
    return separator.join(parts[:-1]) + last_separator + parts[-1]


def _interval(low: float, high: float) -> str:
    """Return `95 to 99 %`, or `100 % at both ends`."""
    if percent(low) == percent(high):
        return f"{percent(low)} at both ends"
    return f"{percent(low).removesuffix(' %')} to {percent(high)}"


def _deciding_motion(report: Report) -> str:
    """Return the motion that would decide a tie, as the end of a sentence; empty when none is proposed."""
    motion = report.next_motion
    return f"; the motion {readable_name(motion.name)} would tell" if motion else ""


def _default_unknown(report: Report) -> str:
    """Return what stays unknown even when the record lists nothing."""
    if report.verdict == "no_gap":
        return "Differences smaller than the floor, and motions that these episodes do not contain"
    if report.gap is None or report.gap.closed is None:
        return "What causes the gap"
    transfer = f"whether the repair carries over to {'yet ' if report.edit else ''}other objects and motions"
    remaining_floors = report.gap.after - report.gap.floor
    if remaining_floors < SMALLEST_REMAINDER:
        return sentence_case(transfer)
    return f"What makes up the remaining {digits(remaining_floors)} floors, and {transfer}"
