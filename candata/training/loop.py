"""The training loop: one step after another, guarded against NaN, saved so that a killed run goes on bit for bit."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from candata.errors import DataError, Where
from candata.loaders import Effective
from candata.models import Batch
from candata.schema.record import Record
from candata.training import checkpoint, ema, runs
from candata.training.checkpoint import Checkpoint
from candata.training.processes import ALONE, Processes
from candata.training.settings import Progress, Run, TrainingSettings
from candata.training.state import TrainingState, generator, initial_state
from candata.training.steplog import StepLog

#: Second part of the key of a noise stream: each use has its own.
_NOISE, _HELD_OUT = 1, 2


@dataclass(frozen=True)
class TrainingJob:
    """What to train on what.

    Attributes
    ----------
    run : Run
        Settings and facts.
    module : torch.nn.Module
        The model with its first weights, on its device.
    draw : callable
        Step to batch, on the device; the same step gives the same batch.
    held_out : sequence of Batch
        Batches of the validation loss; empty for none.
    device : str
        `cpu` or `cuda`.
    split : Record or None
        Who trains, kept in the run's folder.
    effective : callable
        Steps to what each source of a mixture really gave by then; empty for one dataset.
    notes : tuple of str
        What people should know before it begins.
    processes : Processes
        Those that train together; `draw` gives the rows of this one.
    settle : callable or None
        Called at the end with the best checkpoint; returns its averaged weights with what is chosen on the validation
        episodes, which replace them. None where nothing is.
    """

    run: Run
    module: Any  # a torch.nn.Module with `losses`; mypy knows no intersection
    draw: Callable[[int], Batch]
    held_out: Sequence[Batch] = ()
    device: str = "cpu"
    split: Record | None = None
    effective: Callable[[int], tuple[Effective, ...]] = lambda _steps: ()
    notes: tuple[str, ...] = ()
    processes: Processes = ALONE
    settle: Callable[[Checkpoint], Mapping[str, torch.Tensor]] | None = None


@dataclass(frozen=True)
class TrainingReport:
    """What the loop tells after a few steps.

    Attributes
    ----------
    step : int
        Steps done.
    share : float
        Share of the run that is done.
    losses : dict of str to float
        Means since the last report.
    windows_per_s : float
        Windows trained on each second since then, by all processes.
    wait_share : float
        Share of that time spent on getting batches.
    """

    step: int
    share: float
    losses: dict[str, float]
    windows_per_s: float
    wait_share: float


@dataclass
class _LogTally:
    """Sums since the last line of the log."""

    losses: dict[str, float] = field(default_factory=dict)
    norm: float = 0.0
    finite_steps: int = 0
    steps: int = 0
    wait_s: float = 0.0
    since_s: float = field(default_factory=time.perf_counter)

    def add(self, losses: dict[str, float], norm: float) -> None:
        """Add a good step."""
        for name, value in losses.items():
            self.losses[name] = self.losses.get(name, 0.0) + value
        self.norm += norm
        self.finite_steps += 1

    def means(self) -> dict[str, float]:
        """Return the mean losses; empty when no step was good."""
        return {name: value / self.finite_steps for name, value in self.losses.items()}


def train(
    job: TrainingJob,
    folder: Path,
    tell: Callable[[TrainingReport], None] = lambda _report: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Progress:
    """Train to the end of the run, going on from its last checkpoint, and return how far it has come.

    Several processes train as one would on the same batches, whatever their number; the first one writes.

    Parameters
    ----------
    job : Job
        What to train on what.
    folder : Path
        The run's folder; made when missing.
    tell : callable
        Called with a Report after a few steps.
    should_stop : callable
        Asked before each step; True saves and returns early.

    Raises
    ------
    UsageError
        When the folder holds another run, or another process trains into it.
    DataError
        When the loss or its gradient is not finite `bad_limit` times in a row; the last checkpoint stays.
    SetupError
        When the folder cannot be written, or another process has ended; the last checkpoint stays.
    """
    with ExitStack() as written:
        with job.processes.first_begins():
            if job.processes.is_first:
                written.enter_context(runs.writing(folder))
                runs.begin(folder, job.run, job.split)
        return _train(job, folder, tell, should_stop)


def _train(
    job: TrainingJob, folder: Path, tell: Callable[[TrainingReport], None], should_stop: Callable[[], bool]
) -> Progress:
    """Train to the end of the run, or until told to stop."""
    state = initial_state(job.module, job.run.settings)
    if (folder / checkpoint.LAST_FILE).is_file():
        state.restore(checkpoint.read(folder / checkpoint.LAST_FILE))
    settings, tally = job.run.settings, _LogTally()
    if not job.processes.is_first:
        while _goes_on(job, state, should_stop):
            _step(job, state, tally, folder)
        return state.progress
    _keep_best(state, folder)  # a kill may have come between the two
    saved_step = state.progress.step
    with StepLog(folder, saved_step) as log:
        saved_s = time.perf_counter()
        while _goes_on(job, state, should_stop):
            _step(job, state, tally, folder)
            step = state.progress.step
            if step % settings.log_every == 0:
                tell(_report(job, state, tally, log))
                tally = _LogTally()
            at_end = settings.share(step, state.progress.elapsed_s) >= 1
            if at_end or step % settings.validate_every == 0:
                _validate(job, state, folder, log)
            elif time.perf_counter() - saved_s < settings.save_every_s:
                continue
            saved_step, saved_s = step, time.perf_counter()
            _save(job, state, folder)
        if saved_step < state.progress.step:
            _save(job, state, folder)
    if settings.share(state.progress.step, state.progress.elapsed_s) >= 1:
        _settle(job, folder)
    return state.progress


def _goes_on(job: TrainingJob, state: TrainingState, should_stop: Callable[[], bool]) -> bool:
    """Return whether a step is left and no process should stop; all count the time of the first."""
    stops, elapsed_s = job.processes.agree(should_stop(), state.progress.elapsed_s)
    state.advance(elapsed_s=elapsed_s)
    return not stops and job.run.settings.share(state.progress.step, elapsed_s) < 1


def _step(job: TrainingJob, state: TrainingState, tally: _LogTally, folder: Path) -> None:
    """Take one step; one without a finite loss and gradient changes nothing but the counts."""
    settings, progress, began = job.run.settings, state.progress, time.perf_counter()
    batch = job.draw(progress.step)
    tally.wait_s += time.perf_counter() - began
    if not job.module.training:  # to say it to every part each step takes half a millisecond
        job.module.train()
    with job.processes.sharing():
        losses = job.module.losses(batch, generator(job.device, settings.seed, _NOISE, progress.step))
    for parameter in state.parameters:
        parameter.grad = None
    losses["loss"].backward()
    gradient = [parameter.grad for parameter in state.parameters if parameter.grad is not None]
    terms = torch.stack([value.detach() for value in losses.values()])
    job.processes.average([*gradient, terms])
    norm = _clip(gradient, settings.clip_norm)
    values = dict(zip(losses, terms.tolist(), strict=True))
    is_finite = math.isfinite(values["loss"]) and math.isfinite(norm)
    if is_finite:
        for group in state.optimiser.param_groups:
            group["lr"] = settings.rate(progress.step, progress.elapsed_s)
        state.optimiser.step()
        updates = progress.step - progress.skipped
        ema.update(state.average, state.weights, updates, settings.ema_power)
        tally.add(values, norm)
    tally.steps += 1
    state.advance(
        step=progress.step + 1,
        elapsed_s=progress.elapsed_s + time.perf_counter() - began,
        skipped=progress.skipped + (not is_finite),
        bad_in_row=0 if is_finite else progress.bad_in_row + 1,
    )
    if state.progress.bad_in_row >= settings.bad_limit:
        raise _divergence_error(state.progress, settings, folder)


def _clip(gradient: list[torch.Tensor], largest_norm: float) -> float:
    """Return the norm of the gradient, which is scaled, in place, to at most `largest_norm`."""
    norm = float(torch.linalg.vector_norm(torch.stack(torch._foreach_norm(gradient))))
    if norm > largest_norm:
        torch._foreach_mul_(gradient, largest_norm / norm)
    return norm


def _report(job: TrainingJob, state: TrainingState, tally: _LogTally, log: StepLog) -> TrainingReport:
    """Return what to tell, and write the line of the log."""
    settings, progress = job.run.settings, state.progress
    spent_s = max(time.perf_counter() - tally.since_s, 1e-9)
    report = TrainingReport(
        progress.step,
        settings.share(progress.step, progress.elapsed_s),
        tally.means(),
        tally.steps * settings.batch / spent_s,
        tally.wait_s / spent_s,
    )
    log.write(
        step=progress.step,
        **report.losses,
        learning_rate=settings.rate(progress.step - 1, progress.elapsed_s),
        gradient_norm=tally.norm / tally.finite_steps if tally.finite_steps else None,
        windows_per_s=report.windows_per_s,
        wait_share=report.wait_share,
        elapsed_s=progress.elapsed_s,
        skipped=progress.skipped,
    )
    return report


@torch.no_grad()
def _validate(job: TrainingJob, state: TrainingState, folder: Path, log: StepLog) -> None:
    """Score the averaged weights on the held-out batches; the best so far is kept."""
    if not job.held_out:
        return
    began, module = time.perf_counter(), job.module.eval()
    module_weights = ema.start_average(module.state_dict())
    module.load_state_dict(state.average)
    sums: dict[str, float] = {}
    for number, batch in enumerate(job.held_out):
        # The same noise each time, so that two validations differ by the weights alone.
        noise = generator(job.device, job.run.settings.seed, _HELD_OUT, number)
        for name, value in module.losses(batch, noise).items():
            sums[name] = sums.get(name, 0.0) + float(value)
    module.load_state_dict(module_weights)
    means = {name: value / len(job.held_out) for name, value in sums.items()}
    state.advance(elapsed_s=state.progress.elapsed_s + time.perf_counter() - began)
    log.write(step=state.progress.step, **{f"held_out_{name}": value for name, value in means.items()})
    best_loss = state.progress.best_loss
    if means["loss"] < (float("inf") if best_loss is None else best_loss):
        state.advance(best_loss=means["loss"], best_step=state.progress.step)


def _save(job: TrainingJob, state: TrainingState, folder: Path) -> None:
    """Write the last checkpoint, which may be the best one too."""
    checkpoint.save(folder / checkpoint.LAST_FILE, job.run, state.progress, state.groups())
    _keep_best(state, folder)


def _keep_best(state: TrainingState, folder: Path) -> None:
    """Give the last checkpoint the name of the best one when it is that."""
    if state.progress.best_step == state.progress.step:
        checkpoint.copy(folder / checkpoint.LAST_FILE, folder / checkpoint.BEST_FILE)


def _settle(job: TrainingJob, folder: Path) -> None:
    """Put into the best checkpoint what is chosen at the end."""
    if job.settle is None or not (folder / checkpoint.BEST_FILE).is_file():
        return
    best = checkpoint.read(folder / checkpoint.BEST_FILE)
    groups = {name: best.tensors(name) for name in (checkpoint.WEIGHTS, checkpoint.OPTIMISER)}
    groups[checkpoint.AVERAGE] = dict(job.settle(best))
    checkpoint.save(best.path, best.run, best.progress, groups)


def _divergence_error(progress: Progress, settings: TrainingSettings, folder: Path) -> DataError:
    """Return the error for a run that finds no finite loss any more."""
    return DataError(
        "training has diverged",
        expected="finite losses and gradients",
        found=f"{progress.bad_in_row} steps in a row without, up to step {progress.step}",
        where=Where(path=str(folder)),
        fix=f"lower --learning-rate (now {settings.learning_rate:g}) or look at the data with candata validate; "
        "the last good checkpoint stands",
    )
