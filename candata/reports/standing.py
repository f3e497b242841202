"""How forecasters stand against each other: who is best, by how much, and how sure that is."""

from __future__ import annotations

from candata.reports.numbers import digits
from candata.training.pairs import LEAST_TRAJECTORIES
from candata.training.results import REPAIRED, SIMULATOR, Evaluation, Pair

#: Forecasters that the best one is compared with in the headline, and what they are called there.
REFERENCES = {SIMULATOR: "the nominal simulator", "stays": "an object that stays"}


def has_intervals(evaluation: Evaluation) -> bool:
    """Tell whether there are enough episodes for intervals."""
    return evaluation.episodes >= LEAST_TRAJECTORIES


def best_of(evaluation: Evaluation, names: list[str] | None = None) -> str:
    """Return the forecaster with the largest closed-loop AUC, or the least final error without ADD-S.

    `names` are those that are looked at; by default all.
    """

    def rank(name: str) -> tuple[float, float]:
        loop = evaluation.forecasters[name].closed_loop
        return loop.adds_auc or 0.0, -loop.final_position_error_m

    return max(names or list(evaluation.forecasters), key=rank)


def best_model(evaluation: Evaluation) -> str:
    """Return the best of the models; of an evaluation without models, the best forecaster."""
    return best_of(evaluation, list(evaluation.models) or None)


def references(evaluation: Evaluation, name: str) -> list[Pair]:
    """Return what a forecaster gains over the nominal simulator and over an object that stays.

    Empty without ADD-S; one that took no part, or is the forecaster itself, is left out.
    """
    pairs = (evaluation.pair(name, reference) for reference in REFERENCES)
    return [pair for pair in pairs if pair is not None]


def is_sure(evaluation: Evaluation, pair: Pair) -> bool:
    """Tell whether the interval of a difference lies on one side of zero, and there are enough episodes for it."""
    return has_intervals(evaluation) and pair.low is not None and pair.high is not None and pair.low * pair.high > 0


def standing(evaluation: Evaluation) -> tuple[str, str]:
    """Return a colour and the headline: who is best in closed loop, and by how much over whom."""
    seen = {name: facts.seen_episodes for name, facts in evaluation.models.items() if facts.seen_episodes}
    if seen:
        name, count = next(iter(seen.items()))
        return "none", f"No verdict: {name} was trained on {count} of these {evaluation.episodes} episodes"
    best = best_of(evaluation)
    loop = evaluation.forecasters[best].closed_loop
    if loop.adds_auc is None:
        final = f"{digits(1e3 * loop.final_position_error_m)} mm"
        return "none", f"{called(best)} ends nearest, {final} off; no ADD-S: not every object has a point cloud"
    gains = [_gain_words(pair) for pair in references(evaluation, best)]
    margin = f": {' and '.join(gains)}" if gains else ""
    tone = "none" if not evaluation.models else "bad"
    if best in evaluation.models:
        others = [evaluation.pair(best, name) for name in evaluation.forecasters if name not in evaluation.models]
        tone = "good" if all(is_sure(evaluation, pair) for pair in others if pair is not None) else "part"
    return tone, f"{called(best)} is best at {100 * loop.adds_auc:.1f} % ADD-S AUC{margin}"


def certainty(evaluation: Evaluation) -> str:
    """Return how sure the headline is, and where the best model stands if another forecaster is best; may be empty."""
    if not has_intervals(evaluation):
        return (
            f"{evaluation.episodes} test trajectories are fewer than {LEAST_TRAJECTORIES}: the tables have no "
            "intervals, and no difference is called sure."
        )
    shown = dict.fromkeys((best_of(evaluation), best_model(evaluation)))
    return " ".join(filter(None, (_margins(evaluation, name) for name in shown)))


def _margins(evaluation: Evaluation, name: str) -> str:
    """Return what a forecaster gains over the references, with intervals; empty without any."""
    words = [
        f"{100 * pair.value:+.1f} points over {REFERENCES[pair.reference]} (95 % {100 * pair.low:+.1f} to "
        f"{100 * pair.high:+.1f}{'' if is_sure(evaluation, pair) else ', not sure'})"
        for pair in references(evaluation, name)
        if pair.low is not None and pair.high is not None
    ]
    return f"{called(name)}: {', '.join(words)}." if words else ""


def called(name: str) -> str:
    """Return what a forecaster is called at the beginning of a sentence."""
    words = {SIMULATOR: "The nominal simulator", "stays": "An object that stays"}
    plain = {REPAIRED: "The repaired simulator", "keeps_velocity": "An object that keeps its velocity"}
    return (words | plain).get(name, name)


def _gain_words(pair: Pair) -> str:
    """Return `3.1 points above the nominal simulator`."""
    direction = "above" if pair.value >= 0 else "below"
    return f"{100 * abs(pair.value):.1f} points {direction} {REFERENCES[pair.reference]}"
