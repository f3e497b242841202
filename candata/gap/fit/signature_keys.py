"""Under which names signatures are kept: of commands, scene, code and start, and which starts count as one."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from candata.gap.data.recordings import Recordings
from candata.gap.replay.replayer import EffectSet, Replayer
from candata.gap.replay.starts import Starts
from candata.gap.run import cache
from candata.scenes import Scene

#: Rooms whose code decides a signature.
CODE = ("align.py", "rotation.py", "effects", "scenes", "simulate")
#: Modules of this room that do.
OWN_CODE = (
    *("data/deviation", "data/noise", "data/robust_loss", "data/rounding", "data/sample_hold", "data/white_noise"),
    *("replay/hand_starts", "replay/memory", "replay/replayer", "replay/residuals", "replay/shooting"),
    *("replay/smoother", "replay/starts", "measure/floor", "fit/signature_keys", "fit/signatures", "run/streams"),
)
#: Differences of two starts of the same commands up to which they count as one: the object's place [m, m/s], and any
#: other coordinate [rad, rad/s or an element of a quaternion]. Chosen as wide as a biased sensor may be off: a start
#: decides when contact begins, hardly what an effect does but for a sensor at fault that read it.
SAME_PLACE, SAME_TURN = 0.02, 0.1


def share_signatures(replayer: Replayer, one: tuple[Recordings, Starts], other: tuple[Recordings, Starts]) -> bool:
    """Tell whether diagnoses of two sets of recordings share their signatures."""
    same = key_of_commands(replayer, *one) == key_of_commands(replayer, *other)
    return same and _is_same(replayer.scene, one[1], other[1])


def text_of(some: EffectSet) -> str:
    """Return what names an effect set."""
    return json.dumps([s.model_dump(mode="json") for s in some], sort_keys=True)


def key_of_commands(replayer: Replayer, recs: Recordings, begin: Starts) -> str:
    """Return the name of all signatures on the same commands in the same scene by the same code."""
    text = hashlib.sha256(f"{replayer.scene.digest}|{mujoco.__version__}|{_code()}|{recs.instant_force}".encode())
    text.update("|".join(recs.readings).encode())
    text.update("|".join(recs.sources).encode())
    supply = () if recs.supply is None else (recs.supply,)
    for values in (recs.commands, recs.lengths, begin.rows, *supply, *recs.sources.values()):
        text.update(f"{values.shape}".encode() + np.ascontiguousarray(values).tobytes())
    return text.hexdigest()[:32]


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a digest of the code that decides a signature."""
    root = Path(__file__).parents[2]
    rooms = [root / name for name in CODE]
    files = [f for room in rooms for f in ([room] if room.is_file() else sorted(room.rglob("*.py")))]
    files += [root / "gap" / f"{name}.py" for name in OWN_CODE]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


def content_of(recs: Recordings, begin: Starts) -> str:
    """Return what names recordings of given commands: what was read, and where their replay starts."""
    arrays = [*recs.compared.values(), *begin.arrays.values()]
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[:16]


def known_start(folder: Path, begin: Starts, scene: Scene) -> tuple[Path, Starts] | None:
    """Return the folder of signatures from the nearest start that counts as the same, and it; None where none does."""
    files = sorted(folder.glob("*/starts.npz")) if folder.is_dir() else ()
    read = [(file.parent, found) for file in files if (found := _start_in(file)) is not None]
    same = [(own, found) for own, found in read if _is_same(scene, found, begin)]
    nearest = min(same, key=lambda pair: float(np.abs(pair[1].qpos - begin.qpos).max()), default=None)
    if nearest is not None:
        cache.mark_used(nearest[0])
    return nearest


def new_start(folder: Path, begin: Starts) -> tuple[Path, Starts]:
    """Return a new folder for signatures from a start, and that start."""
    arrays = begin.arrays
    own = folder / hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays.values())).hexdigest()[:16]
    cache.mark_used(own)
    cache.keep(own / "starts.npz", **arrays)
    return own, begin


def _start_in(file: Path) -> Starts | None:
    """Return the start kept in a file; None where it cannot be read."""
    found = cache.read(file)
    return Starts(**found) if found else None


def _is_same(scene: Scene, one: Starts, other: Starts) -> bool:
    """Tell whether two sets of starts are close enough to share signatures."""
    if one.qpos.shape != other.qpos.shape or not np.array_equal(one.rows, other.rows):
        return False
    allowed, allowed_speed = np.full(one.qpos.shape[1], SAME_TURN), np.full(one.qvel.shape[1], SAME_TURN)
    if scene.object_id is not None:
        allowed[scene.object_qpos : scene.object_qpos + 3] = SAME_PLACE
        allowed_speed[scene.object_dof : scene.object_dof + 3] = SAME_PLACE
    return bool(
        (np.abs(one.qpos - other.qpos) <= allowed).all() and (np.abs(one.qvel - other.qvel) <= allowed_speed).all()
    )
