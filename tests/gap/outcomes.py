"""Outcomes of blind cases, written by hand: what is hidden, what is named, and with which numbers."""

from __future__ import annotations

from candata.gap.blind.outcomes import Outcome
from candata.schema.bench import CaseResult, Label, Shares
from candata.schema.effect import EffectSetting
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, Gap, NamedEffect, Report

DATA = DiagnosisData(dataset="case", episodes=EpisodeCount(total=20, folds=4, held_out=20))
MASS = EffectSetting(name="object_mass", parameters={"mass_scale": 1.5})
SLIDE = EffectSetting(name="sliding_friction", parameters={"scale": 0.6})
DRY = EffectSetting(name="joint_dry_friction", element="index2", parameters={"frictionloss_Nm": 0.05})
CONE = EffectSetting(name="friction_cone", parameters={"cone": "pyramidal"})


def say(setting: EffectSetting, support: float = 0.9, **values: float) -> NamedEffect:
    """Name an effect with its numbers, or others, each within 10 %."""
    numbers = {**setting.parameters, **values}
    found = {
        n: Estimate(value=v) if isinstance(v, str) else Estimate(value=v, low=0.9 * v, high=1.1 * v)
        for n, v in numbers.items()
    }
    return NamedEffect(name=setting.name, element=setting.element, share=1.0, support=support, parameters=found)


def case(kind, effects=(), named=(), verdict=None, rises=None, closed=0.99, cpu_s=10.0, cold=False, **more) -> Outcome:
    label = Label(case="case-0001", kind=kind, effects=effects, main=more.get("main"), outside=more.get("outside"))
    report = Report(
        verdict=verdict or ("explained" if named else "no_gap"),
        effects=tuple(named),
        unknown=more.get("unknown"),
        ambiguous_class=more.get("tied", ()),
        ranking=more.get("ranking", ()),
        gap=Gap(before=3.0, after=1.0, closed=closed if named else None),
        data=DATA,
    )
    shares = Shares(case="case-0001", sealed="", rises=rises, alike=more.get("alike")) if rises else None
    result = CaseResult(case="case-0001", sealed="", cpu_s=cpu_s, cold=cold, report=report)
    return Outcome(label, result, shares, more.get("nominal", {}))
