"""What a report was drawn from: the recordings that were looked at, and the programs that did it."""

from __future__ import annotations

import mujoco

from candata import __version__
from candata.datasets import Dataset
from candata.gap.data.recordings import title
from candata.gap.fit.folds import FOLDS
from candata.gap.fit.problem import Problem
from candata.scenes import Scene
from candata.schema.report import DiagnosisData, EpisodeCount


def data_used(dataset: Dataset, problem: Problem, total: int, held_out: int) -> DiagnosisData:
    """Return what was looked at: `total` episodes, of which `problem` was searched on and `held_out` measured on."""
    searched = len(problem.recs)
    apart = [f"effects searched on {searched} episodes, measured on the other {held_out}"] * (total > searched)
    return DiagnosisData(
        dataset=title(dataset),
        episodes=EpisodeCount(total=total, folds=FOLDS, held_out=held_out),
        floor=problem.floor_kind,
        channels=tuple(problem.recs.readings),
        notes=(*given_note(problem.replayer.scene), *apart, *problem.recs.notes),
    )


def given_note(scene: Scene) -> tuple[str, ...]:
    """Return the note that the nominal simulator holds given effects; none where it holds none."""
    if not scene.given_effects:
        return ()
    names = ", ".join(f"{s.name} {s.element}" if s.element else s.name for s in scene.given_effects)
    return (f"effects that the nominal simulator holds already: {names}",)


def provenance(scene: Scene) -> dict[str, str]:
    """Return what a report was made with."""
    return {
        "candata": __version__,
        "mujoco": mujoco.__version__,
        "scene": scene.name,
        "scene_digest": scene.digest,
    }
