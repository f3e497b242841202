"""A report in plain English: one sentence each for where, which, how far and what is not known."""

from __future__ import annotations

import re
from collections.abc import Sequence

from candata.reports.numbers import AS_WELL, SUFFIX_UNITS, digits, percent, reading, unit_of
from candata.schema.report import EditTest, NamedEffect, Report, Symptom, Verdict

#: A space at which no line ends.
TIE = "\N{NO-BREAK SPACE}"
#: Most episodes that a sentence names.
NAMED_EPISODES = 3
#: The verdict as a headline.
HEADLINES: dict[Verdict, str] = {
    "no_gap": "No gap found",
    "explained": "Explained",
    "partly_explained": "Partly explained",
    "ambiguous": "Ambiguous",
    "unknown_effect": "Unknown effect",
    "too_little_data": "Too little data",
    "out_of_budget": "Out of budget",
}

_MEANINGS: dict[Verdict, str] = {
    "no_gap": "The recordings differ from the simulation no more than sensor noise alone would make them.",
    "explained": "The named effects pass the held-out test and close most of the gap: at least 80 % of it, half "
    "where no more than 0.30 floors remain, or what can be told of a gap smaller than that.",
    "partly_explained": "The named effects pass the held-out test and close at least 30 % of the gap (one name alone "
    "half), of all episodes or of all but a few, but something else remains.",
    "ambiguous": "Two or more candidates explain the recordings equally well, so none is named.",
    "unknown_effect": "There is a gap, but no effect in the library accounts for it, so none is named.",
    "too_little_data": "There are too few episodes to hold some out, so nothing can be concluded.",
    "out_of_budget": "Its CPU time was spent before the search ended: what is known by then is told, but no effect is "
    "named.",
}

#: Other words of the page.
TERMS = {
    "floor": "the mismatch that sensor noise and luck alone give; 1 floor is as good as it can get",
    "held out": "episodes that took no part in the fit they judge, so a gain there is no accident of fitting",
    "gain": "how much the robust loss falls on held-out episodes, in floors",
    "share": "how much of the gain is lost when this effect alone is left out; of effects that need one another the "
    "shares add up to more than 100 %",
    "support": "how often a candidate comes first when episodes are resampled, in a set before what was tried in its "
    "place; less where the named set leaves much",
    "p": "how likely chance alone would show a cell as strong, over all cells",
}

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


def explain(verdict: Verdict) -> str:
    """Return one sentence that says what a verdict word means."""
    return _MEANINGS[verdict]


def where(report: Report) -> str:
    """Return the sentence that says in which channels and phases the gap shows."""
    if report.verdict == "too_little_data" and not report.where:
        return "Not examined: there are too few episodes."
    if report.verdict == "out_of_budget" and report.gap is None:
        return "Not examined: the budget was spent before."
    if not report.where:
        return "No channel leaves the range that sensor noise alone explains."
    first, *rest = report.where
    text = f"The gap shows most in {place(first)}: {times(first.ratio)} ({chance(first.p)})"
    others = list(dict.fromkeys(place(symptom) for symptom in rest))[:2]
    return f"{text}; then in {listed(others)}." if others else f"{text}."


def where_short(report: Report) -> str:
    """Return the strongest symptom in a few words; empty when there is none."""
    if not report.where:
        return ""
    first = report.where[0]
    phase = f", {plain(first.phase)}" if first.phase else ""
    return capital(first.element or _CHANNELS.get(first.channel, plain(first.channel))) + phase


def which_short(report: Report) -> str:
    """Return the named or tied effects in a few words; empty when none is."""
    if report.verdict == "ambiguous":
        return capital(listed([plain(name) for name in report.ambiguous_class], "or"))
    return capital(listed([title(effect.name, effect.element) for effect in report.effects]))


def which(report: Report) -> str:
    """Return the sentence that names the effects, or says why none is named."""
    if report.verdict == "no_gap":
        return "None: no effect does better than the unchanged simulation."
    if report.verdict == "too_little_data":
        return "None is named: no effect can be tested on held-out episodes."
    if report.verdict == "out_of_budget":
        return f"None is named: the search was not finished{_first(report, '; first so far is ')}."
    if report.verdict == "ambiguous":
        tied = listed([plain(name) for name in report.ambiguous_class], "or") or "several candidates"
        return f"{capital(tied)}: these recordings cannot tell them apart."
    if not report.effects:
        return f"No effect in the library explains the gap{_first(report, '; the nearest is ')}."
    return capital(listed([effect_phrase(effect) for effect in report.effects])) + "."


def _first(report: Report, before: str) -> str:
    """Return the first of the ranking with words before it; empty where nothing was looked at."""
    first = next((one for one in report.ranking if one.reason is None), None)
    return before + title(first.name, first.element) if first else ""


def how_far(report: Report) -> str:
    """Return the sentence that says how much of the gap closes on held-out episodes."""
    gap = report.gap
    if gap is None:
        return "Not measured."
    before, after = digits(gap.before), digits(gap.after)
    if gap.closed is None:
        return f"On held-out episodes the mismatch is {before} times the floor; noise alone gives about 1."
    if not was_tried(report):
        return f"No candidate passes the held-out test: the mismatch stays at {before} times the floor."
    span = "" if gap.low is None or gap.high is None else f" (90 % interval {_span(gap.low, gap.high)})"
    doer = "Adding them" if len(report.effects) > 1 else "Adding it"
    doer = doer if report.effects else "The best candidate"
    verb = "would close" if not report.effects else "closes"
    return (
        f"{doer} {verb} {percent(gap.closed)} of the gap on held-out episodes{span}: "
        f"the mismatch goes from {before} to {after} times the floor.{_outlying(report)}"
    )


def _outlying(report: Report) -> str:
    """Return the sentence about few episodes that hold most of what remains; empty where no few do."""
    gap = report.gap
    if gap is None or not gap.outlying or gap.closed_elsewhere is None:
        return ""
    few, most = gap.outlying[:NAMED_EPISODES], len(gap.outlying)
    who = f"Episode {few[0]} holds" if most == 1 else f"Episodes {listed(few)} hold"
    who = who if most == len(few) else f"{most} episodes ({', '.join(few)} and others) hold"
    return f" {who} most of what remains; of the gap of the others {percent(gap.closed_elsewhere)} closes."


def was_tried(report: Report) -> bool:
    """Tell whether held-out episodes were simulated with an effect: nothing is tried where no candidate passes."""
    gap = report.gap
    return gap is not None and gap.closed is not None and (bool(report.effects) or gap.after != gap.before)


def edit_test(report: Report) -> str:
    """Return the sentence that says whether the shrinkage is kept in another world; empty when not tested."""
    return edit_words(report.edit) if report.edit else ""


def edit_words(edit: EditTest) -> str:
    """Return the sentence of an edit test."""
    numbers = f"from {digits(edit.before)} to {digits(edit.after)} times the floor, nothing refitted"
    if edit.closed is None:
        word = "opens a gap" if edit.kept is False else "finds no gap to close"
        return f"In {edit.dataset} it {word}: {numbers}."
    span = "" if edit.low is None or edit.high is None else f" (90 % interval {_span(edit.low, edit.high)})"
    word = "It is kept" if edit.kept else "It is not kept"
    return f"{word} in {edit.dataset}: {percent(edit.closed)} closes there{span}, {numbers}."


def not_known(report: Report) -> str:
    """Return what the diagnosis does not know: the unknown part, ties, bounds and a guessed floor."""
    parts = []
    if report.unknown is not None:
        parts.append(report.unknown.words.strip().rstrip("."))
    if report.verdict == "ambiguous":
        parts.append("Which of the tied candidates is the cause" + _what_separates(report))
    if report.verdict == "too_little_data":
        parts.append("Everything: record at least eight episodes")
    parts += [
        f"{capital(title(effect.name, effect.element))} stopped at its bound; its true value may lie beyond"
        for effect in report.effects
        if effect.at_bound
    ]
    parts += [
        f"{capital(title(effect.name, effect.element))} is known from one side: with any "
        f"{AS_WELL[estimate.bounded]} the simulation comes as near these recordings"
        for effect in report.effects
        for estimate in effect.parameters.values()
        if estimate.bounded in AS_WELL and not effect.at_bound
    ]
    parts += [
        f"{capital(title(effect.name, effect.element))} may be {listed([plain(name) for name in effect.rivals], 'or')} "
        "instead: beside the other effects these recordings cannot tell them apart"
        for effect in report.effects
        if effect.rivals
    ]
    if report.data.floor == "assumed":
        parts.append("The floor is assumed from quiet stretches, so the size of the gap is uncertain")
    if not parts:
        parts.append(_nothing_more(report))
    return ". ".join(parts) + "."


def after_name(report: Report) -> str:
    """Return what to call the simulation after the repair: no repair is made when nothing is named."""
    return "repaired" if report.effects else "best candidate"


def next_motion(report: Report) -> str:
    """Return the sentence that says what to record next; empty when nothing is proposed."""
    motion = report.next_motion
    if motion is None:
        return ""
    separates = listed([plain(name) for name in motion.separates], "from")
    text = f"Record {plain(motion.name)}" + (f" ({motion.file})" if motion.file else "")
    text = f"{text}: it separates {separates}." if separates else f"{text}."
    return f"{text} {capital(motion.reason)}." if motion.reason else text


def place(symptom: Symptom) -> str:
    """Return `joint position of index2 during release, above all while it moves`, the latter where it is known."""
    text = _CHANNELS.get(symptom.channel, plain(symptom.channel))
    if symptom.channel == "object_pose" and symptom.element:
        text = f"the object's {symptom.element}"
    elif symptom.element:
        text += f" of {symptom.element}"
    text += f" during {plain(symptom.phase)}" if symptom.phase else ""
    return text + (f", above all {_REGIMES.get(symptom.regime, plain(symptom.regime))}" if symptom.regime else "")


def title(name: str, element: str | None) -> str:
    """Return `joint dry friction at index2`, or the bare effect when it acts everywhere."""
    return plain(name) + (f" at {element}" if element else "")


def effect_phrase(effect: NamedEffect) -> str:
    """Return the effect with its parameters, intervals and units."""
    values = [
        f"{label(parameter)}{reading(estimate, unit_of(effect.name, parameter, estimate))}"
        for parameter, estimate in effect.parameters.items()
    ]
    return title(effect.name, effect.element) + (f", {listed(values)}" if values else "")


def label(parameter: str) -> str:
    """Return the parameter's name without its unit, ready to stand before a number."""
    ending = next((ending for ending, _ in SUFFIX_UNITS if parameter.endswith(ending)), "")
    return plain(parameter.removesuffix(ending)) + " "


def times(ratio: float) -> str:
    """Return `4.2 times the floor`."""
    return f"{digits(ratio)} times the floor"


def chance(p: float) -> str:
    """Return a p-value as `p = 0.004`, never as zero."""
    return f"p = {p:.3g}" if p >= 1e-4 else "p < 0.0001"


def tied(text: str) -> str:
    """Return the text with spaces that do not break between a number and its unit, and inside `p = 0.01`."""
    units = r"(?<=\d) (?=(?:%|N|m|mm|ms|s|mrad|rad|kg|g|ppm)(?:\W|$))"
    return (
        re.sub(units, TIE, text)
        .replace("p = ", f"p{TIE}={TIE}")
        .replace("N m", f"N{TIE}m")
        .replace(" m s/rad", f"{TIE}m{TIE}s/rad")
    )


def plain(name: str) -> str:
    """Return a registered name with spaces for underscores."""
    return name.replace("_", " ")


def capital(text: str) -> str:
    """Return the text with its first letter raised and the rest as it is."""
    return text[:1].upper() + text[1:]


def listed(parts: Sequence[str], last: str = "and") -> str:
    """Return `a`, `a and b` or `a, b and c`; semicolons where a part holds a comma."""
    if len(parts) < 2:
        return "".join(parts)
    gap = "; " if any("," in part for part in parts) else ", "
    joint = f"; {last} " if gap == "; " else f" {last} "
    return gap.join(parts[:-1]) + joint + parts[-1]


def _span(low: float, high: float) -> str:
    """Return `95 to 99 %`."""
    return f"{percent(low).removesuffix(' %')} to {percent(high)}"


def _what_separates(report: Report) -> str:
    """Return the motion that would decide a tie, as the rest of a sentence."""
    motion = report.next_motion
    return f"; the motion {plain(motion.name)} would tell" if motion else ""


def _nothing_more(report: Report) -> str:
    """Return what is honest to say when the record lists nothing unknown."""
    if report.verdict == "no_gap":
        return "Differences smaller than the floor, and motions that these episodes do not contain"
    if report.gap is not None and report.gap.closed is not None:
        left, carries = (
            report.gap.after - report.gap.floor,
            f"whether the repair carries over to {'yet ' if report.edit else ''}other objects and motions",
        )
        return (
            f"What makes up the remaining {digits(left)} floors, and {carries}"
            if left >= 0.05
            else carries.capitalize()
        )
    return "What causes the gap"
