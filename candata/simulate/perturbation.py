"""What is drawn until an episode ends as it is wanted to: grip, aim and timing, further off with each attempt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.policies import Plan, carriers, command_range
from candata.scenes import Scene
from candata.schema.outcome import FAIL, SUCCESS

Array = NDArray[np.float64]
#: Attempts after which the draws are as wide as they get. Chosen: the first failures stay near a success.
WIDEST_ATTEMPT = 5
#: Widest draws: share of the closing that the fingers leave out, or add; distance of the object from its place [m];
#: share of the episode by which the fingers are early or late. Chosen so that on the built-in scenes a can and a carton
#: are missed, lost on the table and lost in the air (measured: tests/simulate/test_attempts.py).
GRIP_LESS, GRIP_MORE, AIM_M, TIMING_SHARE = 0.4, 0.3, 0.08, 0.4
#: Widest aim where a success is wanted, along each axis [m]. Chosen: about a finger's width.
NEAR_M = 0.02
#: Part of the episode in which early fingers get ahead, and late ones catch up: a grasp is to be closed by then.
SHIFT_FROM, SHIFT_TO = 0.3, 0.5
#: What is drawn for each wanted outcome; for any failure, each of these as often as not.
_GRIP, _AIM, _EARLY, _LATE = "grip", "aim", "early", "late"
_KINDS = (_GRIP, _AIM, _EARLY, _LATE)
_DRAWN = {"slip": (_GRIP,), "drop": (_GRIP, _EARLY), "miss": (_AIM,), "topple": (_AIM, _GRIP)}


@dataclass(frozen=True)
class Draw:
    """An attempt to make an episode end as wanted.

    Attributes
    ----------
    wanted : str
        The outcome: one of `candata.schema.outcome.WANTED`.
    attempt : int
        Its number, from 0; it seeds the plan too.
    grip_scale : float
        How far the fingers go of the way that the plan closes them.
    aim_x_m, aim_y_m : float
        How far from its planned place the object stands [m].
    lead_s : float
        Time by which the fingers are ahead of the plan from the middle of it on; behind it up to there where negative
        [s].
    """

    wanted: str
    attempt: int
    grip_scale: float = 1.0
    aim_x_m: float = 0.0
    aim_y_m: float = 0.0
    lead_s: float = 0.0

    def labels(self) -> dict[str, bool | int | float | str]:
        """Return what an episode keeps of the attempt, in its `labels`."""
        return {
            "wanted_outcome": self.wanted,
            "attempt": self.attempt,
            "grip_scale": self.grip_scale,
            "aim_x_m": self.aim_x_m,
            "aim_y_m": self.aim_y_m,
            "lead_s": self.lead_s,
        }

    @classmethod
    def kept(cls, labels: Mapping[str, bool | int | float | str]) -> Draw | None:
        """Return the attempt that an episode's `labels` hold; None where they hold none."""
        if "wanted_outcome" not in labels:
            return None
        return cls(
            str(labels["wanted_outcome"]),
            int(labels["attempt"]),
            *(float(labels[name]) for name in ("grip_scale", "aim_x_m", "aim_y_m", "lead_s")),
        )


def drawn(wanted: str, attempt: int, duration_s: float, rng: np.random.Generator) -> Draw:
    """Return an attempt; the first one at a success changes nothing of the plan.

    Parameters
    ----------
    wanted : str
        The outcome.
    attempt : int
        Number of the attempt, from 0.
    duration_s : float
        Length of the episode [s].
    rng : numpy.random.Generator
        Source of the draw.
    """
    width = min(1.0, (attempt + 1) / WIDEST_ATTEMPT)
    if wanted == SUCCESS:
        width = min(1.0, attempt / WIDEST_ATTEMPT)
        aim_x_m, aim_y_m = (NEAR_M * width * rng.uniform(-1, 1, 2) + 0.0).tolist()  # no minus zeros
        return Draw(wanted, attempt, 1 + GRIP_MORE * width * rng.random(), aim_x_m, aim_y_m)
    kinds = _DRAWN[wanted] if wanted != FAIL else [kind for kind in _KINDS if rng.random() < 0.5]
    grip, distance, timing = (width * rng.random(3)).tolist()
    heading = rng.uniform(0, 2 * np.pi)
    reach_m = AIM_M * distance if _AIM in kinds else 0.0
    sign = (_EARLY in kinds) - (_LATE in kinds)
    return Draw(
        wanted,
        attempt,
        grip_scale=1 - GRIP_LESS * grip if _GRIP in kinds else 1.0,
        aim_x_m=float(reach_m * np.cos(heading) + 0.0),
        aim_y_m=float(reach_m * np.sin(heading) + 0.0),
        lead_s=sign * TIMING_SHARE * duration_s * timing + 0.0,
    )


def perturbed(scene: Scene, plan: Plan, draw: Draw) -> Plan:
    """Return a plan with another grip, aim and timing; what carries the whole hand moves as planned."""
    commands, qpos = plan.commands.copy(), plan.qpos.copy()
    fingers = [column for column in range(commands.shape[1]) if column not in carriers(scene)]
    if fingers:
        track = _retimed(commands[:, fingers], draw.lead_s * scene.file.rate_hz)
        low, high = command_range(scene)[fingers].T
        commands[:, fingers] = np.clip(track[0] + draw.grip_scale * (track - track[0]), low, high)
    if scene.object_id is not None:
        qpos[scene.object_qpos : scene.object_qpos + 2] += (draw.aim_x_m, draw.aim_y_m)
    return replace(plan, commands=commands, qpos=qpos)


def _retimed(track: Array, lead_rows: float) -> Array:
    """Return commands `(T, A)` of fingers that are ahead by some rows from the middle on, or behind up to there."""
    rows = np.arange(len(track))
    share = np.clip((rows / max(len(track) - 1, 1) - SHIFT_FROM) / (SHIFT_TO - SHIFT_FROM), 0.0, 1.0)
    moved_rows = rows + lead_rows * (share if lead_rows > 0 else 1.0 - share)
    return track[np.clip(np.round(moved_rows).astype(int), 0, len(track) - 1)]
