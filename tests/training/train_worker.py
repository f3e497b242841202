"""Trains the tiny model of the tests in a process that can be killed: `train_worker.py FOLDER STEPS`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from conftest import make_batch, make_job

from candata.training.loop import train


def slowly(step):
    """The same batches, slowly enough to be killed on the way."""
    time.sleep(0.01)
    return make_batch(step)


if __name__ == "__main__":
    train(make_job(slowly, steps=int(sys.argv[2])), Path(sys.argv[1]))
