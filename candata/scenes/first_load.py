"""The first load of a user's model, in a process of its own: a model may crash MuJoCo, keep it busy or fill the memory.

A model whose first load ended well is known by the SHA-256 of its files, in the user's cache folder, and is loaded
directly from then on. Nothing but that is kept: a cache that is missing, damaged, another's or not to be written costs
another first load.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple

import mujoco

from candata.errors import SceneError, SetupError, UsageError, Where
from candata.scenes.named_files import model_digest
from candata.user_folders import user_cache

#: Processor time that a first load may take [s], all threads together. Chosen: the most that `model_text` lets through
#: takes 8 s, and a user should not wait longer for an error. Processor time, as other programs do not count in it.
LIMIT_S, LIMIT_S_VARIABLE = 20.0, "CANDATA_MODEL_SECONDS"
#: Time by the clock that it may take, over its processor time: what waits, or has a small share of a processor.
CLOCK_RATIO = 3.0
#: Memory that a first load may take [bytes], where the system can bound it (Linux). Chosen: the most that `model_text`
#: lets through takes 1.6 GB.
LIMIT_BYTES, LIMIT_GB_VARIABLE = 4_000_000_000, "CANDATA_MODEL_GB"
#: Time that the process may take to start [s]: a Python with mujoco, 0.3 s on a quiet machine.
START_S = 60.0
#: Time after which a user is told what takes so long [s].
QUIET_S = 2.0
#: Models that are remembered; beyond it those loaded first longest ago are forgotten. A file of 64 bytes each.
MOST_KNOWN = 10_000
#: Raised when a first load tries more than it did.
_TRIAL = 1
_START = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from candata.scenes.first_load_process import main
main(*sys.argv[2:])
"""
_LOG = logging.getLogger(__name__)

#: What a model undergoes in each stage that the process tells of.
_AT: dict[str, str] = {"read": "is read", "compile": "is compiled", "step": "is stepped for the first time"}


class LoadLimits(NamedTuple):
    """What a first load may take: processor time, time by the clock, and memory."""

    cpu_s: float
    clock_s: float
    room_bytes: int


def load_first(path: Path) -> None:
    """Return nothing once it is known that a model can be loaded, or refused, by MuJoCo in this process.

    Raises
    ------
    DataError
        When the model, or a file that it names, is a Git LFS pointer.
    SceneError
        When it crashes MuJoCo, takes more time or memory than the limits, or cannot be stepped.
    SetupError
        When no process can be started.
    UsageError
        When a limit that the user sets is no number.
    """
    digest = _digest(path)
    if not _is_known(digest) and _in_process(path, _limits()):
        _remember(digest)


def vouch(path: Path) -> None:
    """Let a model be known that candata itself wrote: it needs no first load."""
    _remember(_digest(path))


def _digest(path: Path) -> str:
    """Return what a model is known by: its files, and what loaded them."""
    return hashlib.sha256(f"{model_digest(path)} {mujoco.__version__} {_TRIAL}".encode()).hexdigest()


def _record(digest: str) -> Path:
    """Return the file that stands for a known model."""
    return user_cache() / "models" / digest


def _is_known(digest: str) -> bool:
    """Tell whether a model was loaded before."""
    try:
        return _record(digest).read_bytes() == digest.encode()
    except (OSError, RuntimeError):
        return False


def _remember(digest: str) -> None:
    """Let a model be known; where that cannot be kept, it is loaded first again."""
    with contextlib.suppress(OSError, RuntimeError):
        record = _record(digest)
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_bytes(digest.encode())
        records = list(record.parent.iterdir())
        if len(records) > MOST_KNOWN:
            records.sort(key=lambda file: file.stat().st_mtime)
            for file in records[: len(records) - MOST_KNOWN]:
                file.unlink(missing_ok=True)


def _limits() -> LoadLimits:
    """Return the limits, or those that the user sets."""
    cpu_s = _set_by_user(LIMIT_S_VARIABLE, LIMIT_S)
    return LoadLimits(cpu_s, CLOCK_RATIO * cpu_s, int(1e9 * _set_by_user(LIMIT_GB_VARIABLE, LIMIT_BYTES / 1e9)))


def _set_by_user(variable: str, default: float) -> float:
    """Return the number of an environment variable, or the one that stands."""
    text = os.environ.get(variable)
    if not text:
        return default
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < 1e6:
        raise UsageError(f"{variable} is no limit", expected="a number above 0", found=repr(text))
    return number


def _in_process(path: Path, limits: LoadLimits) -> bool:
    """Tell whether a model was loaded in a process of its own; False where MuJoCo refused it with an error."""
    code, lines, complaint = _run(path, limits)
    stages = [line for line in lines if line in _AT]
    if not stages:
        raise SetupError(
            f"the process that loads model {path.name} first does not start",
            expected=f"{sys.executable} with mujoco, within {START_S:g} s",
            found=complaint or f"exit code {code}",
        )
    stage_text = _AT[stages[-1]]
    if lines[-1] in _AT:
        raise _crash_error(path, code, stage_text, limits)
    ending, text = json.loads(lines[-1])
    if ending == "memory":
        raise _limit_error(path, f"than {limits.room_bytes / 1e9:g} GB of memory", stage_text, LIMIT_GB_VARIABLE, text)
    if ending == "unusable":
        raise SceneError(f"model {path.name} cannot be simulated", found=text, where=Where(path=str(path)))
    return bool(ending == "loaded")


def _run(path: Path, limits: LoadLimits) -> tuple[int | None, list[str], str]:
    """Return how the process ended (None: it had to be ended), the lines that it said, and its last complaint."""
    # As this process finds its packages, so does that one: it may be isolated (-I), and have no folder to stand in.
    places = [str(Path(__file__).absolute().parents[2]), *(str(entry) for entry in sys.path if entry)]
    command = [sys.executable or "python", "-I", "-c", _START, json.dumps(places)]
    command += [os.path.abspath(path), *map(str, limits)]
    variables = {"MUJOCO_GL": "off", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    words = "model %s is loaded in a process of its own first, for at most %g s of processor time"
    note = threading.Timer(QUIET_S, _LOG.warning, (words, path.name, limits.cpu_s))
    note.daemon = True
    note.start()
    try:
        completed_process = subprocess.run(
            command,
            env=os.environ | variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=START_S + limits.clock_s,
            check=False,
            # Ctrl-C is for this process, which ends that one.
            start_new_session=True,
        )
        code, out, err = completed_process.returncode, completed_process.stdout, completed_process.stderr
    except subprocess.TimeoutExpired as late:
        code, out, err = None, late.stdout or b"", late.stderr or b""
    except OSError as error:
        code, out, err = None, b"", str(error).encode()
    finally:
        note.cancel()
    return code, out.decode(errors="replace").splitlines(), (err.decode(errors="replace").splitlines() or [""])[-1]


def _crash_error(path: Path, code: int | None, stage_text: str, limits: LoadLimits) -> SceneError:
    """Return the error of a model with which the process ended before its work."""
    if code is not None and -code == getattr(signal, "SIGPROF", 0):
        return _limit_error(path, f"than {limits.cpu_s:g} s of processor time", stage_text, LIMIT_S_VARIABLE)
    if code is None or -code == getattr(signal, "SIGALRM", 0):
        return _limit_error(path, f"than {limits.clock_s:g} s", stage_text, LIMIT_S_VARIABLE)
    if code == -getattr(signal, "SIGKILL", 9):
        ending = f"the system ended the process while the model {stage_text}, as it does where memory runs out"
    elif code < 0:
        ending = f"{signal.Signals(-code).name} while it {stage_text}"
    else:
        ending = f"it gave up while the model {stage_text}"
    return SceneError(
        f"model {path.name} crashes MuJoCo",
        expected="a model that MuJoCo loads",
        found=ending,
        where=Where(path=str(path)),
        fix="leave out parts of it until it loads: the last one left out is the cause",
    )


def _limit_error(path: Path, limit_text: str, stage_text: str, variable: str, text: str = "") -> SceneError:
    """Return the error of a model that takes more than a limit."""
    return SceneError(
        f"model {path.name} takes more {limit_text} while it {stage_text}",
        found=text or None,
        where=Where(path=str(path)),
        fix=f"make it smaller (copies, bodies, meshes, height fields, arena), or allow more: {variable}=NUMBER",
    )
