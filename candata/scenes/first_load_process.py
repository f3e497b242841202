"""What the process of a first load does: it reads a model, compiles and steps it, within its limits.

It says each stage in a line of its own before it begins, and in the last line, as JSON, how it ended and why.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from candata.errors import CandataError
from candata.scenes.model_file import MODEL_ERRORS, parse_model, without_log

#: Steps that are tried. Chosen: what keeps a solver busy does so as soon as there is contact; ten take no time.
STEPS = 10
#: What MuJoCo 4.0.0 says where memory does not suffice: itself, by its reader of pictures, and of what C++ throws.
_WANTS_MEMORY = (
    *("could not allocate", "failed to allocate", "allocation failed", "insufficient memory"),
    *("bad_alloc", "unknown exception"),
)

Stage = Literal["read", "compile", "step"]
#: Loaded; refused with an error that reading the model again repeats; out of memory; or of no use to a simulation.
Ending = Literal["loaded", "refused", "memory", "unusable"]


def main(path: str, cpu_s: str, clock_s: str, room_bytes: str) -> None:
    """Load a model, and say on stdout how that goes."""
    words = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    _set_limits(float(cpu_s), float(clock_s), int(room_bytes))

    def say(line: str) -> None:
        words.write(f"{line}\n")
        words.flush()

    with without_log():
        say(json.dumps(_load(Path(path), say)))


def _set_limits(cpu_s: float, clock_s: float, room_bytes: int) -> None:
    """Let the system end this process when its time is over, and refuse it memory beyond its room.

    Where Python has no `resource` (Windows), or the system counts no data (macOS), nothing bounds the memory.
    """
    if hasattr(signal, "setitimer"):
        for end, clock, seconds in (
            (signal.SIGPROF, signal.ITIMER_PROF, cpu_s),
            (signal.SIGALRM, signal.ITIMER_REAL, clock_s),
        ):
            signal.signal(end, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {end})
            signal.setitimer(clock, seconds)
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        hard_limit = resource.getrlimit(resource.RLIMIT_DATA)[1]
        data_limit = room_bytes if hard_limit == resource.RLIM_INFINITY else min(room_bytes, hard_limit)
        resource.setrlimit(resource.RLIMIT_DATA, (data_limit, hard_limit))


def _load(path: Path, say: Callable[[Stage], None]) -> tuple[Ending, str]:
    """Return how loading a model ended, and the words of its error."""
    say("read")
    try:
        spec = parse_model(path)
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # as scenes are compiled: it decides the memory
        say("compile")
        model = spec.compile()
    except (CandataError, *MODEL_ERRORS) as error:
        text = " ".join((error.problem if isinstance(error, CandataError) else str(error)).split())
        wants = isinstance(error, MemoryError) or any(word in text.lower() for word in _WANTS_MEMORY)
        return "memory" if wants else "refused", text
    say("step")
    try:
        fault = _fault(model)
    except MemoryError as error:
        return "memory", str(error)
    except MODEL_ERRORS as error:
        return "unusable", " ".join(str(error).split())
    return ("unusable", fault) if fault else ("loaded", "")


def _fault(model: mujoco.MjModel) -> str:
    """Return why a model cannot be stepped from the state in which it begins; empty where it can.

    A state that is lost later is no fault: recordings begin elsewhere, and an unstable simulation is told of by name.
    """
    if not 0 < model.opt.timestep < np.inf:
        return ""  # refused with the control rate beside it
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for values, quantity in ((data.xpos, "positions of bodies"), (data.geom_xpos, "positions of geoms")):
        if not np.isfinite(values).all():
            return f"{quantity} that are not finite numbers, in the state in which the model begins"
    if not np.isfinite(data.qacc).all():
        return "accelerations that are not finite numbers, in the state in which the model begins"
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    return ""
