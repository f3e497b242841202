"""The command that trains a dynamics model."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console
from candata_cli.outputs import check_output
from candata_cli.torch_options import Device, Threads, need_torch, set_threads

if TYPE_CHECKING:
    from candata.loaders import Mixture
    from candata.training import Progress, TrainingJob, TrainingReport, TrainingSettings, TrainRequest

#: Shortest time between two lines of progress [s].
_EVERY_S = {True: 0.5, False: 10.0}

Version = Annotated[str | None, typer.Option("--version", help="Version of the dataset (default: the newest).")]
Scaling = Annotated[
    str | None, typer.Option("--normaliser", help="robust (default), std or quantile (to [-1, 1], clipped).")
]
Initial = Annotated[Path | None, typer.Option("--init", metavar="CHECKPOINT", help="Fine-tune this run or checkpoint.")]
ReadScene = Annotated[
    str | None,
    typer.Option("--scene", help="Scene that a model reads (particle, sim_residual); the recordings' by default."),
]
Repair = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Repair of the simulator that sim_residual reads.")
]
CommandNoise = Annotated[float, typer.Option("--command-noise", help="Noise on each command, 1 sd in its own unit.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def register(app: typer.Typer) -> None:
    """Add `train`."""
    app.command(
        epilog="Examples: candata train --data sim --model contact_diffusion --minutes 10 --out runs/first; "
        "candata train --data sim:0.7,real:0.3 --init runs/first --out runs/tuned"
    )(train)


@console.stoppable()
def train(
    data: Annotated[
        str, typer.Option("--data", metavar="DATASET", help="Dataset to train on, or several: sim:0.7,real:0.3.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder of the run; one that stands goes on.")],
    model: Annotated[
        str | None,
        typer.Option("--model", metavar="NAME", help="Such as contact_diffusion; an unknown name lists all."),
    ] = None,
    preset: Annotated[str | None, typer.Option("--preset", help="small (default), base or paper.")] = None,
    config: Annotated[Path | None, typer.Option("--config", metavar="FILE", help="YAML: fields that differ.")] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Length; 20000 without --minutes.")] = None,
    minutes: Annotated[float | None, typer.Option("--minutes", min=0.01, help="Length in time instead.")] = None,
    split: Annotated[str | None, typer.Option("--split", metavar="NAME", help="Stored split to train by.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**64 - 1, help="Of weights, order and noise.")] = 0,
    batch: Annotated[int, typer.Option("--batch", min=1, help="Windows a step.")] = 64,
    learning_rate: Annotated[
        float | None, typer.Option("--learning-rate", help="1e-4 by default, a tenth of it with --init.")
    ] = None,
    history: Annotated[int | None, typer.Option("--history", min=1, help="Rows of the past, default 8.")] = None,
    horizon: Annotated[int | None, typer.Option("--horizon", min=1, help="Steps to forecast, default 16.")] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Rate of the model's steps, default 10.")] = None,
    init: Initial = None,
    normaliser: Scaling = None,
    scene: ReadScene = None,
    effects: Repair = None,
    pose_noise_m: Annotated[float, typer.Option("--pose-noise-m", help="Shift of the object a window, 1 sd.")] = 0,
    pose_noise_rad: Annotated[float, typer.Option("--pose-noise-rad", help="Turn of the object a window, 1 sd.")] = 0,
    command_noise: CommandNoise = 0,
    device: Device = "cpu",
    threads: Threads = None,
    version: Version = None,
    json: Json = False,
) -> None:
    """Train a dynamics model; the same command goes on after a stop, to the bit on one CPU with --steps.

    Joints, actions, contact and object poses of the dataset's `train` episodes become windows at 10 Hz; the model
    learns to forecast the object's motion. Ctrl-C saves. `torchrun --nproc-per-node 2 -m candata_cli.main train ...`
    shares each batch among processes, with the same result.
    """
    from candata.training.runs import refuse_foreign

    check_output(out, "folder")
    refuse_foreign(out)
    need_torch()
    from candata.effects import read_effects
    from candata.training import TrainRequest

    set_threads(threads)
    noise = {"position_m": pose_noise_m, "rotation_rad": pose_noise_rad, "command": command_noise}
    settings = _settings(steps, minutes, seed, batch, learning_rate, init is not None, noise)
    mixture, paths = _sources(data, version)
    method: Any = normaliser
    repair = None if effects is None else read_effects(effects).effects
    request = TrainRequest(
        model, preset, _yaml(config), history, horizon, rate_hz, split, init, method, mixture, scene, repair
    )
    _run(request, settings, {name: (path, version) for name, path in paths.items()}, out, device, json)


def _simulating(stage: Callable[[str], None]) -> Callable[[int, int], None]:
    """Return what tells how far the simulator's forecasts are."""
    return lambda done_count, total: stage(f"simulating windows: {done_count:,} of {total:,}")


def _run(
    request: TrainRequest,
    settings: TrainingSettings,
    sources: Mapping[str, tuple[str, str | None]],
    out: Path,
    device: str,
    json: bool,
) -> None:
    """Train on the sources, folder or name and version of each, and print what stands; one process speaks."""
    from candata.training import prepare
    from candata.training import train as train_job
    from candata.training.memory import keep_freed_memory
    from candata.training.processes import joined

    keep_freed_memory()
    with (
        console.stoppable(lambda: _saved_text(out), goes_on=True),
        joined(device) as processes,
        _stages(processes.is_first) as stage,
    ):
        stage("reading the dataset")
        datasets = {name: console.open_named(path, version) for name, (path, version) in sources.items()}
        sources_read = datasets if request.mixture else datasets[""]
        job = prepare(sources_read, request, settings, device, processes, _simulating(stage))
        if processes.is_first:
            _tell_notes(job, stage)
        if request.init is not None:
            stage(f"fine-tuning {request.init} at a rate of {settings.learning_rate:g}")
        with _stop_on_interrupt() as should_stop:
            progress = train_job(job, out, _teller(stage), should_stop)
    if not processes.is_first:
        return
    if settings.share(progress.step, progress.elapsed_s) < 1:
        raise console.StoppedRun(f"saved at step {progress.step} in {out}", goes_on=True)
    _print_trained(job, progress, out, list(sources.values())[-1][0], json)


def _stages(speaks: bool) -> AbstractContextManager[Callable[[str], None]]:
    """Return what tells the stages of the command, or tells nothing: of several processes one speaks."""
    return console.stages() if speaks else nullcontext(lambda _text: None)


def _tell_notes(job: TrainingJob, stage: Callable[[str], None]) -> None:
    """Tell what the job notes, and how many values the normaliser clips."""
    for note in job.notes:
        console.note(note)
    if clip_counts := job.run.normaliser.get("clipped"):
        values = ", ".join(f"{name} {count:,}" for name, count in clip_counts.items())
        stage(f"values clipped of {job.run.normaliser['rows']:,} rows: {values}")


def _saved_text(out: Path) -> str:
    """Return what a run that was stopped outside of its loop has saved, as a clause."""
    from candata.training.checkpoint import LAST_FILE

    return f"the last checkpoint stands in {out}" if (out / LAST_FILE).is_file() else "nothing was trained yet"


def _sources(data: str, version: str | None) -> tuple[Mixture | None, dict[str, str]]:
    """Return the mixture that `--data` tells, None for one dataset, and the folder or name of each source."""
    if ":" not in data or Path(data).exists():
        return None, {"": data}
    from candata.errors import UsageError
    from candata.loaders import Mixture, parse_mixture

    stated_mixture = parse_mixture(data)
    paths = {Path(name).name: name for name in stated_mixture.names}
    if len(paths) < len(stated_mixture.names):
        raise UsageError("two datasets of a mixture have one name", found=data, fix="give their folders other names")
    if version is not None:
        raise UsageError("--version is of one dataset", found=data, fix="leave --version out")
    return Mixture(names=tuple(paths), parts=stated_mixture.parts), paths


def _settings(
    steps: int | None,
    minutes: float | None,
    seed: int,
    batch: int,
    learning_rate: float | None,
    fine_tune: bool,
    noise: dict[str, float],
) -> TrainingSettings:
    """Return the settings of the run."""
    from candata.errors import UsageError
    from candata.loaders import Augmentation
    from candata.training import TrainingSettings
    from candata.training.settings import FINE_TUNE_SHARE

    defaults = TrainingSettings()
    if learning_rate is None:
        learning_rate = defaults.learning_rate * (FINE_TUNE_SHARE if fine_tune else 1)
    if not 0 < learning_rate < 1:
        raise UsageError("--learning-rate is out of range", expected="between 0 and 1", found=f"{learning_rate:g}")
    length = steps if steps or minutes else defaults.steps
    augment = Augmentation.parse(noise, "noise of poses and commands")
    return TrainingSettings(
        seed=seed, batch=batch, steps=length, minutes=minutes, learning_rate=learning_rate, augment=augment
    )


def _yaml(path: Path | None) -> dict[str, Any] | None:
    """Return the fields of a model's configuration that a file gives."""
    if path is None:
        return None
    from candata.errors import UsageError, Where
    from candata.schema.yaml_text import read_yaml

    fields = read_yaml(path, "--config")
    if not isinstance(fields, dict):
        raise UsageError("--config holds no fields", expected="name: value", where=Where(path=str(path)))
    return fields


@contextmanager
def _stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C was pressed; a second press stops at once."""
    interrupts: list[int] = []

    def on_first(number: int, _frame: object) -> None:
        interrupts.append(number)
        signal.signal(signal.SIGINT, handler)

    handler = signal.signal(signal.SIGINT, on_first)
    try:
        yield lambda: bool(interrupts)
    finally:
        signal.signal(signal.SIGINT, handler)


def _teller(stage: Callable[[str], None]) -> Callable[[TrainingReport], None]:
    """Return what turns reports into lines, not more of them than can be read."""
    import sys
    import time

    told_s = -1e9

    def tell(report: TrainingReport) -> None:
        nonlocal told_s
        if time.monotonic() - told_s < _EVERY_S[sys.stderr.isatty()]:
            return
        told_s = time.monotonic()
        losses = ", ".join(f"{name} {value:.4f}" for name, value in report.losses.items())
        stage(
            f"{100 * report.share:.0f} %, step {report.step}: {losses or 'no finite loss'}; "
            f"{report.windows_per_s:,.0f} windows/s, {100 * report.wait_share:.1f} % waiting for data"
        )

    return tell


def _print_trained(job: TrainingJob, progress: Progress, out: Path, data: str, json: bool) -> None:
    """Print what stands now."""
    from candata.loaders import share_report

    sources = job.effective(progress.step)
    if json:
        shares = [share.model_dump(mode="json") for share in sources]
        console.out_json(
            {"run": str(out), "model": job.run.model, **progress.model_dump(mode="json"), "sources": shares}
        )
        return
    best_text = (
        "no held-out episodes"
        if progress.best_loss is None
        else (f"least held-out loss {progress.best_loss:.4f} at step {progress.best_step}")
    )
    skipped_text = f", {progress.skipped} steps skipped: not finite" if progress.skipped else ""
    console.out(
        f"{out}: {job.run.model}, {progress.step} steps in {progress.elapsed_s:.0f} s, {best_text}{skipped_text}"
    )
    if sources:
        console.out(share_report(sources))
    console.note(f"next: candata evaluate {out} {data}")
