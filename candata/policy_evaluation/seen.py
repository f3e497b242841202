"""What was seen of policies: recordings of them, or a stand-in for the real world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.effects import read_effects
from candata.errors import UnknownNameError, UsageError, Where
from candata.policy_evaluation.contract import RealStarts
from candata.policy_evaluation.policies import EvaluatedPolicy
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.schema.outcome import SUCCESS
from candata.simulate.seal import read_seal

#: Label of an episode that names the episode from whose start it was played.
START_LABEL = "start"


@dataclass(frozen=True)
class Withheld:
    """Effects of a stand-in for the real world, and the digest of the scene that a seal of them names."""

    effects: tuple[EffectSetting, ...]
    scene_digest: str | None = None

    def check(self, scene: Scene) -> None:
        """Refuse a seal of another scene.

        Raises
        ------
        UsageError
            When it is.
        """
        if self.scene_digest not in (None, scene.digest):
            raise UsageError(
                "the seal is of another scene",
                expected=f"digest {scene.digest[:12]} of {scene.name}",
                found=f"digest {str(self.scene_digest)[:12]}",
            )


def recorded_success(dataset: Dataset, policies: Sequence[EvaluatedPolicy], starts: RealStarts) -> NDArray[np.float64]:
    """Return what recordings say `(P, n)`: 1 success, 0 another outcome, NaN where none was recorded.

    An episode counts for the policy that its task names, from its own start, or from that of the episode which its
    label `start` names; the mean where a start was played several times.

    Parameters
    ----------
    dataset : Dataset
        Recordings with an `outcome`.
    policies : sequence of EvaluatedPolicy
        In the order of the rows.
    starts : RealStarts
        In the order of the columns.

    Raises
    ------
    UnknownNameError
        When the label `start` of such a recording names no episode of the data set.
    """
    rows = {policy.name: k for k, policy in enumerate(policies)}
    columns = {name: k for k, name in enumerate(starts.ids)}
    total, count = np.zeros((len(rows), len(columns))), np.zeros((len(rows), len(columns)))
    catalog = dataset.catalog(["id", "meta"])
    names = catalog["id"].to_pylist()
    known_names = set(names)
    for name, text in zip(names, catalog["meta"].to_pylist(), strict=True):
        facts = parse_json(text)
        start = str((facts.get("labels") or {}).get(START_LABEL, name))
        if facts.get("outcome") is None or facts.get("task") not in rows:
            continue
        if start not in known_names:
            labelled = Where(path=str(dataset.path), episode=name)
            raise UnknownNameError(f"episode in the label {START_LABEL!r}:", start, known_names, labelled)
        if start not in columns:
            continue
        place = rows[facts["task"]], columns[start]
        total[place] += facts["outcome"] == SUCCESS
        count[place] += 1
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def recordings_from(dataset: Dataset, ids: Sequence[str]) -> dict[str, str]:
    """Return the other episodes that were played from the starts of some, each with the one that its label names."""
    catalog, starts = dataset.catalog(["id", "meta"]), frozenset(ids)
    labels = {
        name: (parse_json(text).get("labels") or {}).get(START_LABEL)
        for name, text in zip(catalog["id"].to_pylist(), catalog["meta"].to_pylist(), strict=True)
    }
    return {name: start for name, start in labels.items() if start in starts and name != start}


def withheld_effects(path: Path) -> Withheld:
    """Return the effects of a stand-in for the real world: those of an `effects.yaml`, or of a sealed file.

    Raises
    ------
    UsageError
        When the file is missing or neither of these.
    """
    if path.suffix.lower() != ".json":
        return Withheld(read_effects(path).effects)
    seal = read_seal(path)
    return Withheld(seal.effects, seal.scene_digest)
