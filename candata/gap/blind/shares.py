"""What each true cause of a case is worth: how much worse the true world fits once the cause is taken out of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from candata.datasets import Dataset, open_dataset
from candata.gap.blind.bed import make_bed
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.outcomes import text_of
from candata.gap.blind.runs import Place, finished, spread
from candata.gap.measure.score import Compact
from candata.scenes import Scene
from candata.schema.bench import Label, Shares
from candata.simulate.crew import Crew, alone

SHARES = "shares.jsonl"
#: Episodes on which contributors are compared.
EPISODES = 10


def true_shares(dataset: Dataset, scene: Scene, label: Label, sealed: str = "") -> Shares:
    """Return by how much the loss of the true world rises when each contributor is left out of it, in floors.

    Recordings, observer and score are those of a diagnosis; nothing is fitted.

    Parameters
    ----------
    dataset : Dataset
        The case's recordings.
    scene : Scene
        The nominal scene.
    label : Label
        The truth, opened.
    sealed : str
        The case's hash.
    """
    world = label.effects
    bed = make_bed(dataset, scene, np.random.default_rng(0), EPISODES, world)
    without = [tuple(e for e in world if e is not left) for left in world]
    full, *rest = bed.residuals([world, *without])
    base = bed.score.loss(full).mean()
    rises = {
        text_of(e.name, e.element): float(bed.score.loss(z).mean() - base) for e, z in zip(world, rest, strict=True)
    }
    return Shares(case=label.case, sealed=sealed, rises=rises, alike=_alike([z - full for z in rest]))


def _alike(changes: Sequence[Compact]) -> float | None:
    """Return the largest cosine between the changes that two contributors make; None for fewer than two."""
    flat = [c.ravel().astype(float) for c in changes]
    cosines = [abs(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12) for a, b in combinations(flat, 2)]
    return float(max(cosines)) if cosines else None


def share_of(folder: str, scene: NominalScene, sealed: str, label: str) -> Shares:
    """Return the shares of a case in a folder; runs in any process."""
    path = Path(folder)
    return true_shares(open_dataset(path), scene.load(), Label.model_validate_json(label), sealed)


def measure_shares(
    out: Path,
    cases: Sequence[Place],
    labels: dict[str, Label],
    *,
    crew: Crew = alone,
    told: Callable[[int], None] = lambda count: None,
) -> dict[str, Shares]:
    """Return the shares of every case with causes of the library; those that stand in `shares.jsonl` are kept.

    Parameters
    ----------
    out : Path
        Folder of the results.
    cases : sequence of Place
        Where each case lies.
    labels : dict of str to Label
        The truth of each case, opened.
    crew : Crew
        Who does the work.
    told : callable
        Called with 1 for each case just done.
    """
    hiding = [p for p in cases if labels[p.folder.name].effects]
    standing = {s.sealed: s for s in finished(out / SHARES, Shares)}
    tasks = [(*p.anywhere, labels[p.folder.name].model_dump_json()) for p in hiding if p.sealed not in standing]
    for found in spread(out / SHARES, share_of, tasks, crew):
        standing[found.sealed] = found
        told(1)
    return {p.folder.name: standing[p.sealed] for p in hiding}
