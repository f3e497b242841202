"""`evaluate`: runs, simulators and baselines on the same held-out episodes of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from candata import __version__
from candata.datasets import Dataset
from candata.errors import CandataError, UnknownNameError, UsageError
from candata.loaders import Split, Windows, windows
from candata.loaders.layout import row_shapes
from candata.loaders.splits import GROUPS, group_ids
from candata.schema.effect import EffectSetting
from candata.training import evaluated_runs, feed, jobs
from candata.training.data import channels_for
from candata.training.evaluated_runs import EvaluatedRun
from candata.training.forecasters import BASELINES, TrainedModel
from candata.training.results import REPAIRED, SIMULATOR, Evaluation, ModelFacts, Scores, SimulatorFacts, Track
from candata.training.rollout import EXECUTE, Course
from candata.training.run_simulator import trained_simulator, unmet_objects
from candata.training.scoring import Entrant, EvaluationFindings, chosen_windows, score
from candata.training.servo_lag import fit_servo_lags, followed_joints
from candata.training.simulator import Simulator, simulator

#: What a score or a simulator reads of the recordings where they hold it, whatever the models read.
READ_WHERE_RECORDED = ("joint_position", "action", "contact")
JointsFrom = Literal["recorded", "servo", "simulator"]


@dataclass(frozen=True)
class EvaluationSettings:
    """How to evaluate.

    Attributes
    ----------
    group : str
        `train`, `val` or `test` of the runs' split, or `all` episodes.
    samples : int
        Samples averaged.
    steps : int
        Steps of the sampler.
    execute : int or None
        Steps executed before the next forecast in closed loop; by default 8, or the horizon where that is shorter.
    seed : int
        Seed of the noise.
    device : str
        `cpu` or `cuda`.
    baselines : bool
        Whether `stays` and `keeps_velocity` are rows.
    simulator : bool or None
        Whether the nominal simulator is a row; None where the scene of the episodes is known and can be loaded.
    scene : str or None
        Scene of the simulators, as `load_scene` takes it; None for each episode's own.
    effects : tuple of EffectSetting or None
        The repair: the simulator with these effects is a row too.
    joints : str
        What closed loops feed the models as joints: `recorded`; `servo`, a lag fitted on training episodes; or
        `simulator`, those of the free simulation, of the repaired one where there is a repair.
    threads : int
        Threads of the simulators.
    shape : mapping of str to float or None
        `history`, `horizon` and `rate_hz` of the windows where no run says them; what it leaves out is what
        `candata train` takes by default.
    """

    group: str = "test"
    samples: int = 16
    steps: int = 10
    execute: int | None = None
    seed: int = 0
    device: str = "cpu"
    baselines: bool = True
    simulator: bool | None = None
    scene: str | None = None
    effects: tuple[EffectSetting, ...] | None = None
    joints: JointsFrom = "recorded"
    threads: int = 1
    shape: Mapping[str, float] | None = None


@dataclass(frozen=True)
class _Simulators:
    """The simulators' rows: how each forecasts, what it is, and why one is left out."""

    forecasters: Mapping[str, Simulator]
    facts: Mapping[str, SimulatorFacts]
    notes: tuple[str, ...] = ()


def evaluate(
    paths: Sequence[Path],
    dataset: Dataset,
    settings: EvaluationSettings,
    stage: Callable[[str], None] = lambda _name: None,
) -> tuple[Evaluation, tuple[Track, ...]]:
    """Return what was found, and a few episodes for the figures.

    Parameters
    ----------
    paths : sequence of Path
        Folders of runs (their best checkpoints), or checkpoints; none compares simulators and baselines alone.
    dataset : Dataset
        Version to evaluate on.
    settings : EvaluationSettings
        How.
    stage : callable
        Called with what is being done.

    Raises
    ------
    UsageError
        When there is no checkpoint, it is a pickle, of another hand, in other units or at another rate, a run has seen
        the test episodes, a number is out of range, or a simulator has no scene that fits the data.
    DataError
        When a checkpoint is damaged, the group is empty, or no episode is as long as the horizon.
    """
    evaluated = evaluated_runs.read_runs(paths, settings.execute, (SIMULATOR, REPAIRED, *BASELINES))
    _check(settings, evaluated)
    split, split_name = evaluated_runs.split_of(evaluated, dataset)
    ids = dataset.ids if settings.group == "all" else group_ids(dataset, split, settings.group)
    seen = {each.name: evaluated_runs.seen_ids(each, dataset, split, ids) for each in evaluated}
    for each in evaluated:
        evaluated_runs.refuse_seen(each, seen[each.name] or (), settings.group)
    evaluated_runs.check_scaled(evaluated, dataset, ids)
    stage("reading the dataset")
    held_out = held_out_windows(dataset, split, evaluated, settings)
    entrants = {each.name: model_entrant(each, held_out, settings) for each in evaluated}
    simulators = _simulators(held_out, settings)
    own_execute = settings.execute or min(EXECUTE, held_out.horizon)
    execute = max((each.execute for each in evaluated), default=own_execute)
    others = {**simulators.forecasters, **(BASELINES if settings.baselines else {})}
    entrants |= {name: Entrant(forecaster, held_out, execute) for name, forecaster in others.items()}
    if not entrants:
        raise UsageError("nothing to evaluate", expected="a run, a simulator, or baselines", fix="name a run")
    joints_from, joints = _joints(held_out, settings, simulators)
    findings = score(held_out, entrants, settings.seed, stage, joints)
    scored = {scores.id for scores in findings.by_episode}
    return Evaluation(
        dataset=f"{dataset.name}@{dataset.digest[:12]}",
        split=split_name,
        group=settings.group,
        episodes=len(findings.by_episode),
        windows=len(chosen_windows(held_out)),
        rows=findings.rows,
        gap_rows=findings.gap_rows,
        rate_hz=held_out.rate_hz,
        begins_after=findings.begins_after,
        samples=settings.samples,
        sampling_steps=settings.steps,
        seed=settings.seed,
        joints_from=joints_from,
        models={each.name: _model_facts(each, seen[each.name], scored, findings, settings) for each in evaluated},
        simulators=dict(simulators.facts),
        pairs=findings.pairs,
        breakdown=findings.breakdown,
        by_episode=findings.by_episode,
        notes=simulators.notes + _joint_notes(settings) + _object_notes(evaluated, entrants),
        forecasters={
            name: Scores(
                summary=entrant.forecaster.summary,
                windows=findings.windows[name],
                closed_loop=findings.closed_loop[name],
            )
            for name, entrant in entrants.items()
        },
        revision=__version__,
    ), tuple(_with_scene(track, held_out, simulators.forecasters.get(SIMULATOR)) for track in findings.tracks)


def _check(settings: EvaluationSettings, evaluated: Sequence[EvaluatedRun]) -> None:
    """Refuse numbers and words that mean nothing."""
    for kind, word, words in (
        ("group of a split", settings.group, (*GROUPS, "all")),
        ("origin of joints", settings.joints, get_args(JointsFrom)),
    ):
        if word not in words:
            raise UnknownNameError(kind, word, words)
    if settings.simulator is False and _requires_simulator(settings):
        raise UsageError("a scene, effects or simulated joints, and no simulator", fix="leave --no-simulator out")
    if settings.shape and evaluated:
        raise UsageError(
            "the runs say what their windows are",
            found=", ".join(f"--{name.replace('_', '-')}" for name in settings.shape),
            fix="leave these options out: they are for an evaluation without runs",
        )
    ranges: list[tuple[str, int, int | None]] = [("samples", settings.samples, None), ("steps", settings.steps, None)]
    ranges += [("steps", settings.steps, each.run.config.get("train_steps")) for each in evaluated]
    ranges += [("execute", each.execute, each.run.sizes["horizon"]) for each in evaluated]
    if settings.execute is not None and not evaluated:
        shape = {**jobs.DEFAULT_SHAPE, **(settings.shape or {})}
        ranges += [("execute", settings.execute, int(shape["horizon"]))]
    for name, value, maximum in ranges:
        if value < 1 or (maximum is not None and value > maximum):
            raise UsageError(
                f"--{name} is out of range", expected=f"1 to {maximum}" if maximum else "at least 1", found=str(value)
            )
    jobs.check_device(settings.device)


def held_out_windows(
    dataset: Dataset, split: Split, evaluated: Sequence[EvaluatedRun], settings: EvaluationSettings
) -> Windows:
    """Return a window at every step of the models, with all that they and the scores read."""
    recorded = set(row_shapes(dataset, None))
    reads = {channel for each in evaluated for channel in each.run.channels}
    channels = {"object_pose", *reads, *(name for name in READ_WHERE_RECORDED if name in recorded)}
    shape = dict(jobs.DEFAULT_SHAPE) | dict(settings.shape or {})
    if evaluated:
        shape = {name: max(each.run.sizes[name] for each in evaluated) for name in ("history", "horizon")}
        shape["rate_hz"] = evaluated[0].run.rate_hz
    options: dict[str, Any] = {**shape, "channels": channels_for(tuple(sorted(channels)), dataset)}
    if settings.group != "all":
        options |= {"split": settings.group, "splits": split}
    full_windows = windows(dataset, **options)  # refuses a horizon that no episode holds
    return windows(dataset, pad="both", step=int(full_windows.stride[full_windows.owner].min()), **options)


def model_entrant(evaluated: EvaluatedRun, held_out: Windows, settings: EvaluationSettings) -> Entrant:
    """Return a run as it takes part: its windows hold what it reads alone, over its own history and horizon."""
    run, file = evaluated.run, held_out.cache.file
    shapes = {name: shape for name, shape in file.shapes.items() if name in run.channels}
    own_windows = replace(
        held_out,
        cache=replace(held_out.cache, file=file.model_copy(update={"shapes": shapes})),
        history=run.sizes["history"],
        horizon=run.sizes["horizon"],
    )
    jobs.check_data(evaluated.checkpoint, own_windows)
    forecaster = TrainedModel(
        jobs.trained_module(evaluated.checkpoint, settings.device),
        feed.clouds_of(own_windows, settings.device),
        settings.samples,
        settings.steps,
        settings.device,
        f"{evaluated.name} ({run.model}, mean of {settings.samples} samples)",
        trained_simulator(evaluated.checkpoint, own_windows, settings.scene, settings.threads),
    )
    draws = "train_steps" in run.config  # as a diffusion model does; the samples of others are equal
    return Entrant(forecaster, own_windows, evaluated.execute, replace(forecaster, samples=1) if draws else None)


def _simulators(held_out: Windows, settings: EvaluationSettings) -> _Simulators:
    """Return the simulators that take part.

    Where nothing asks for one and the episodes' own scene cannot be had, that is a note instead of an error.
    """
    if settings.simulator is False:
        return _Simulators({}, {})
    rows = {SIMULATOR: ()} | ({} if settings.effects is None else {REPAIRED: settings.effects})
    try:
        forecasters = {
            name: simulator(held_out, settings.scene, effects, f"the {name}", settings.threads)
            for name, effects in rows.items()
        }
    except CandataError as error:
        if settings.simulator or _requires_simulator(settings):
            raise
        return _Simulators({}, {}, (f"no simulator beside them: {error.problem}",))
    facts = {name: SimulatorFacts(scene=settings.scene, effects=effects) for name, effects in rows.items()}
    return _Simulators(forecasters, facts)


def _with_scene(track: Track, held_out: Windows, nominal: Simulator | None) -> Track:
    """Return the track with the scene that is simulated of its episode."""
    if nominal is None:
        return track
    number = int(nominal.scenes.number[held_out.episode_ids.index(track.id)])
    return replace(track, scene=list(nominal.scenes.scenes.values())[number])


def _joints(
    held_out: Windows, settings: EvaluationSettings, simulators: _Simulators
) -> tuple[str, Callable[[Course], NDArray] | None]:
    """Return the origin of the joints that closed loops feed, and what makes them; None replays the recorded ones."""
    if settings.joints == "servo":
        lags = fit_servo_lags(held_out)
        count, moved = len(held_out.joint_names), len(lags.joints)
        words = "servo" if moved == count else f"servo for {moved} of {count}, others recorded"
        return words, partial(followed_joints, lags=lags)
    if settings.joints == "simulator":
        name = list(simulators.forecasters)[-1]
        return name, partial(_simulated_joints, simulator=simulators.forecasters[name])
    return "recorded", None


def _joint_notes(settings: EvaluationSettings) -> tuple[str, ...]:
    """Return what people must know of the joints that closed loops feed."""
    is_seen = settings.joints == "servo" and settings.group in evaluated_runs.KNOWINGLY_SEEN
    return ("the servos were fitted on episodes that are scored here",) if is_seen else ()


def _object_notes(evaluated: Sequence[EvaluatedRun], entrants: Mapping[str, Entrant]) -> tuple[str, ...]:
    """Return which runs correct a simulation of objects that they were not trained with."""
    notes = []
    for each in evaluated:
        forecaster = entrants[each.name].forecaster
        if isinstance(forecaster, TrainedModel) and isinstance(forecaster.simulator, Simulator):
            names = unmet_objects(each.run, forecaster.simulator)
            notes += [f"{each.name} was last trained without {', '.join(names)}"] if names else []
    return tuple(notes)


def _simulated_joints(course: Course, simulator: Simulator) -> NDArray:
    """Return the joints of a free simulation of a course."""
    joints = simulator.free_run(course).joints
    return np.zeros((*course.valid.shape, 0)) if joints is None else joints


def _requires_simulator(settings: EvaluationSettings) -> bool:
    """Tell whether something is asked for that only a simulator gives."""
    return settings.scene is not None or settings.effects is not None or settings.joints == "simulator"


def _model_facts(
    evaluated: EvaluatedRun,
    seen: Sequence[str] | None,
    scored: set[str],
    findings: EvaluationFindings,
    settings: EvaluationSettings,
) -> ModelFacts:
    """Return what was evaluated under a run's name."""
    run, read = evaluated.run, evaluated.run.simulator
    return ModelFacts(
        run=evaluated.checkpoint.path.parent.name,
        checkpoint=evaluated.checkpoint.path.name,
        step=evaluated.checkpoint.progress.step,
        model=run.model,
        preset=run.preset,
        trained_on=f"{run.dataset}@{run.digest[:12]}",
        planned_actions=run.config.get("planned_actions"),
        seen_episodes=None if seen is None else sum(name in scored for name in seen),
        history=run.sizes["history"],
        horizon=run.sizes["horizon"],
        execute=evaluated.execute,
        simulator=None if read is None else SimulatorFacts(scene=settings.scene or read.scene, effects=read.effects),
        contact_from=contact_from(evaluated, findings.closed_loop[evaluated.name].contact is not None),
    )


def contact_from(evaluated: EvaluatedRun, forecasts_contact: bool) -> str:
    """Return what the closed loop feeds a run's model as contact; see `ModelFacts`."""
    config = evaluated.run.config
    fingertips = bool(config.get("fingertip_contact", False))
    if "contact" not in evaluated.model.channels or not config.get("contact_history", True):
        return "recorded" if fingertips else "not read"
    if not forecasts_contact:
        return "recorded"
    return "predicted, fingertips recorded" if fingertips else "predicted"
