"""The worlds of an evaluation: simulators, trained models, and a stand-in for the real world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from candata.datasets import Dataset
from candata.errors import DataError, UsageError, Where
from candata.loaders import find_split
from candata.loaders.splits import group_ids
from candata.policy_evaluation.contract import World
from candata.policy_evaluation.learned import JointsFrom, LearnedWorld, check_joints
from candata.policy_evaluation.seen import recordings_from
from candata.policy_evaluation.simulated import SimulatedWorld
from candata.scenes import Scene, load_scene
from candata.scenes.recorded_names import builtin_scene
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json

NOMINAL, REPAIRED, WITHHELD, RECORDINGS = "nominal", "repaired", "withheld", "recordings"


@dataclass(frozen=True)
class ModelSettings:
    """How trained models forecast.

    Attributes
    ----------
    samples, steps : int
        Samples of a forecast, and steps of its sampler.
    execute : int or None
        Model steps executed of each forecast of planned commands; by default 8, or the horizon where that is shorter.
    joints : str
        What moves the joints: `servo`, or `simulator`.
    device : str
        `cpu` or `cuda`.
    """

    samples: int = 4
    steps: int = 4
    execute: int | None = None
    joints: JointsFrom = "servo"
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse another origin of joints, also where no model takes part."""
        check_joints(self.joints)


@dataclass(frozen=True)
class HeldOut:
    """Held-out episodes of one scene, and the trained worlds for which they are held out.

    Attributes
    ----------
    scene : Scene
        The nominal scene.
    ids : tuple of str
        Episodes.
    split : str
        Name of the split.
    learned_worlds : tuple of LearnedWorld
    seen_starts : dict of str to frozenset of str
        By run: the episodes that it was trained on, or on recordings that were played from their starts.
    """

    scene: Scene
    ids: tuple[str, ...]
    split: str
    learned_worlds: tuple[LearnedWorld, ...]
    seen_starts: dict[str, frozenset[str]] = field(default_factory=dict)

    def seen_notes(self, starts: Sequence[str]) -> tuple[str, ...]:
        """Return a line for each run that was trained on some of the starts, which `train` and `all` allow."""
        counts = {name: len(seen.intersection(starts)) for name, seen in self.seen_starts.items()}
        return tuple(
            f"{name} was trained on {count} of the {len(starts)} starts, or on recordings from them: what it forecasts "
            "there it has seen"
            for name, count in counts.items()
            if count
        )


def held_out_episodes(
    runs: Sequence[Path], dataset: Dataset, group: str, scene: str | None, settings: ModelSettings, threads: int = 1
) -> HeldOut:
    """Return the held-out episodes of a data set, and a world for each run.

    Parameters
    ----------
    runs : sequence of Path
        Folders of runs, or checkpoints; none needs no torch.
    dataset : Dataset
        The recordings.
    group : str
        Group of the runs' split.
    scene : str or None
        What `load_scene` takes; by default the scene that the first held-out episode names. Episodes that name another
        one are left out then.
    settings : ModelSettings
        How models forecast.
    threads : int
        Threads of simulators that models read.

    Raises
    ------
    UsageError
        When a run was trained on the starts or on recordings that were played from them (but for the groups `train` and
        `all`), on another hand, in other units or at another rate, or cannot be a world.
    DataError
        When no episode is held out.
    """
    if not runs:
        name = None
        split = find_split(dataset, name)
        ids = tuple(dataset.ids) if group == "all" else tuple(group_ids(dataset, split, group))
        loaded_scene, ids = _of_one_scene(dataset, ids, scene)
        return HeldOut(loaded_scene, ids, "default", ())
    from candata.training import evaluated_runs
    from candata.training.evaluation import EvaluationSettings, held_out_windows, model_entrant
    from candata.training.servo_lag import fit_servo_lags

    run_entries = evaluated_runs.read_runs(runs, settings.execute, (NOMINAL, REPAIRED, WITHHELD, RECORDINGS))
    split, split_name = evaluated_runs.split_of(run_entries, dataset)
    ids = tuple(dataset.ids) if group == "all" else tuple(group_ids(dataset, split, group))
    played_from = recordings_from(dataset, ids)
    held_out = tuple(dict.fromkeys((*ids, *played_from)))
    seen_starts = {}
    for run_entry in run_entries:
        seen = evaluated_runs.seen_ids(run_entry, dataset, split, held_out) or ()
        evaluated_runs.refuse_seen(run_entry, seen, group)
        seen_starts[run_entry.name] = frozenset(seen) | {played_from[name] for name in seen if name in played_from}
    evaluated_runs.check_scaled(run_entries, dataset, ids)
    loaded_scene, ids = _of_one_scene(dataset, ids, scene)
    evaluation_settings = EvaluationSettings(
        group, settings.samples, settings.steps, settings.execute, device=settings.device, scene=scene, threads=threads
    )
    held_windows = held_out_windows(dataset, split, run_entries, evaluation_settings)
    lags = fit_servo_lags(held_windows)
    learned_worlds = []
    for run_entry in run_entries:
        entrant = model_entrant(run_entry, held_windows, evaluation_settings)
        forecaster: Any = entrant.forecaster  # a run's is a TrainedModel
        common = (run_entry.name, loaded_scene, forecaster, entrant.windows, lags, run_entry.execute)
        learned_worlds.append(LearnedWorld(*common, settings.joints))
    return HeldOut(loaded_scene, ids, split_name, tuple(learned_worlds), seen_starts)


def _of_one_scene(dataset: Dataset, ids: tuple[str, ...], scene: str | None) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene, and those of the episodes that were recorded in it."""
    if not ids:
        raise DataError(
            "no held-out episodes to start from",
            where=Where(path=str(dataset.path)),
            fix="make a split with test episodes, or give --split all",
        )
    if scene is not None:
        return load_scene(scene), ids
    catalog = dataset.catalog(["id", "meta"])
    scene_names = {
        name: parse_json(text).get("scene")
        for name, text in zip(catalog["id"].to_pylist(), catalog["meta"].to_pylist(), strict=True)
    }
    first_scene = builtin_scene(scene_names[ids[0]], Where(path=str(dataset.path), episode=ids[0]))
    return load_scene(first_scene), tuple(name for name in ids if scene_names[name] == scene_names[ids[0]])


def simulated_worlds(
    scene: Scene, effects: tuple[EffectSetting, ...] | None, threads: int = 1
) -> tuple[SimulatedWorld, ...]:
    """Return the nominal simulator, and the repaired one where there are effects.

    Raises
    ------
    UsageError
        When the repair holds no effect.
    """
    worlds = [SimulatedWorld(NOMINAL, scene, (), threads)]
    if effects is not None:
        if not effects:
            raise UsageError("the repair holds no effect", fix="leave --effects out")
        worlds.append(SimulatedWorld(REPAIRED, scene, effects, threads))
    return tuple(worlds)


def without_effect(world: SimulatedWorld, number: int) -> SimulatedWorld:
    """Return a repaired simulator without one of its effects."""
    kept_effects = tuple(effect for k, effect in enumerate(world.effects) if k != number)
    return SimulatedWorld(
        f"{world.name} without {effect_text(world.effects[number])}", world.scene, kept_effects, world.threads
    )


def effect_text(effect: EffectSetting) -> str:
    """Return an effect and the element it acts on."""
    return effect.name if effect.element is None else f"{effect.name} of {effect.element}"


def summaries(worlds: Sequence[World]) -> dict[str, str]:
    """Return what each world is, by name."""
    return {world.name: world.summary for world in worlds}
