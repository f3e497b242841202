"""Verdicts follow the table of rules, and say what they do not know."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from candata.gap.verdict.verdict import class_of, unnamed_cause, verdict
from candata.schema.report import Gap, Symptom

SYMPTOMS = (
    Symptom(channel="object_pose", element="rotation z", phase="release", ratio=9.0, p=0.001),
    Symptom(channel="object_pose", element="position z", phase="release", ratio=5.0, p=0.001),
    Symptom(channel="joint_position", element="index2", phase="onset", ratio=3.0, p=0.01),
)


def fit(*labels: str):
    return SimpleNamespace(labels=labels, members=tuple((SimpleNamespace(name=label), None) for label in labels))


def found(chosen=None, tied: int = 1, remains: bool = False, names: int = 1):
    best = fit(*("object_mass", "object_com", "armature", "backlash")[:names]) if chosen else None
    fits = (fit("object_mass"), fit("object_com"))
    return SimpleNamespace(
        chosen=best, tied=fits[:tied] if chosen else (), remains=remains, first=SimpleNamespace(fits=fits)
    )


def closing(share: float, before: float = 11.0, elsewhere: float | None = None, high: float | None = None) -> Gap:
    few = () if elsewhere is None else ("e2",)
    after = 1 + (1 - share) * (before - 1)
    return Gap(before=before, after=after, closed=share, high=high, outlying=few, closed_elsewhere=elsewhere)


@pytest.mark.parametrize(
    ("attribution", "size", "word"),
    [
        (found(), Gap(before=1.0, after=1.0), "no_gap"),
        (found(remains=True), Gap(before=4.0, after=4.0), "unknown_effect"),
        (found(True), closing(1.0), "explained"),
        (found(True), closing(0.8), "explained"),
        (found(True, remains=True), closing(0.8), "explained"),
        (found(True), closing(0.79), "partly_explained"),
        # One name explains the larger part or nothing: the nearest alias of another cause takes a part, too.
        (found(True), closing(0.5), "partly_explained"),
        (found(True), closing(0.49), "unknown_effect"),
        (found(True, names=2), closing(0.3), "partly_explained"),
        (found(True, names=2), closing(0.29), "unknown_effect"),
        (found(True), closing(0.0), "unknown_effect"),
        (found(True), closing(-0.5), "unknown_effect"),
        (found(True), closing(0.5, before=1.62), "partly_explained"),
        # A set that leaves little passes where it is right more often than wrong: less than 0.10 floors, or a fifth.
        (found(True), closing(0.5, before=1.58), "unknown_effect"),
        (found(True), closing(0.63, before=1.77), "unknown_effect"),
        (found(True), closing(0.5, before=1.28), "unknown_effect"),
        (found(True), closing(0.5, before=1.18), "explained"),
        (found(True), closing(0.49, before=1.18), "unknown_effect"),
        # Four names fit what no name explains: they pass where they explain the gap, not for the little that is left.
        (found(True, names=3), closing(0.7, before=1.3), "explained"),
        (found(True, names=4), closing(0.7, before=1.3), "unknown_effect"),
        (found(True, names=4), closing(0.7, before=1.3, high=0.9), "unknown_effect"),
        (found(True, names=4), closing(0.8, before=1.3), "explained"),
        (found(True, names=4), closing(0.7, before=3.0), "partly_explained"),
        # Of a gap so small that all of it may be closed, the share says nothing.
        (found(True), closing(0.48, before=1.067, high=1.0), "explained"),
        (found(True), closing(0.48, before=1.067, high=0.79), "unknown_effect"),
        (found(True), closing(-0.1, before=1.067, high=1.0), "unknown_effect"),
        (found(True), closing(0.48, before=1.8, high=1.0), "unknown_effect"),
        (found(True), closing(0.73, before=1.33), "explained"),
        (found(True), closing(0.8, before=1.28), "explained"),
        (found(True), closing(0.8, before=2.4), "explained"),
        (found(True, tied=2), closing(1.0), "ambiguous"),
        (found(True, tied=2), closing(0.5), "ambiguous"),
        (found(True, tied=2), closing(0.1), "unknown_effect"),
        # Few episodes that hold most of what remains do not outvote all others.
        (found(True), closing(0.14, elsewhere=0.5), "partly_explained"),
        (found(True), closing(0.14, elsewhere=0.49), "unknown_effect"),
        (found(True), closing(-0.14, elsewhere=0.9), "unknown_effect"),
        (found(True, tied=2), closing(0.14, elsewhere=0.9), "ambiguous"),
        # Nor do they where little remains and the gap of all others closes.
        (found(True, names=2), closing(0.7, before=1.9), "unknown_effect"),
        (found(True, names=2), closing(0.7, before=1.9, elsewhere=0.89), "unknown_effect"),
        (found(True, names=2), closing(0.7, before=1.9, elsewhere=0.9), "partly_explained"),
        (found(True, names=4), closing(0.7, before=1.9, elsewhere=0.9), "unknown_effect"),
        (found(True, tied=2), closing(0.7, before=1.9, elsewhere=0.9), "ambiguous"),
        (found(True, names=2), closing(0.85, before=2.9, elsewhere=0.9), "explained"),
    ],
)
def test_the_table_of_verdicts(attribution, size, word):
    assert verdict(attribution, size) == word


def test_what_was_measured_is_no_name_too_many():
    four, small = found(True, names=4), closing(0.7, before=1.3)
    assert verdict(four, small, four.chosen.members[:1]) == "explained"


@pytest.mark.parametrize("word", ["no_gap", "explained", "ambiguous", "too_little_data"])
def test_nothing_is_unknown_where_all_is_said(word):
    assert unnamed_cause(word, found(True), SYMPTOMS, "object", 0.2, "rad") is None


def test_what_remains_says_where_how_much_and_when():
    some = unnamed_cause("partly_explained", found(True), SYMPTOMS, "object", 0.2, "rad")
    assert (some.acts_on, some.element, some.size, some.unit) == ("object", "rotation z", 0.2, "rad")
    assert some.depends_on == ("release", "onset")
    assert some.words == "A difference remains in object pose rotation z during release, typically 0.2 rad"


def test_an_unknown_effect_names_the_nearest_and_says_it_is_not_it():
    words = unnamed_cause("unknown_effect", found(remains=True), SYMPTOMS, "object", 0.2, "rad").words
    assert words.endswith("; the nearest effect of the library is object_mass, which does not explain it")


def test_a_difference_that_stands_out_nowhere_is_said_to():
    some = unnamed_cause("partly_explained", found(True), (), None, None, None)
    assert some.words == "A difference remains that no single channel or phase stands out in"
    assert (some.acts_on, some.element, some.depends_on) == (None, None, ())


def test_a_class_is_sorted():
    assert class_of([fit("joint_dry_friction"), fit("joint_damping")]) == ("joint_damping", "joint_dry_friction")
