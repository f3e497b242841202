"""Opening cases: what was said of each beside its label, and the values of the model that both are measured from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from math import isnan

from candata.effects import effect_names
from candata.gap.blind.draws import own_values
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.outcomes import Outcome, text_of
from candata.gap.blind.runs import Place
from candata.scenes import Scene
from candata.schema.bench import CaseResult, Label, Shares
from candata.schema.effect import EffectSetting
from candata.schema.report import NamedEffect


def opened_outcomes(
    places: Sequence[Place],
    results: Sequence[CaseResult],
    labels: dict[str, Label],
    shares: dict[str, Shares],
) -> list[Outcome]:
    """Return the outcome of each result.

    Parameters
    ----------
    places : sequence of Place
        Where the cases lie.
    results : sequence of CaseResult
        What was said of some of them.
    labels, shares : dict
        The truth of each case, and what each true effect is worth, by the case's name.
    """
    scenes = {p.folder.name: p.nominal for p in places}
    load = lru_cache(maxsize=1)(NominalScene.load)
    outcomes = []
    for r in results:
        label = labels[r.case]
        effects: list[EffectSetting | NamedEffect] = [*label.effects, *(r.report.effects if r.report else ())]
        nominal = _nominal(load(scenes[r.case]), ((e.name, e.element) for e in effects)) if effects else {}
        outcomes.append(Outcome(label, r, shares.get(r.case), nominal))
    return outcomes


def _nominal(scene: Scene, effects: Iterable[tuple[str, str | None]]) -> dict[str, dict[str, float]]:
    """Return the model's own value of each parameter of some effects; none of a name that another version knew."""
    known = set(effect_names())
    return {
        text_of(name, element): {n: v for n, v in own_values(name, scene, element).items() if not isnan(v)}
        for name, element in effects
        if name in known
    }
