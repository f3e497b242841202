"""All that changes in a run: weights, their average, the optimiser's moments, progress."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch

from candata.models import WindowGenerators
from candata.training import checkpoint, ema
from candata.training.settings import Progress, TrainingSettings


@dataclass
class TrainingState:
    """What a checkpoint keeps.

    Attributes
    ----------
    module : torch.nn.Module
        The model.
    parameters : list of Parameter
        What of it is trained.
    weights : dict of str to Tensor
        Its weights and buffers, the memory they share with it: they change as it trains.
    average : dict of str to Tensor
        Moving average of its weights, which is what is evaluated.
    optimiser : torch.optim.AdamW
        With its moments.
    progress : Progress
        How far the run has come.
    """

    module: torch.nn.Module
    parameters: list[torch.nn.Parameter]
    weights: dict[str, torch.Tensor]
    average: dict[str, torch.Tensor]
    optimiser: torch.optim.AdamW
    progress: Progress

    def advance(self, **changes: object) -> None:
        """Change fields of the progress."""
        self.progress = self.progress.model_copy(update=changes)

    def groups(self) -> dict[str, dict[str, torch.Tensor]]:
        """Return the tensors that a checkpoint keeps."""
        moments = {
            f"{index}/{name}": value
            for index, entry in self.optimiser.state_dict()["state"].items()
            for name, value in entry.items()
        }
        return {
            checkpoint.WEIGHTS: self.weights,
            checkpoint.AVERAGE: self.average,
            checkpoint.OPTIMISER: moments,
        }

    def restore(self, source: checkpoint.Checkpoint) -> None:
        """Take everything from a checkpoint of the same run."""
        self.module.load_state_dict(source.tensors(checkpoint.WEIGHTS))
        for name, value in source.tensors(checkpoint.AVERAGE).items():
            self.average[name].copy_(value)
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in source.tensors(checkpoint.OPTIMISER).items():
            index, key = name.split("/")
            parameter = self.parameters[int(index)]
            # The fused optimiser reads moments in the order in which the weights lie in memory.
            moment = torch.empty_like(parameter).copy_(value) if value.shape == parameter.shape else value
            moments.setdefault(int(index), {})[key] = moment
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": moments, "param_groups": groups})
        self.progress = source.progress


def initial_state(module: torch.nn.Module, settings: TrainingSettings) -> TrainingState:
    """Return the state at step 0 of a run that begins with the weights of `module`."""
    parameters = list(module.parameters())
    optimiser = torch.optim.AdamW(
        parameters,
        lr=settings.learning_rate,
        betas=settings.betas,
        weight_decay=settings.weight_decay,
        fused=True,
    )
    weights = {name: value.detach() for name, value in module.state_dict().items()}
    return TrainingState(module, parameters, weights, ema.start_average(weights), optimiser, Progress())


def generator(device: str, *key: int) -> torch.Generator:
    """Return a generator whose stream the key (seed, step, ...) fixes."""
    return torch.Generator(device).manual_seed(_seed(key))


def window_generators(device: str, key: tuple[int, ...], numbers: Iterable[int]) -> WindowGenerators:
    """Return a generator for windows with these numbers, whose streams the key and the number fix."""
    made = WindowGenerators(device)
    made.manual_seed(_seed(key))
    made.each = tuple(generator(device, *key, int(number)) for number in numbers)
    return made


def _seed(key: tuple[int, ...]) -> int:
    """Return the seed of torch that a key fixes."""
    return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0]) >> 1
