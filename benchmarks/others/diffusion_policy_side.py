"""Diffusion Policy's own loader: ReplayBuffer in memory and SequenceSampler, alone and in a torch DataLoader.

    PYTHONPATH=REPOSITORY PYTHON benchmarks/others/diffusion_policy_side.py ZARR ROWS_AN_EPISODE HISTORY WINDOW BATCH

The Dataset around the sampler does what those of the repository do: one sequence, each array to torch.
"""

from __future__ import annotations

import sys
import time

import torch
from answers import Places, serve
from torch.utils.data import DataLoader, Dataset

KEYS = ("object_pose", "joint_position", "action", "fingertip_force", "fingertip_contact")


def main() -> None:
    """Read the buffer into memory and answer."""
    torch.set_num_threads(1)
    begin = time.process_time()
    from diffusion_policy.common.pytorch_util import dict_apply
    from diffusion_policy.common.replay_buffer import ReplayBuffer
    from diffusion_policy.common.sampler import SequenceSampler

    path, (rows, _history, window, batch) = sys.argv[1], map(int, sys.argv[2:])
    sampler = SequenceSampler(ReplayBuffer.copy_from_path(path, keys=list(KEYS)), window)

    class Sequences(Dataset):
        """One sequence a number."""

        def __len__(self) -> int:
            """Return the number of sequences."""
            return len(sampler)

        def __getitem__(self, number: int):
            """Return one sequence."""
            return dict_apply(sampler.sample_sequence(number), torch.from_numpy)

    def numbers(places: Places) -> list[int]:
        return [episode * (rows - window + 1) + first for episode, first in places]

    def loaded(places: Places):
        yield from DataLoader(Sequences(), batch_size=batch, sampler=numbers(places))

    def alone(places: Places):
        for number in numbers(places):
            yield {key: value[None] for key, value in sampler.sample_sequence(number).items()}

    ways = {"DataLoader": loaded, "SequenceSampler alone, no batch made": alone}
    serve("Diffusion Policy", ways, time.process_time() - begin)


if __name__ == "__main__":
    main()
