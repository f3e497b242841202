"""The page of a policy evaluation: ranking, tables and the worst disagreement; and the summary for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from candata.datasets.writing import write_text
from candata.policies import write_motions
from candata.policy_evaluation.evaluation import Exhibit
from candata.policy_evaluation.results import Interval, PolicyEvaluation, PolicyScore, WorldRanking
from candata.reports import filmstrip
from candata.reports.chart import Axis, chart, dots, join_markup, line, mark
from candata.reports.document import render, render_page
from candata.reports.numbers import percent
from candata.reports.png import data_uri
from candata.reports.render import render_frames

#: Name of the command file that the evaluation proposes to record, beside the page.
NEXT_MOTION = "next_motion.parquet"
#: Pictures a row of the filmstrip.
COLUMNS = 5
#: Way between marks of equal seen success, which stand side by side, and most of it for all of them, as shares of the
#: axis. Chosen: a dot's width, and less than lies between two ticks.
SIDE_STEP, MOST_SIDE = 0.015, 0.16
#: Colours for worlds that the style sheet has.
COLOURS = 8
RANKING_HEAD = ("world", "rank correlation", "MMRV", "mean error", "bias", "within interval", "starts alike")


def write_policy_evaluation(evaluation: PolicyEvaluation, exhibit: Exhibit | None, out: Path) -> Path:
    """Return the path of `policies.html` after writing it, `policies.json` and the next motion into `out`.

    The page comes last. A next motion of an earlier evaluation goes.

    Raises
    ------
    SetupError
        When the folder cannot be written.
    """
    text = page(evaluation, exhibit)
    if exhibit is None:
        (out / NEXT_MOTION).unlink(missing_ok=True)
    else:
        write_motions(out / NEXT_MOTION, exhibit.scene, [exhibit.motion])
    write_text(out / "policies.json", evaluation.model_dump_json(indent=2) + "\n")
    write_text(out / "policies.html", text)
    return out / "policies.html"


def page(evaluation: PolicyEvaluation, exhibit: Exhibit | None) -> str:
    """Return the whole page as text."""
    worlds = [score.world for score in evaluation.scores]
    columns = list(dict.fromkeys(worlds))
    return render_page(
        "policies",
        title=f"{evaluation.headline}: {evaluation.dataset}",
        tone="good" if evaluation.best else "none",
        headline=evaluation.headline,
        kicker=f"{len(evaluation.policies)} policies from {len(evaluation.starts)} starts of {evaluation.dataset}",
        meaning=_disagreement_sentence(evaluation),
        ranking=ranking_figure(evaluation),
        key=[(f"key-{css_class}", name) for name, css_class in _classes(evaluation).items()],
        seen=evaluation.seen,
        success_head=["policy", "source", *columns],
        success_rows=[_success_row(evaluation, name, columns) for name in evaluation.policies],
        ranking_head=RANKING_HEAD,
        ranking_rows=[_ranking_row(ranking) for ranking in evaluation.rankings],
        ends=[_ends_row(score) for score in evaluation.scores],
        effect_rows=_effect_rows(evaluation),
        effect_words=_effect_words(evaluation),
        film=film(exhibit) if exhibit is not None else "",
        film_title=exhibit.title if exhibit is not None else "",
        next_motion=NEXT_MOTION,
        worlds=list(evaluation.worlds.items()),
        notes=evaluation.notes,
        method=_method(evaluation),
    )


def summary(evaluation: PolicyEvaluation) -> str:
    """Return what the command line prints: the first line, success, rankings, effects, and the next motion."""
    columns = list(dict.fromkeys(score.world for score in evaluation.scores))
    rows = [("", *columns)]
    for name in evaluation.policies:
        rows.append((name, *_success_row(evaluation, name, columns)[2:]))
    lines = [evaluation.headline, "", *_columns(rows)]
    if evaluation.rankings:
        lines += ["", *_columns([RANKING_HEAD, *(_ranking_row(ranking) for ranking in evaluation.rankings)])]
    if evaluation.effects:
        lines += ["", _effect_words(evaluation), *_columns(_effect_rows(evaluation))]
    lines += ["", *filter(None, [_disagreement_sentence(evaluation)]), *evaluation.notes]
    return "\n".join(lines).rstrip()


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of text in columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _classes(evaluation: PolicyEvaluation) -> dict[str, str]:
    """Return the style class of each world that predicts."""
    return {ranking.world: f"forecaster{k % COLOURS}" for k, ranking in enumerate(evaluation.rankings)}


def ranking_figure(evaluation: PolicyEvaluation) -> Markup:
    """Return predicted over seen success, a dot for each policy and world with its interval; empty without any pair.

    Those of one seen success stand side by side, policy by policy.
    """
    seen = {score.policy: score for score in evaluation.scores if score.world == evaluation.seen and score.total}
    if not seen or not evaluation.rankings:
        return Markup("")
    ticks = tuple((k / 5, f"{20 * k} %") for k in range(6))
    places = _side_by_side(evaluation, {policy: score.success.value for policy, score in seen.items()})
    margin = max(0.03, SIDE_STEP + max(max(-place, place - 1) for place in places.values()))
    x, y = Axis(-margin, 1 + margin, ticks), Axis(-0.03, 1.03, ticks)
    marks = [line(x, y, [0.0, 1.0], [0.0, 1.0], "ideal")]
    for world, css_class in _classes(evaluation).items():
        scores = [s for s in evaluation.scores if s.world == world and s.policy in seen and s.total]
        truth = [seen[score.policy].success.value for score in scores]
        at_places = [places[score.policy, world] for score in scores]
        marks += [_upright(x, y, at, score.success, css_class) for at, score in zip(at_places, scores, strict=True)]
        texts = [
            f"{score.policy}: {percent(score.success.value)} in {world}, {percent(at)} seen"
            for at, score in zip(truth, scores, strict=True)
        ]
        marks.append(dots(x, y, at_places, [score.success.value for score in scores], css_class, texts.__getitem__))
    return chart(
        x, y, join_markup(marks), "predicted over seen success of every policy", 340, "seen success", "predicted"
    )


def _side_by_side(evaluation: PolicyEvaluation, truth: dict[str, float]) -> dict[tuple[str, str], float]:
    """Return where the mark of each policy and world stands along the axis of seen success."""
    places: dict[tuple[str, str], float] = {}
    for value in set(truth.values()):
        marks = [(policy, world) for policy in truth if truth[policy] == value for world in _classes(evaluation)]
        step = min(SIDE_STEP, MOST_SIDE / len(marks))
        places |= {key: value + step * (k - (len(marks) - 1) / 2) for k, key in enumerate(marks)}
    return places


def _upright(x: Axis, y: Axis, at: float, success: Interval, css_class: str) -> Markup:
    """Return the interval of a predicted success as an upright stroke."""
    steps = f"M{x.x_place(at)} {y.y_place(success.low)}V{y.y_place(success.high)}"
    return mark(f"line {css_class}", steps)


def film(exhibit: Exhibit) -> Markup:
    """Return the worst disagreement as pictures at the same moments, a row for each world."""
    count = min(len(states) for states in exhibit.qpos.values())
    steps = np.unique(np.linspace(0, count - 1, COLUMNS).round().astype(int))
    states = np.concatenate([values[steps] for values in exhibit.qpos.values()])
    if not np.isfinite(states).all():
        return Markup("")
    pictures = render_frames(exhibit.scene.model, states, None, filmstrip.WIDTH, filmstrip.HEIGHT)
    frames = [data_uri(frame) for frame in pictures.frames]
    return render(
        "filmstrip",
        times=[f"{k / exhibit.rate_hz:.2f} s" for k in steps],
        rows=[("recorded", name, frames[r * len(steps) : (r + 1) * len(steps)]) for r, name in enumerate(exhibit.qpos)],
        width=filmstrip.WIDTH,
        height=filmstrip.HEIGHT,
        note=pictures.note,
    )


def _success_row(evaluation: PolicyEvaluation, policy: str, columns: Sequence[str]) -> list[str]:
    """Return the success of a policy in every world, with its source."""
    facts = evaluation.policies[policy]
    by_world = {score.world: score for score in evaluation.scores if score.policy == policy}
    return [policy, f"{facts.source} ({facts.kind})", *(_success_text(by_world.get(world)) for world in columns)]


def _success_text(score: PolicyScore | None) -> str:
    """Return a success with its interval; a dash where nothing was played."""
    if score is None or not score.total:
        return "\N{EN DASH}"
    ends = f"{100 * score.success.low:.0f} to {100 * score.success.high:.0f}"
    return f"{percent(score.success.value)} ({ends})"


def _ranking_row(ranking: WorldRanking) -> tuple[str, ...]:
    """Return how well a world predicts."""
    return (
        ranking.world,
        _number_text(ranking.spearman),
        f"{ranking.mmrv:.3f}",
        percent(ranking.mean_error),
        f"{100 * ranking.bias:+.0f} points",
        percent(ranking.covered),
        percent(ranking.agreement),
    )


def _number_text(value: Interval) -> str:
    """Return a rank correlation with its interval; `none` where it has no value."""
    if not math.isfinite(value.value):
        return "none"
    return f"{value.value:.2f} ({value.low:.2f} to {value.high:.2f})"


def _ends_row(score: PolicyScore) -> tuple[str, ...]:
    """Return how the episodes of a policy ended in one world."""
    counts = score.outcomes | ({"unstable": score.unstable} if score.unstable else {})
    words = ", ".join(f"{name} {count}" for name, count in counts.items())
    spread = "" if score.spread_m is None else f"{1000 * score.spread_m:.1f} mm"
    return score.policy, score.world, words, spread


def _effect_rows(evaluation: PolicyEvaluation) -> list[tuple[str, str, str]]:
    """Return what each effect explains, most first."""
    rows = sorted(evaluation.effects, key=lambda entry: -entry.explained)
    return [
        (
            entry.effect,
            f"explains {entry.explained} of {entry.wrong}" + (f" ({percent(entry.share)})" if entry.wrong else ""),
            f"breaks {entry.broken}",
        )
        for entry in rows
    ]


def _effect_words(evaluation: PolicyEvaluation) -> str:
    """Return what the counts of effects are of; empty without effects."""
    if not evaluation.effects:
        return ""
    against = "what was seen" if evaluation.compared_with == "seen" else "the repaired simulator, as nothing was seen"
    return f"Effects, by the wrong predictions of the nominal simulator (against {against}) that each explains."


def _disagreement_sentence(evaluation: PolicyEvaluation) -> str:
    """Return what to record next; empty where worlds cannot disagree."""
    choice = evaluation.next_motion
    if choice is None:
        return ""
    ends = ", ".join(f"{word} in {world}" for world, word in choice.outcomes.items())
    return (
        f"Record next: {choice.policy} from {choice.start} ({ends}; {1000 * choice.distance_m:.0f} mm between "
        f"{choice.between[0]} and {choice.between[1]}), the commands in {NEXT_MOTION} as played in {choice.commands}."
    )


def _method(evaluation: PolicyEvaluation) -> list[tuple[str, str]]:
    """Return what a reader must know to judge the numbers."""
    return [
        (
            "starts",
            f"{evaluation.group} of the split {evaluation.split}, states estimated from the recorded first rows",
        ),
        ("episodes", f"{evaluation.duration_s:g} s in scene {evaluation.scene}, seed {evaluation.seed}"),
        ("goal", evaluation.goal or "what each policy means"),
        ("success", "told from the motion of the object, alike in all worlds; 95 % Wilson interval"),
        ("rank correlation", "Spearman's, over policies; 95 % interval over resampled starts, the same for all worlds"),
        ("MMRV", "mean maximum rank violation (Li et al., SIMPLER, CoRL 2024): 0 is best"),
        ("mean error, bias", "predicted less seen success: mean of its size, and signed (above 0: too hopeful)"),
        ("calibration", "policies whose seen success lies in the predicted interval; single starts that end alike"),
        ("candata", evaluation.revision),
    ]
