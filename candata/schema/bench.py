"""Records of the blind check: a case, its sealed label, its result, and the table that comes of them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from candata.schema.effect import EffectSetting
from candata.schema.record import ResultRecord
from candata.schema.report import Gap, Report

Kind = Literal["one", "quarter", "null", "pair", "triple", "outside", "background", "solver", "local", "change"]
#: What a diagnosis is told of the sensors' noise: the truth, another size, or nothing.
NoiseCase = Literal["declared", "misdeclared", "undeclared"]


class CaseFile(ResultRecord):
    """`case.json`, beside the dataset of a case: what may be known before the labels are opened.

    `scene` is a built-in scene or a `scene.yaml`, a relative path counting from the case's folder; `sealed` is
    sha256(label + salt). Without `noise_declared` the diagnosis is told nothing of what the scene says of its noise.
    """

    name: str
    scene: str
    scene_digest: str | None = None
    episodes: int
    sealed: str
    noise_declared: bool = Field(default=True, exclude_if=lambda is_declared: is_declared)


class OutsideCause(ResultRecord):
    """A cause that is in no library: what it is, where it acts, and its numbers."""

    name: str
    acts_on: Literal["joint", "fingertip", "object", "wrist"]
    element: str | None = None
    values: dict[str, float] = {}


class Label(ResultRecord):
    """The truth of a case: `effects` of the library in its world, `main` the one that stands above a background.

    `seed` feeds the noise of the case and keeps its hash from being guessed. `trait` says what marks a random small
    scene; null in the scenes of the library. The sensors' true noise is `noise_factor` times what the scene declares;
    `noise` says whether that is what the diagnosis is told.
    """

    case: str
    kind: Kind
    effects: tuple[EffectSetting, ...] = ()
    main: str | None = None
    outside: OutsideCause | None = None
    trait: str | None = None
    seed: int = 0
    noise: NoiseCase = Field(default="declared", exclude_if=lambda kind: kind == "declared")
    noise_factor: float = Field(default=1.0, exclude_if=lambda factor: factor == 1.0)


class LabelsFile(ResultRecord):
    """`sealed.json`: the secret salt and each case's label as canonical JSON text; `asked` is what was drawn from."""

    salt: str
    asked: dict[str, str | int | float] = {}
    labels: dict[str, str]


class CaseResult(ResultRecord):
    """One line of `results.jsonl`: what a diagnosis said of a case, or why it could not; `sealed` is the case's own.

    `cold` marks a case that was diagnosed with nothing kept from others; `process` is the number of the process.
    `replays` is what the diagnosis simulated, in replays of all episodes of the case: a cost that no machine changes.
    With a cache it counts what was not kept yet, so that it depends on which cases came before; null where unknown.
    """

    case: str
    sealed: str
    method: str = "candata"
    cpu_s: float
    cold: bool
    process: int = 0
    replays: float | None = None
    report: Report | None = None
    error: str | None = None


class FilledSignature(ResultRecord):
    """One line of `filled.jsonl`: a signature was simulated into the cache that all cases share."""

    cpu_s: float


class CaseResults(ResultRecord):
    """One line of `baselines.jsonl`: what each baseline said of a case."""

    sealed: str
    results: tuple[CaseResult, ...]


class Shares(ResultRecord):
    """One line of `shares.jsonl`: by how much the loss rises, in floors, when a true contributor is left out.

    `alike` is the largest cosine between the residuals that two contributors make.
    """

    case: str
    sealed: str
    rises: dict[str, float]
    alike: float | None = None


class FreshGap(ResultRecord):
    """One line of `fresh.jsonl`: how far the named effects close the gap on fresh episodes of the hidden world.

    `gap` is as in the report, in floors of the repaired world; null, with the reason, where it could not be measured.
    """

    case: str
    sealed: str
    episodes: int
    gap: Gap | None = None
    error: str | None = None


class BenchRow(ResultRecord):
    """A measure of the table: `low` and `high` bound the target; both null where there is none.

    `interval` is a 90 % interval of the value by resampling cases; null where none was computed.
    """

    measure: str
    value: float | None
    n: int
    low: float | None = None
    high: float | None = None
    unit: Literal["%", "", "s"] = "%"
    interval: tuple[float, float] | None = None

    @property
    def is_met(self) -> bool | None:
        """Whether the value lies within the target; None without a value or a target."""
        if self.value is None or (self.low is None and self.high is None):
            return None
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)


class Miss(ResultRecord):
    """A case that went wrong: the truth, the verdict, what was named, and what made it count as a miss."""

    case: str
    kind: Kind
    truth: str
    verdict: str
    named: str
    why: str
    gap: float | None = None


class CaseScore(ResultRecord):
    """The score of one case, for comparing runs case by case: `right` is whether it is no miss.

    `log_score` [nats] and `brier_score` sum over all effects of the library: the belief that a report states (of a
    named effect its support, of each of n in an ambiguous class 1/n, of any other 0) against what is there. 0 is best;
    null for a background, in which a little of everything is there. `overclaimed` is the share of the gap that is
    closed as the report says, less that on fresh episodes of the hidden world; null where nothing is named.
    """

    case: str
    sealed: str
    kind: Kind
    noise: NoiseCase = "declared"
    right: bool
    log_score: float | None = None
    brier_score: float | None = None
    overclaimed: float | None = None


class ChangedCase(ResultRecord):
    """A case that two versions take differently: its name, and what each said, `right` after what is right."""

    case: str
    kind: Kind
    first: str
    second: str
    first_right: bool
    second_right: bool


class PairedKind(ResultRecord):
    """Two runs on the cases of one kind: in how many both are right, one alone or neither, and McNemar's exact p.

    `kind` is a kind of case, or `noise` and a kind of noise: these count the same cases a second time.
    """

    kind: str
    cases: int
    both_right: int
    first_only: int
    second_only: int
    neither: int
    p: float


class PairedMeasure(ResultRecord):
    """A measure of two runs on the cases in which both have it, its mean or median.

    `change` is the median over cases of the second run's value over the first's where it `is_ratio`, else the mean over
    cases of the second's less the first's; `low` and `high` are a 90 % interval of it by resampling cases.
    """

    measure: str
    cases: int
    statistic: Literal["mean", "median"]
    first: float
    second: float
    change: float
    is_ratio: bool
    low: float
    high: float


class PairedComparison(PairedKind):
    """Two runs on the same cases, paired: one sentence, counts in all and by kind, cost and honesty, changed cases.

    The counts are those of all kinds together; CPU s are medians.
    """

    summary: str
    first_cpu_s: float
    second_cpu_s: float
    kinds: tuple[PairedKind, ...] = ()
    measures: tuple[PairedMeasure, ...] = ()
    changed: tuple[ChangedCase, ...] = ()


class Bin(ResultRecord):
    """One bin of the calibration curve: mean stated support, share that was right, and how many."""

    support: float
    right: float
    n: int


class BenchFile(ResultRecord):
    """`bench.json`: the table, the misses, the confusion matrix and the calibration curve of one method.

    Of the rows, these need a word. "Parameter error" is over the size of the true value; "error over the deviation" is
    |found - true| / |true - model's own|, which no value near the model's own can flatter. "Coverage" counts right
    names, "wrong names too" also effects that are not there, whose true value is the model's own. "Calibration error"
    is small for whoever is mostly right; Brier and log score are not: they are means of the cases' scores (see
    `CaseScore`) with "silence counted", and of named effects alone. "Closed as claimed minus on fresh episodes" holds
    what reports say against episodes of the hidden worlds that no search has seen. `scores` are those of each case.

    `confusion` maps a true cause to what was said first and how often; `baselines` are other methods, and this one,
    on the cases that the others were given.
    """

    method: str = "candata"
    scene: str
    cases: int
    done: int
    rows: tuple[BenchRow, ...]
    misses: tuple[Miss, ...]
    confusion: dict[str, dict[str, int]]
    calibration: tuple[Bin, ...]
    scores: tuple[CaseScore, ...] = ()
    baselines: tuple[BenchFile, ...] = ()
