"""Faults of recordings that hold for any hand, and what is found of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from candata.effects import effect, effect_names, setting
from candata.gap.data.recordings import recordings
from candata.gap.mismatch.check import mismatch
from candata.gap.mismatch.sensors import tips
from candata.gap.replay.replayer import Replayer
from candata.scenes import Scene
from candata.schema.episode import Episode
from candata.simulate.seal import draw_parameter

Change = Callable[[Scene, Episode], dict[str, np.ndarray]]


def changed(scene: Scene, episodes: Sequence[Episode], change: Change) -> list[Episode]:
    """Episodes with some channels replaced; contact flags go, as they follow from forces."""
    kept = [{k: v for k, v in e.arrays.items() if not k.endswith("contact")} for e in episodes]
    return [Episode(e.meta, k | change(scene, e)) for e, k in zip(episodes, kept, strict=True)]


def channel(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda scene, e: {name: change(np.array(e[name], float))}


def columns(name: str, joints: Sequence[int], change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def one(values: np.ndarray) -> np.ndarray:
        values[:, joints] = change(values[:, joints])
        return values

    return channel(name, one)


def later(rows: int) -> Change:
    """Commands that are logged some rows late."""
    return channel("action", lambda a: np.concatenate([np.repeat(a[:1], rows, axis=0), a[:-rows]]))


def to_world(scene: Scene, e: Episode) -> dict[str, np.ndarray]:
    frames = tips(scene, np.array(e["joint_position"]))[1]
    return {"fingertip_force": np.einsum("nfij,nfj->nfi", frames, e["fingertip_force"])}


def frozen(scene: Scene, e: Episode) -> dict[str, np.ndarray]:
    return {c: np.repeat(e[c][:1], len(e), axis=0) for c in ("action", "joint_position", "object_pose")}


MILLI = np.r_[1e3, 1e3, 1e3, 1, 1, 1, 1]
#: Faults of any hand with forces: what is done to the recording, and the kind of finding.
FAULTS: dict[str, tuple[Change, str]] = {
    "later 1": (later(1), "shifted_commands"),
    "later 3": (later(3), "shifted_commands"),
    "dead": (channel("joint_position", lambda q: 0 * q + q[:1]), "dead_joint"),
    "millimetres": (channel("object_pose", lambda p: p * MILLI), "pose_unit"),
    "under the table": (channel("object_pose", lambda p: p - np.r_[0, 0, 0.8, 0, 0, 0, 0]), "pose_frame"),
    "beside the hand": (channel("object_pose", lambda p: p + np.r_[0.6, 0, 0, 0, 0, 0, 0]), "pose_frame"),
    "force sign": (channel("fingertip_force", np.negative), "force_sign"),
    "force in world": (to_world, "force_frame"),
    "force turned": (channel("fingertip_force", lambda f: f[..., [2, 0, 1]]), "force_frame"),
    "force in mN": (channel("fingertip_force", lambda f: 1e3 * f), "force_unit"),
    "force in gf": (channel("fingertip_force", lambda f: f / 9.80665e-3), "force_unit"),
    "force in kgf": (channel("fingertip_force", lambda f: f / 9.80665), "force_unit"),
}


def found(scene: Scene, episodes: Sequence[Episode]) -> list[tuple[str, bool]]:
    return [(f.kind, f.definite) for f in mismatch(Replayer(scene), recordings(scene, episodes))]


def drawn(scene: Scene, name: str, seed: int):
    """An effect at its drawn size, on one element where the seed is odd."""
    rng = np.random.default_rng([effect_names().index(name), seed])
    values = np.concatenate([draw_parameter(p, scene, rng) for p in effect(name).parameters])
    parts = effect(name).elements(scene)
    return setting(name, values, scene, str(rng.choice(parts)) if seed % 2 and len(parts) > 1 else None)
