"""From a dataset and the name of a model to a job, and from a checkpoint back to a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from candata import __version__
from candata.datasets import Dataset
from candata.errors import SetupError, UnknownNameError, UsageError, Where
from candata.loaders import Effective, MixedWindows, Mixture, Normaliser, Split, Windows
from candata.loaders.layout import absent_channels
from candata.loaders.normaliser import Method
from candata.loaders.splits import DEFAULT
from candata.models import Batch, Model, Sizes
from candata.models import model as find_model
from candata.schema.channels import CHANNELS
from candata.schema.effect import EffectSetting
from candata.schema.record import Record
from candata.training import checkpoint, feed, run_simulator, runs, simulated
from candata.training.checkpoint import Checkpoint
from candata.training.correction_gain import choose_gain
from candata.training.data import TrainingData, find_data
from candata.training.hands import with_hand
from candata.training.loop import TrainingJob
from candata.training.processes import ALONE, Processes
from candata.training.rollout import EXECUTE
from candata.training.settings import Run, RunSimulator, TrainingSettings

#: Windows when nothing is asked for.
DEFAULT_SHAPE: Mapping[str, float] = {"history": 8, "horizon": 16, "rate_hz": 10.0}
#: Channels that a model does without where no episode holds them: a toss has neither.
OF_THE_ROBOT = ("joint_position", "action")
#: Batches of the validation loss.
HELD_OUT_BATCHES = 8


@dataclass(frozen=True)
class TrainRequest:
    """What to train.

    Attributes
    ----------
    model : str or None
        Name of a model; None takes that of `init`.
    preset : str or None
        One of its presets; `small` when neither this nor `init` is given.
    config : mapping
        Fields of the model's configuration that differ from the preset.
    history, horizon : int or None
        Rows of the past, the present one included, and steps of the future; 8 and 16, or those of `init`.
    rate_hz : float or None
        Rate of the model's steps; 10, or that of `init`.
    split : str or None
        Name of a stored split; the default one when None.
    init : Path or None
        Checkpoint to begin with.
    normaliser : str or None
        Method of the normaliser; `robust`, or the normaliser of `init`.
    mixture : Mixture or None
        Shares of several datasets.
    scene : str or None
        Scene of the recordings, for a model that reads where the fingertips are or what the simulator makes of them;
        that of `init`, else the one that each episode names.
    effects : tuple of EffectSetting or None
        Effects of its simulator; those of `init`, else none.
    forecasts : Path or None
        Folder where the simulator's forecasts are kept; the user's cache by default.
    most_windows : int or None
        Windows at most of each source and of the validation, evenly spread; all by default.
    """

    model: str | None = None
    preset: str | None = None
    config: Mapping[str, Any] | None = None
    history: int | None = None
    horizon: int | None = None
    rate_hz: float | None = None
    split: str | None = None
    init: Path | None = None
    normaliser: Method | None = None
    mixture: Mixture | None = None
    scene: str | None = None
    effects: tuple[EffectSetting, ...] | None = None
    forecasts: Path | None = None
    most_windows: int | None = None


def prepare(
    data: Dataset | Mapping[str, Dataset],
    request: TrainRequest,
    settings: TrainingSettings,
    device: str = "cpu",
    processes: Processes = ALONE,
    simulating: simulated.Progress = lambda _done, _total: None,
) -> TrainingJob:
    """Return the job.

    Parameters
    ----------
    data : Dataset, or mapping of str to Dataset
        What to train on; several datasets by name, with `ask.mixture`.
    request : TrainRequest
        What to train.
    settings : TrainingSettings
        How.
    device : str
        `cpu` or `cuda`.
    processes : Processes
        Those that train together; this one alone by default.
    simulating : callable
        Called with (windows done, windows in all) while the simulator forecasts the windows of a model that reads it.

    Raises
    ------
    UsageError
        When a setting means nothing, the batch does not divide among the processes, the mixture does not fit the
        datasets, or the checkpoint of `init` is of another model, hand or window.
    DataError
        When a dataset lacks a channel, its split's `train` is empty, no episode is as long as the horizon, or datasets
        to mix differ.
    SetupError
        When the device is not there.
    """
    check_device(device)
    initial = None if request.init is None else checkpoint.read(request.init)
    name, config = _model_config(request, initial, settings)
    training_data = find_data(data, request.mixture, request.split)
    notes: tuple[str, ...] = ()
    if initial is None:
        config, notes = with_hand(config, training_data.datasets.values(), request.scene)
    absent = absent_channels(OF_THE_ROBOT, training_data.datasets.values())
    notes += (f"no {' and no '.join(absent)} in any episode: it is trained without",) if absent else ()
    reads = tuple(channel for channel in find_model(name).reads(config) if channel not in absent)
    default_shape = DEFAULT_SHAPE if initial is None else initial.run.sizes | {"rate_hz": initial.run.rate_hz}
    requested_shape = {"history": request.history, "horizon": request.horizon, "rate_hz": request.rate_hz}
    window_shape = {key: default_shape[key] if value is None else value for key, value in requested_shape.items()}
    window_options = window_shape | {"method": request.normaliser or "robust"}
    train = training_data.feed(tuple(training_data.datasets), "train", reads, window_options)
    simulation = run_simulator.stated(name, request.scene, request.effects, initial, train)
    if simulation is not None:
        train = simulated.thinned(train)
    if request.most_windows is not None:
        train = simulated.evenly_chosen(train, request.most_windows)
    run = _run(training_data, request, settings, name, config, train, initial, simulation)
    make_simulated = partial(
        run_simulator.simulated_feed, run=run, processes=processes, simulating=simulating, folder=request.forecasts
    )
    module = build(run, device)
    if initial is not None:
        module.load_state_dict(initial.tensors(checkpoint.AVERAGE, device))
    batches: tuple[Batch, ...] = ()
    settle = None
    if validation_names := training_data.names_with_group("val"):
        held_out = training_data.feed(validation_names, "val", reads, window_options)
        if simulation is not None:
            # A trial on a few windows only tells how long training takes.
            settle = None if request.most_windows else partial(_settled, held_out=held_out, device=device)
            most_windows = settings.batch * HELD_OUT_BATCHES
            held_out = simulated.evenly_chosen(held_out, min(request.most_windows or most_windows, most_windows))
        batches = feed.held_out(make_simulated(held_out), settings.batch, HELD_OUT_BATCHES, device)
    return TrainingJob(
        run,
        module,
        feed.drawing(make_simulated(train), settings, device, processes),
        batches,
        device,
        training_data.split_record(),
        _effective(train, run),
        notes,
        processes,
        settle,
    )


def _effective(train: Windows | MixedWindows, run: Run) -> Callable[[int], tuple[Effective, ...]]:
    """Return the function from steps to what each source gave by then; nothing without a mixture."""
    if isinstance(train, Windows):
        return lambda steps: ()
    sampler = train.sampler(run.settings.batch, run.settings.seed)
    return lambda steps: train.effective(sampler, steps)


def build(run: Run, device: str = "cpu") -> torch.nn.Module:
    """Return the module of a run with its first weights, on the device."""
    model = find_model(run.model)
    normaliser = Normaliser.parse(run.normaliser, "normaliser of the checkpoint")
    module: torch.nn.Module = model.build(model.parse(run.config), Sizes(**run.sizes), normaliser)
    return module.to(device)


def _settled(source: Checkpoint, held_out: Windows | MixedWindows, device: str) -> Mapping[str, torch.Tensor]:
    """Return the averaged weights of a model over the simulator, with the gain chosen on validation windows."""
    module, run = trained_module(source, device), source.run
    sources = held_out.sources if isinstance(held_out, MixedWindows) else (held_out,)
    simulators = [run_simulator.trained_simulator(source, each) for each in sources]
    followed = [(each, made) for each, made in zip(sources, simulators, strict=True) if made is not None]
    choose_gain(module, followed, min(EXECUTE, run.sizes["horizon"]), run.settings.seed, device)
    return module.state_dict()


def trained_module(source: Checkpoint, device: str = "cpu") -> torch.nn.Module:
    """Return the module of a checkpoint with its averaged weights, ready to forecast."""
    module = build(source.run, device)
    module.load_state_dict(source.tensors(checkpoint.AVERAGE, device))
    return module.eval()


def check_device(device: str) -> None:
    """Refuse a device that is not known or not there.

    Raises
    ------
    UnknownNameError
        When it is neither `cpu` nor `cuda`.
    SetupError
        When there is no GPU.
    """
    if device not in ("cpu", "cuda"):
        raise UnknownNameError("device", device, ("cpu", "cuda"))
    if device == "cuda" and not torch.cuda.is_available():
        raise SetupError("no CUDA device", found=f"torch {torch.__version__}", fix="use --device cpu")


def check_data(source: Checkpoint, windows: Windows | MixedWindows) -> None:
    """Refuse windows of another hand or shape than a checkpoint was made for.

    The number of points may differ, also be none where the model reads no clouds; so may fingertips that it reads not.

    Raises
    ------
    UsageError
        Names both.
    """
    facts = _facts(windows)
    run = source.run
    if windows.clouds.shape[1] or run.config.get("cloud", "none") == "none":
        facts["sizes"] |= {"points": run.sizes["points"]}
    if not run.sizes["fingertips"]:
        del facts["fingertip_names"]
    checkpoint.check_fits(run, facts, source.path)


def _facts(windows: Windows | MixedWindows) -> dict[str, Any]:
    """Return the fields of a Run that the windows decide."""
    return {
        "joint_names": windows.joint_names,
        "actuator_names": windows.actuator_names,
        "fingertip_names": windows.fingertip_names,
        "rate_hz": windows.rate_hz,
        "sizes": windows.sizes(),
    }


def _model_config(request: TrainRequest, initial: Checkpoint | None, settings: TrainingSettings) -> tuple[str, Any]:
    """Return the model's name and its configuration."""
    name = request.model or (initial.run.model if initial else None)
    if name is None:
        raise UsageError("no model", expected="--model NAME, or --init CHECKPOINT", fix="see candata train --help")
    model = find_model(name)
    if initial is None:
        return name, _fresh_config(model, request, settings)
    if request.normaliser is not None:
        raise UsageError(
            "fine-tuning keeps the normaliser of the first run",
            expected=f"{initial.run.normaliser.get('method')}",
            found=f"--normaliser {request.normaliser}",
            where=Where(path=str(initial.path)),
            fix="leave --normaliser out",
        )
    if name != initial.run.model or request.preset not in (None, initial.run.preset) or request.config:
        raise UsageError(
            "fine-tuning keeps the model and its configuration",
            expected=f"--model {initial.run.model} --preset {initial.run.preset}, or neither",
            found=f"--model {name} --preset {request.preset or initial.run.preset}"
            + (" --config" if request.config else ""),
            where=Where(path=str(initial.path)),
            fix="leave --model, --preset and --config out",
        )
    return name, model.parse(initial.run.config)


def _fresh_config(model: Model, request: TrainRequest, settings: TrainingSettings) -> Record:
    """Return the configuration of a new model: the preset, then what differs; the seed is the run's."""
    preset = request.preset or "small"
    if preset not in model.presets:
        raise UnknownNameError("preset", preset, model.presets)
    values = model.presets[preset].model_dump()
    return model.parse(values | {"seed": settings.seed} | dict(request.config or {}))


def _run(
    data: TrainingData,
    request: TrainRequest,
    settings: TrainingSettings,
    name: str,
    config: Record,
    train: Windows | MixedWindows,
    initial: Checkpoint | None,
    simulation: RunSimulator | None,
) -> Run:
    """Return all that decides what the weights will mean."""
    facts = _facts(train)
    if initial is not None:
        check_data(initial, train)
    units = {name: str(CHANNELS[name].unit) for name in train.channels}
    return Run(
        model=name,
        preset=initial.run.preset if initial else request.preset or "small",
        config=config.model_dump(mode="json"),
        **facts,
        **data.facts(),
        split=request.split or DEFAULT,
        channels=train.channels,
        units=units | {"increments": "m, rad"},
        # The weights of a fine-tuned model were made for the scales of its first run.
        normaliser=initial.run.normaliser if initial else train.normaliser.model_dump(mode="json"),
        settings=settings,
        init=_origin(initial),
        simulator=simulation,
        revision=__version__,
    )


def _origin(initial: Checkpoint | None) -> dict[str, Any] | None:
    """Return where the first weights came from."""
    if initial is None:
        return None
    run, train = initial.run, trained_on(initial)
    return {
        "dataset": run.dataset,
        "digest": run.digest,
        "step": initial.progress.step,
        "init": run.init,
        "train": None if train is None else sorted(train),
    }


def trained_on(source: Checkpoint, split: Split | None = None) -> set[str] | None:
    """Return the ids of all episodes that a checkpoint was trained on, those of the runs it began with included.

    Parameters
    ----------
    source : Checkpoint
        Of the run.
    split : Split, optional
        Its split, where that is known; else those beside the file.

    Returns
    -------
    set of str or None
        None where a split is not kept.

    Raises
    ------
    UsageError
        When the split beside it is damaged.
    """
    splits = runs.read_splits(source.path.parent, source.run) if split is None else (split,)
    earlier_ids = [] if source.run.init is None else source.run.init.get("train")
    return (
        None
        if splits is None or earlier_ids is None
        else {*earlier_ids, *(name for split_record in splits for name in split_record.train)}
    )
