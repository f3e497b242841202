"""What a diagnosis returns, and all that its conclusion is drawn from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from candata.datasets import Dataset
from candata.gap.fit.problem import Problem
from candata.gap.replay.replayer import EffectSet
from candata.gap.search.attribution import Attribution
from candata.gap.validation.closure import HeldOut
from candata.gap.verdict.figures import Evidence
from candata.policies import Motion
from candata.scenes import Scene
from candata.schema.effect import EffectsFile
from candata.schema.report import (
    Report,
)
from candata.simulate.world import all_effects


@dataclass(frozen=True)
class Diagnosis:
    """The report, what its figures show, and the repaired simulator.

    Attributes
    ----------
    report : Report
    evidence : Evidence
    effects : EffectsFile
        Ready to be written as `effects.yaml`: the scene's given effects and the named ones.
    motion : tuple of Motion
        What to record next, ready to be written as `motion.parquet`; empty where nothing is proposed.
    stopgap : EffectsFile or None
        The same with a force fitted to what remains, for `learned_residual.yaml`; None where there is none.
    calibration : EffectsFile or None
        A joint fit that claims no names, for `calibration.yaml`; None where there is none.
    named : tuple of EffectSetting
        The named effects alone, on top of the scene with its given effects.
    replays : float
        What was simulated, in replays of all episodes: its cost, the same on any machine. What an earlier diagnosis
        kept in the cache is not simulated again, so that it depends on the cache, as nothing of the report does.
    """

    report: Report
    evidence: Evidence
    effects: EffectsFile
    motion: tuple[Motion, ...] = ()
    stopgap: EffectsFile | None = None
    calibration: EffectsFile | None = None
    named: EffectSet = ()
    replays: float = 0.0

    def __repr__(self) -> str:
        """Return the report's line."""
        return f"Diagnosis({self.report!r})"

    def _repr_html_(self) -> str:
        """Return the report's table: what a notebook shows."""
        return self.report._repr_html_()


@dataclass(frozen=True)
class Findings:
    """All that a conclusion is drawn from; `world` is where `held` was measured, `problem` where it was searched."""

    dataset: Dataset
    scene: Scene
    problem: Problem
    attribution: Attribution
    world: Problem
    held: HeldOut
    episodes: int


def simulator(scene: Scene, settings: EffectSet) -> EffectsFile:
    """Return effects on top of a scene as a file of the plain scene, its given effects among them."""
    return EffectsFile(scene=lasting(scene.name), effects=all_effects(scene, settings))


def lasting(name: str) -> str:
    """Return a scene's name so that it can be read from anywhere: a file by its whole path."""
    return str(Path(name).resolve()) if Path(name).suffix in (".yaml", ".yml") else name


def judged_problem(f: Findings) -> Problem:
    """Return the problem in units of the floor by which the candidates were judged."""
    return replace(f.problem, score=f.attribution.score)
