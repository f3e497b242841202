"""The record that a diagnosis prints and writes: all keys always present."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import AliasChoices, ConfigDict, Field, model_validator

from candata.schema.effect import EffectSetting, Value
from candata.schema.html_text import summary_table
from candata.schema.record import ResultRecord

Verdict = Literal[
    "no_gap", "explained", "partly_explained", "ambiguous", "unknown_effect", "too_little_data", "out_of_budget"
]
IntervalEnd = float | tuple[float, ...] | None
KnownEnds = Literal["low", "high", "both"]
#: Which ends are known, by whether the lower and the higher one are given.
_ENDS_KNOWN: dict[tuple[bool, bool], KnownEnds | None] = {
    (True, True): "both",
    (True, False): "low",
    (False, True): "high",
    (False, False): None,
}


class Estimate(ResultRecord):
    """A parameter with its 90 % interval; lists for vectors, a word for a discrete choice.

    `bounded` says which ends of the interval are known: where only the low one is, the parameter is at least that, and
    `high` is null. It is null without an interval, and follows from the ends where it is left out. `unit` is that of
    joints that slide (m, N), where its name says that of joints that turn.
    """

    value: Value
    low: IntervalEnd = None
    high: IntervalEnd = None
    bounded: KnownEnds | None = None
    unit: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_bounded(cls, data: Any) -> Any:
        """Fill in which ends are known."""
        if not isinstance(data, dict) or data.get("bounded") is not None:
            return data
        return {**data, "bounded": _ENDS_KNOWN[data.get("low") is not None, data.get("high") is not None]}

    @model_validator(mode="after")
    def _ends_agree(self) -> Self:
        """Refuse a word that contradicts the ends."""
        known_ends = _ENDS_KNOWN[self.low is not None, self.high is not None]
        if self.bounded != known_ends:
            raise ValueError(f"bounded is {self.bounded!r}, but low and high say {known_ends!r}")
        return self


class NamedEffect(ResultRecord):
    """An effect the verdict names.

    `rivals` are effects, with their elements, that the held-out episodes cannot tell from it beside the other ones.
    """

    name: str
    element: str | None = None
    share: float
    support: float
    at_bound: bool = False
    parameters: dict[str, Estimate]
    rivals: tuple[str, ...] = ()


class UnknownCause(ResultRecord):
    """What no effect of the library explains.

    `closable` is the share of the gap that a force fitted to it closes on held-out episodes: a bar for any cause.
    """

    acts_on: Literal["joint", "fingertip", "object", "wrist"] | None = None
    element: str | None = None
    size: float | None = None
    unit: str | None = None
    depends_on: tuple[str, ...] = ()
    words: str
    closable: float | None = None


class RankedEffect(ResultRecord):
    """A candidate with its held-out evidence."""

    name: str
    element: str | None = None
    support: float
    held_out_gain: float
    gain_low: float | None = None
    gain_high: float | None = None
    parameters: dict[str, Value] = {}
    reason: str | None = None


class Gap(ResultRecord):
    """How far: mean size of held-out residuals over that of the nulls; closed is null for no_gap.

    `outlying` are the fewest episodes that hold more than half of what remains, where they are an eighth at most;
    `closed_elsewhere` is the share that closes on the others. None and null where they are more.
    """

    before: float
    after: float
    floor: float = 1.0
    closed: float | None = None
    low: float | None = None
    high: float | None = None
    outlying: tuple[str, ...] = ()
    closed_elsewhere: float | None = None


class Calibration(ResultRecord):
    """A joint fit of every quantity that gains on held-out episodes: a better simulator that claims no names.

    `effects` are those of `calibration.yaml`, and `gap` is what they close on held-out episodes. Of their `numbers`,
    the recordings tell so many `combinations` to less than a plausible size; the others may make up for one another.
    """

    effects: tuple[EffectSetting, ...]
    gap: Gap
    numbers: int
    combinations: int


class EditTest(ResultRecord):
    """Whether the shrinkage is kept with another object or task in both worlds, nothing refitted.

    `kept` asks that the interval of `closed` lies above zero and that `closed` is at least 0.8 of `reference`, the
    share that closed in the diagnosis; null where there was no gap to close.
    """

    dataset: str
    scene: str
    episodes: int
    before: float
    after: float
    closed: float | None = None
    low: float | None = None
    high: float | None = None
    kept: bool | None = None
    reference: float = 1.0


class SharedGap(ResultRecord):
    """Closed-loop ADD-S AUC, and the share that it closes of the gap from the nominal simulator's to 1.

    `low` and `high` are a 95 % interval over resampled episodes, null under 30 of them; `share` is null where the
    nominal simulator leaves next to nothing.
    """

    adds_auc: float
    share: float | None = None
    low: float | None = None
    high: float | None = None


class LearnedModel(ResultRecord):
    """A trained model beside the repair, by the object's motion in closed loop over episodes it was not trained on.

    `repair` is null where nothing was named. The repair was fitted on these episodes, the model was not.
    """

    run: str
    model: str
    episodes: int
    nominal_auc: float
    closed: SharedGap
    repair: SharedGap | None = None


class Symptom(ResultRecord):
    """Where: a channel, element and phase in which the recording leaves the nulls.

    `regime` is where the excess of this element lies, over all phases: "moving", "moving +", "moving -", "reversal",
    "still", "loaded" or "free" of contact, or "pulling" or "idle" of a motor whose joint is not known to carry a
    contact; null where it lies in all of them alike.
    """

    channel: str
    element: str | None = None
    phase: str | None = None
    regime: str | None = None
    ratio: float
    p: float


class NextMotion(ResultRecord):
    """The motion that best separates what is tied.

    `expected_separation` is by how many floors the loss of a wrong candidate lies above that of the true one; `reason`
    says in words why this motion, or what else to record.
    """

    name: str
    file: str | None = None
    separates: tuple[str, ...] = ()
    expected_separation: float | None = None
    reason: str | None = None


class EpisodeCount(ResultRecord):
    """Episodes used and how they were held out."""

    total: int
    folds: int
    held_out: int


class DiagnosisData(ResultRecord):
    """What the diagnosis saw; `against` is the reference whose own misfit was taken off, null without one."""

    dataset: str
    against: str | None = None
    episodes: EpisodeCount
    floor: Literal["measured", "declared", "assumed"] | None = None
    channels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Report(ResultRecord):
    """The diagnosis: verdict, effects, what is unknown, ranking, gap, symptoms.

    `measures` holds null where nothing could be measured.
    `given_effects` belong to the nominal simulator: gap and effects are what comes on top of them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, serialize_by_alias=True)

    verdict: Verdict
    effects: tuple[NamedEffect, ...] = ()
    ambiguous_class: tuple[str, ...] = Field(
        default=(), validation_alias=AliasChoices("class", "ambiguous_class"), serialization_alias="class"
    )
    unknown: UnknownCause | None = None
    ranking: tuple[RankedEffect, ...] = ()
    gap: Gap | None = None
    where: tuple[Symptom, ...] = ()
    next_motion: NextMotion | None = None
    edit: EditTest | None = None
    learned: LearnedModel | None = None
    calibration: Calibration | None = None
    given_effects: tuple[EffectSetting, ...] = ()
    data: DiagnosisData
    measures: Mapping[str, Mapping[str, float | None]] = {}
    provenance: dict[str, str] = {}

    def __repr__(self) -> str:
        """Return verdict, named effects and gap in one line."""
        names = ", ".join(
            effect.name if effect.element is None else f"{effect.name} on {effect.element}" for effect in self.effects
        )
        parts = [self.verdict, names, self._gap_text(), self.data.dataset]
        return f"Report({', '.join(filter(None, parts))})"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Return verdict, gap and the named effects as a table: what a notebook shows."""
        columns = ("effect", "on", "parameter", "value", "90 % interval", "share of the gap")
        rows = [
            (
                effect.name,
                effect.element or "all",
                name,
                _number(estimate.value),
                _interval(estimate),
                f"{effect.share:.0%}",
            )
            for effect in self.effects
            for name, estimate in effect.parameters.items()
        ]
        facts = ", ".join(
            filter(None, [self._gap_text(), f"{self.data.episodes.total} episodes of {self.data.dataset}"])
        )
        return summary_table(f"Diagnosis: {self.verdict}", facts, columns, rows)

    def _gap_text(self) -> str:
        """Return how far the gap shrinks, in noise floors; empty where it was not measured."""
        return "" if self.gap is None else f"gap {self.gap.before:.2f} to {self.gap.after:.2f} noise floors"


def _number(value: IntervalEnd | Value) -> str:
    """Return a value to three digits, the numbers of a vector in brackets."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_number, value))}]"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _interval(estimate: Estimate) -> str:
    """Return the ends of an interval that are known; empty without any."""
    if estimate.bounded == "both":
        return f"{_number(estimate.low)} to {_number(estimate.high)}"
    if estimate.bounded == "low":
        return f"at least {_number(estimate.low)}"
    return f"at most {_number(estimate.high)}" if estimate.bounded == "high" else ""
