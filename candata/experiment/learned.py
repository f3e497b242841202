"""A trained model beside the repair of a diagnosis: how far each closes the gap of the object's motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from candata.datasets import Dataset
from candata.errors import DataError, UsageError, Where
from candata.experiment.scores import Resampling, row_scores
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.schema.report import LearnedModel, SharedGap
from candata.training import checkpoint, jobs
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.results import REPAIRED, SIMULATOR, Evaluation


def check_run(run: Path, dataset: Dataset) -> None:
    """Refuse a run that cannot be compared, before a diagnosis begins.

    Raises
    ------
    UsageError
        When there is no checkpoint, it is a pickle, or the run was trained on these episodes in another dataset.
    DataError
        When it is damaged, or the recordings hold no point cloud, without which there is no ADD-S.
    """
    trained = checkpoint.read(run)
    seen = [] if _is_trained_here(trained, dataset) else sorted(set(dataset.ids) & (jobs.trained_on(trained) or set()))
    if seen:
        raise UsageError(
            "the run was trained on recordings that are diagnosed",
            expected="a run that has not seen them, or one of this very version, whose test episodes are scored",
            found=f"{len(seen)} of {len(dataset)} episodes, such as {seen[0]}",
            where=Where(path=str(run)),
            fix="train without them, or diagnose others",
        )
    facts = (parse_json(text) for text in dataset.catalog(["meta"])["meta"].to_pylist())
    if not all(fact.get("point_cloud") for fact in facts):
        raise DataError(
            "the recordings hold no point cloud of the object, so a model cannot be compared by ADD-S",
            expected="a cloud for each episode",
            where=Where(path=str(dataset.path)),
            fix="give one when importing, or leave --run out",
        )


def learned_model(
    run: Path,
    dataset: Dataset,
    scene: str,
    repair: tuple[EffectSetting, ...],
    stage: Callable[[str], None] = lambda _words: None,
) -> LearnedModel:
    """Return how far a run closes the gap that the nominal simulator leaves, beside the repair, in closed loop.

    Parameters
    ----------
    run : Path
        Folder of a run, or a checkpoint.
    dataset : Dataset
        The recordings that were diagnosed; of a run that trained on this very version, its test episodes.
    scene : str
        The nominal simulator, as `load_scene` takes it.
    repair : tuple of EffectSetting
        What the diagnosis named; without any there is no repair to compare with.
    stage : callable
        Called with what is being done.

    Raises
    ------
    CandataError
        As `candata.training.evaluation.evaluate`.
    """
    group = "test" if _is_trained_here(checkpoint.read(run), dataset) else "all"
    settings = EvaluationSettings(group=group, simulator=True, scene=scene, effects=repair or None, baselines=False)
    evaluation, _ = evaluate([run], dataset, settings, stage)
    name, facts = next(iter(evaluation.models.items()))
    return LearnedModel(
        run=str(run),
        model=facts.model,
        episodes=evaluation.episodes,
        nominal_auc=_auc(evaluation, SIMULATOR),
        closed=_shared_gap(evaluation, name),
        repair=_shared_gap(evaluation, REPAIRED) if repair else None,
    )


def _is_trained_here(trained: checkpoint.Checkpoint, dataset: Dataset) -> bool:
    """Tell whether a run was trained on this very version of a dataset."""
    return any(source.digest == dataset.digest for source in trained.run.trained_on)


def _auc(evaluation: Evaluation, name: str) -> float:
    """Return the mean closed-loop ADD-S AUC of a forecaster by episode."""
    return float(row_scores([evaluation], [name]).adds_auc.mean())


def _shared_gap(evaluation: Evaluation, name: str) -> SharedGap:
    """Return a forecaster's AUC, and the share of the gap from the nominal simulator's to 1 that it closes."""
    nominal = row_scores([evaluation], [SIMULATOR]).adds_auc
    share = Resampling(evaluation.episodes).closed(row_scores([evaluation], [name]).adds_auc, nominal, None)
    return SharedGap(adds_auc=_auc(evaluation, name), share=share.value, low=share.low, high=share.high)
