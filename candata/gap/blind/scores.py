"""The score of a run: every measure beside its target, the confusion matrix, the calibration curve."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.honesty import brier_score, honest_rows, is_scored, log_score
from candata.gap.blind.misses import miss, why_missed
from candata.gap.blind.outcomes import Outcome, covered, parameter_error, supports
from candata.gap.blind.rows import percent, quantile, trait_rows
from candata.schema.bench import BenchFile, BenchRow, Bin, CaseScore, FilledSignature, Kind

Array = NDArray[np.float64]
#: Equal-count bins of the calibration curve.
BINS = 5
#: Kinds whose hidden effects are all in the library.
KNOWN: tuple[Kind, ...] = ("one", "quarter", "local", "pair", "triple")


def score_run(
    outcomes: Sequence[Outcome],
    *,
    scene: str,
    cases: int,
    method: str = "candata",
    filled: Sequence[FilledSignature] = (),
    followed: Sequence[Outcome] = (),
) -> BenchFile:
    """Return the table of a run with its misses.

    Parameters
    ----------
    outcomes : sequence of Outcome
        The cases that were diagnosed, opened.
    scene : str
        Name of the nominal scene.
    cases : int
        How many cases there are, diagnosed or not.
    method : str
        Whose diagnoses they are.
    filled : sequence of Filled
        What was simulated into their shared cache before they were diagnosed.
    followed : sequence of Outcome
        The ambiguous ones among them, diagnosed again with the motion that was proposed.
    """
    rows = [row for row in (*_rows(outcomes), _resolved(followed), _filling(filled)) if row.n]
    order = {False: 0, True: 2, None: 3}
    return BenchFile(
        method=method,
        scene=scene,
        cases=cases,
        done=len(outcomes),
        rows=tuple(sorted(rows, key=lambda r: order[r.is_met])),
        misses=tuple(m for o in outcomes if (m := miss(o))),
        confusion=confusion(outcomes),
        calibration=calibration(outcomes),
        scores=tuple(_scored(o) for o in outcomes),
    )


def _scored(o: Outcome) -> CaseScore:
    """Return the score of one case."""
    return CaseScore(
        case=o.label.case,
        sealed=o.result.sealed,
        kind=o.kind,
        noise=o.label.noise,
        right=why_missed(o) is None,
        log_score=log_score(o) if is_scored(o) else None,
        brier_score=brier_score(o) if is_scored(o) else None,
        overclaimed=o.overclaimed,
    )


def _noise_rows(outcomes: Sequence[Outcome]) -> list[BenchRow]:
    """Return how many cases of each kind of noise that is not as declared are right, and how many nulls are named."""
    rows = []
    for noise in ("misdeclared", "undeclared"):
        cases = [o for o in outcomes if o.label.noise == noise]
        nulls = [o for o in cases if o.kind == "null"]
        rows += [
            percent(f"noise {noise}: right", (why_missed(o) is None for o in cases)),
            percent(f"noise {noise}, null: an effect named", (bool(o.named) for o in nulls), high=3),
        ]
    return rows


def _rows(outcomes: Sequence[Outcome]) -> list[BenchRow]:
    """Return every measure in the order of the targets."""
    kinds: dict[str, list[Outcome]] = {}
    for o in outcomes:
        kinds.setdefault(o.kind, []).append(o)

    def of(*names: Kind) -> list[Outcome]:
        return [o for name in names for o in kinds.get(name, [])]

    return [
        *_single(of("one"), of("quarter")),
        *_sets(of("pair"), of("triple")),
        *_abstention([o for o in of("null") if o.label.trait is None], of("outside"), of(*KNOWN)),
        *trait_rows(outcomes),
        *_mismatch(of("background"), of("solver")),
        *_local(of("local")),
        *_honesty(outcomes, of("one", "quarter", "local")),
        *honest_rows(outcomes, of("one"), of("quarter")),
        *_noise_rows(outcomes),
        *_cost(outcomes),
    ]


def _single(one: list[Outcome], quarter: list[Outcome]) -> list[BenchRow]:
    """Return the measures of single causes."""
    right = [o for o in one if o.first]
    errors = [e for o in right if (e := parameter_error(o)) is not None]
    weak = [e for o in quarter if o.first and (e := parameter_error(o)) is not None]
    closed = [o.closed for o in right if o.closed is not None]
    return [
        percent("one effect: first", (o.first for o in one), low=95),
        percent("one effect: first, where it is worth 0.1 floors", (o.first for o in one if o.plain)),
        percent("one effect: in three", (o.truth[0] in o.said[:3] for o in one), low=98),
        percent("one effect: and nothing else", (o.named == o.truth for o in one)),
        percent("a quarter of the magnitude: first", (o.first for o in quarter), low=88),
        percent("a quarter: first, where it is worth 0.1 floors", (o.first for o in quarter if o.plain)),
        quantile("parameter error: median", errors, 0.5, high=2),
        quantile("parameter error: 90th percentile", errors, 0.9, high=12),
        quantile("parameter error of a quarter: median", weak, 0.5),
        quantile("gap closed when right: median", closed, 0.5, low=98),
        quantile("gap closed when right: 10th percentile", closed, 0.1, low=90),
    ]


def _sets(pairs: list[Outcome], triples: list[Outcome]) -> list[BenchRow]:
    """Return the measures of two and three causes."""
    out = []
    for word, some, low in (("two effects", pairs, 85), ("three effects", triples, 70)):
        out += [
            percent(f"{word}: all right", (set(o.named) == set(o.truth) for o in some), low=low),
            percent(
                f"{word}: all right, where each is worth 0.1 floors",
                (set(o.named) == set(o.truth) for o in some if o.plain),
            ),
            percent(f"{word}: a wrong name", (bool(o.wrong_names) for o in some), high=8),
            percent(f"{word}: largest true contributor first", (o.first for o in some)),
        ]
    return out


def _abstention(null: list[Outcome], outside: list[Outcome], known: list[Outcome]) -> list[BenchRow]:
    """Return the measures of saying nothing, and of saying that the cause is not known."""
    places = [o.result.report.unknown if o.result.report else None for o in outside]
    where = [
        p is not None and o.label.outside is not None and p.acts_on == o.label.outside.acts_on
        for p, o in zip(places, outside, strict=True)
    ]
    return [
        percent("null: an effect named", (bool(o.named) for o in null), high=3),
        percent("outside the library: abstains", (o.abstains for o in outside), low=90),
        percent("outside the library: where it acts is right", where, low=80),
        percent("library effects: false abstention", (o.abstains for o in known), high=3),
    ]


def _mismatch(background: list[Outcome], solver: list[Outcome]) -> list[BenchRow]:
    """Return the measures under a mismatch of everything, and of the solver."""
    closed = [0.0 if o.closed is None else o.closed for o in background]
    heavy = [o for o in solver if "object_mass" in o.truth]
    return [
        percent("all 5 % wrong + one: largest true contributor first", (o.first for o in background), low=90),
        percent("all 5 % wrong + one: the drawn one first", (o.named[:1] == (o.label.main,) for o in background)),
        quantile("all 5 % wrong + one: gap closed, median", closed, 0.5, low=90),
        percent("solver mismatch: found or flagged", (o.flagged for o in solver), low=100),
        percent(
            "solver mismatch: 50 % mass error on top, first or second",
            ("object_mass" in o.named[:2] for o in heavy),
            low=100,
        ),
    ]


def _local(local: list[Outcome]) -> list[BenchRow]:
    """Return the measures of faults of one element."""
    return [
        percent("local fault: the right joint or finger first", (_element_first(o) for o in local), low=95),
        percent(
            "local fault: the right joint or finger first, where the fault is worth 0.1 floors",
            (_element_first(o) for o in local if o.plain),
        ),
        percent("local fault: effect and element first", (o.first for o in local)),
    ]


def _element_first(o: Outcome) -> bool:
    """Tell whether the effect named first acts on the element that is at fault, or all of a class of tied ones do."""
    if o.effects:
        return o.effects[0].element == o.label.effects[0].element
    tied = o.result.report.ambiguous_class if o.result.report else ()
    return bool(tied) and all(text.endswith(f" {o.label.effects[0].element}") for text in tied)


def _honesty(outcomes: Sequence[Outcome], known: list[Outcome]) -> list[BenchRow]:
    """Return coverage of the intervals and the calibration error of the support."""
    inside = [c for o in known for c in covered(o)]
    bins = calibration(outcomes)
    count = sum(b.n for b in bins)
    error = sum(b.n * abs(b.support - b.right) for b in bins) / count if count else None
    return [
        percent("coverage of 90 % intervals", inside, low=85, high=95),
        BenchRow(measure="calibration error of support", value=error, n=count, high=0.05, unit=""),
    ]


def _cost(outcomes: Sequence[Outcome]) -> list[BenchRow]:
    """Return CPU time with what is cached, and without: of the few cases that were diagnosed with nothing kept."""
    spent = {cold: [o.result.cpu_s for o in outcomes if o.result.cold == cold] for cold in (False, True)}
    names = {False: ("CPU s a case, cached signatures: median", 20.0), True: ("CPU s of a first case: median", 120.0)}
    return [
        BenchRow(measure=names[c][0], value=float(np.median(v)) if v else None, n=len(v), high=names[c][1], unit="s")
        for c, v in spent.items()
    ]


def _resolved(followed: Sequence[Outcome]) -> BenchRow:
    """Return how many ambiguous cases came right once what was proposed was recorded, too."""
    return percent("ambiguous: right once the next motion is recorded", (why_missed(o) is None for o in followed))


def _filling(filled: Sequence[FilledSignature]) -> BenchRow:
    """Return CPU time of what all cases share, counted by signatures."""
    spent = sum(one.cpu_s for one in filled)
    return BenchRow(measure="CPU s of the signatures kept before, once for all", value=spent, n=len(filled), unit="s")


def calibration(outcomes: Sequence[Outcome]) -> tuple[Bin, ...]:
    """Return stated support against the share that was right, in bins of equal count, over all named effects.

    A background is left out: a little of everything is there, so that no name is plainly wrong.
    """
    pairs = sorted((p for o in outcomes if o.kind != "background" for p in supports(o)), key=lambda p: p[0])
    parts = np.array_split(np.array(pairs, float).reshape(-1, 2), BINS)
    return tuple(Bin(support=float(p[:, 0].mean()), right=float(p[:, 1].mean()), n=len(p)) for p in parts if len(p))


def confusion(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Return, for cases of one cause or none, what was said first for each true cause and how often.

    What was said is the name of the first effect, or the verdict where nothing is named.
    """
    table: dict[str, Counter[str]] = {}
    for o in outcomes:
        if o.kind in ("one", "quarter", "local", "null", "outside"):
            true = o.label.outside.name if o.label.outside else (o.label.effects[0].name if o.label.effects else "none")
            said = o.effects[0].name if o.effects else o.verdict
            table.setdefault(true, Counter())[said] += 1
    return {true: dict(table[true].most_common()) for true in sorted(table)}
