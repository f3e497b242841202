"""One process or several that train one model together, as `torchrun` starts them.

Each takes its rows of every batch. Their gradients are averaged in one sum over all processes, so all hold the same
weights bit for bit, and the first one alone writes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass

import torch
from torch import distributed

from candata.errors import SetupError, UsageError
from candata.models import Share, sharing

#: What `torchrun` tells each process; `torch.distributed` reads them. Source: torch.distributed, "env://".
_VARIABLES = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")


@dataclass(frozen=True)
class Processes:
    """The processes of a run.

    Attributes
    ----------
    rank, world : int
        Number of this one, and how many there are.
    device : str
        Where sums are made: `cpu` or `cuda`.
    """

    rank: int = 0
    world: int = 1
    device: str = "cpu"

    @property
    def is_first(self) -> bool:
        """Whether this is the process that writes and speaks."""
        return self.rank == 0

    def rows(self, batch: int) -> int:
        """Return how many windows of a batch each process takes.

        Raises
        ------
        UsageError
            When they cannot be equally many.
        """
        if batch % self.world:
            raise UsageError(
                "the batch does not divide among the processes",
                expected=f"--batch: a multiple of {self.world}",
                found=str(batch),
            )
        return batch // self.world

    def sharing(self) -> AbstractContextManager[None]:
        """Return the context in which a loss is that of this process's rows, and the mean over all that of a batch."""
        return nullcontext() if self.world == 1 else sharing(Share(self.rank, self.world, self.total))

    def total(self, value: torch.Tensor) -> torch.Tensor:
        """Return the sum over all processes, the same bits in each.

        Raises
        ------
        SetupError
            When one of them has ended.
        """
        if self.world == 1:
            return value
        value = value.clone()
        try:
            distributed.all_reduce(value)
        except RuntimeError as error:
            raise SetupError(
                "a process of the run has ended",
                found=str(error).splitlines()[0],
                fix="see its message; the same torchrun command goes on from the last checkpoint",
            ) from None
        return value

    def average(self, tensors: Sequence[torch.Tensor]) -> None:
        """Replace each tensor by its mean over all processes, in one sum; what is not finite in one is so in all."""
        if self.world == 1:
            return
        flat = self.total(torch.cat([tensor.flatten() for tensor in tensors])).div_(self.world)
        for tensor, mean in zip(tensors, flat.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(mean.view(tensor.shape))

    def agree(self, should_stop: bool, elapsed_s: float) -> tuple[bool, float]:
        """Return whether any process should stop, and the time that the first one counts [s]."""
        if self.world == 1:
            return should_stop, elapsed_s
        values = torch.tensor([should_stop, elapsed_s * self.is_first], dtype=torch.float64, device=self.device)
        stops, first_elapsed_s = self.total(values).tolist()
        return bool(stops), first_elapsed_s

    @contextmanager
    def first_begins(self) -> Iterator[None]:
        """Let the others wait until the first process has done what is within.

        Raises
        ------
        SetupError
            In the others, when the first one fails.
        """
        failures = 1.0
        try:
            yield
            failures = 0.0
        finally:
            failed = bool(self.total(torch.tensor(failures, device=self.device)).item())
        if failed:
            raise SetupError("the first process of the run could not begin", fix="see its message")


ALONE = Processes()


@contextmanager
def joined(device: str) -> Iterator[Processes]:
    """Join the processes that `torchrun` has started, by gloo on CPUs and NCCL on GPUs; alone without it.

    On GPUs each process takes the one of its number on its machine.

    Raises
    ------
    SetupError
        When they do not find each other.
    """
    if any(name not in os.environ for name in _VARIABLES) or os.environ["WORLD_SIZE"] == "1":
        yield ALONE
        return
    has_gpu = device == "cuda" and torch.cuda.is_available()
    if has_gpu:
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    try:
        distributed.init_process_group("nccl" if has_gpu else "gloo")
    except (RuntimeError, ValueError) as error:
        raise SetupError(
            "the processes do not find each other",
            found=str(error).splitlines()[0],
            fix="start them with torchrun; see docs/training.md",
        ) from None
    try:
        yield Processes(distributed.get_rank(), distributed.get_world_size(), "cuda" if has_gpu else "cpu")
    finally:
        distributed.destroy_process_group()
