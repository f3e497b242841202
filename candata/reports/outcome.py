"""What happened in a case, in one sentence, and what the words of a verdict mean."""

from __future__ import annotations

from candata.effects import effect, effect_names
from candata.gap.fit.folds import FEWEST
from candata.reports import words
from candata.reports.numbers import digits, percent
from candata.schema.report import Report, Verdict

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

#: What each verdict means; `docs/diagnosing.md` has the thresholds.
_MEANINGS: dict[Verdict, str] = {
    "no_gap": "The recordings differ from the simulation no more than sensor noise alone would make them.",
    "explained": "The named effects pass the held-out test and close most of the gap.",
    "partly_explained": "The named effects pass the held-out test and close a part of the gap; something else remains.",
    "ambiguous": "Two or more candidates explain the recordings equally well, so none is named.",
    "unknown_effect": "There is a gap, but no effect in the library accounts for it, so none is named.",
    "too_little_data": "There are too few episodes to hold some out, so nothing can be concluded.",
    "out_of_budget": "The CPU time was spent before the search ended: the report says what is known by then, but no "
    "effect is named.",
}

#: What a floor is, said where the page first counts in floors.
FLOOR = (
    "The noise floor is the mismatch that sensor noise alone makes, found by replaying the simulation against a noisy "
    "recording of itself: a mismatch of 1 floor is as good as a simulator can get."
)

#: Other words of the page.
TERMS = {
    "floor": "the mismatch that sensor noise and luck alone give; 1 floor is as good as it can get",
    "gap": "what lies above the floor; closing 80 % means that four fifths of it are gone",
    "held out": "episodes that took no part in the fit they judge, so a gain there is no accident of fitting",
    "gain": "how much the robust loss falls on held-out episodes, in floors",
    "share": "how much of the gain is lost when this effect alone is left out; the shares of effects that need one "
    "another add up to more than 100 %",
    "support": "how often a candidate comes first when episodes are resampled; in a set, how often it comes before "
    "what was tried in its place; lower when the named set leaves much of the gap",
    "p": "how likely chance alone would show a cell as strong, over all cells",
}


#: Support below which a name is more often wrong than right, as support is calibrated (`docs/measured.md`).
BELIEVED = 0.5


def explain(verdict: Verdict) -> str:
    """Return one sentence that says what a verdict word means."""
    return _MEANINGS[verdict]


def headline(report: Report) -> str:
    """Return the verdict in a few words; against a reference, that nothing changed."""
    is_unchanged = report.verdict == "no_gap" and report.data.against
    return "No change found" if is_unchanged else HEADLINES[report.verdict]


def outcome(report: Report) -> str:
    """Return the sentence that says what happened in this case: the cause, and how far the mismatch falls with it."""
    if report.verdict == "too_little_data":
        count = report.data.episodes.total
        number = f"{count} episode is" if count == 1 else f"{count or 'No'} episodes are"
        return f"{number} too few to judge an effect on recordings that took no part in its fit: {FEWEST} are needed."
    if report.verdict == "no_gap":
        subject = f"Nothing changed since {report.data.against}" if report.data.against else "The simulation is right"
        return f"{subject} as far as the noise of the sensors lets one see{_mismatch(report, ': the mismatch is ')}."
    if report.verdict == "out_of_budget":
        return (
            "The CPU time was spent before the search ended, so no effect is named"
            f"{_mismatch(report, '; the mismatch is ')}."
        )
    if report.verdict == "ambiguous":
        names = [words.label_title(label) for label in report.ambiguous_class]
        subject = words.sentence_case(words.enumeration(names)) or "Several effects"
        return (
            f"{subject} explain {_gap(report)} equally well, so none is named{_mismatch(report, '; the mismatch is ')}."
        )
    if not report.effects:
        return f"No effect of the library explains {_gap(report)}{_mismatch(report, '; the mismatch stays at ')}."
    return _explanation(report)


def against_note(report: Report) -> str:
    """Return what a gap is where a reference was given; empty without one."""
    if not report.data.against:
        return ""
    return (
        f"The gap is what changed since {report.data.against}: what the simulation already leaves open there does not "
        "count."
    )


def belief_note(report: Report) -> str:
    """Return that names of a part of the gap are hardly believed; empty where one of them is, or none is named."""
    supports = [named.support for named in report.effects]
    if report.verdict != "partly_explained" or max(supports, default=1.0) >= BELIEVED:
        return ""
    most = percent(max(supports))
    note = f"The support of the names is at most {most}: they stand in for the cause more likely than they are it."
    known = [effect(named.name) for named in report.effects if named.name in effect_names()]
    if any("solver" in entry.traits for entry in known):
        note += " A contact law or solver that the simulator does not have shows like this."
    return note


def _explanation(report: Report) -> str:
    """Return the sentence of a verdict that names effects."""
    titles = [words.effect_title(named.name, named.element) for named in report.effects]
    subject = words.sentence_case(words.enumeration(titles))
    verb, pronoun = ("explain", "them") if len(titles) > 1 else ("explains", "it")
    gap, is_partial = report.gap, report.verdict == "partly_explained"
    share = f"{percent(gap.closed)} of " if is_partial and gap is not None and gap.closed is not None else ""
    text = f"{subject} {verb} {share or ('a part of ' if is_partial else '')}{_gap(report)}"
    if gap is not None:
        text += f"; with {pronoun} the mismatch falls from {digits(gap.before)} times the noise floor to "
        text += digits(gap.after)
    return f"{text}, and something else remains." if is_partial else f"{text}."


def _gap(report: Report) -> str:
    """Return what is to be explained."""
    return f"what changed since {report.data.against}" if report.data.against else "the gap"


def _mismatch(report: Report, prefix: str) -> str:
    """Return the mismatch of the nominal simulation with words before it; empty when it was not measured."""
    return "" if report.gap is None else f"{prefix}{digits(report.gap.before)} times the noise floor"
