"""Candidate chunks at each start: what a policy would do, with noise, or the motions of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError
from candata.policies import Motion, Step, StepPolicy, command_limits
from candata.policy_evaluation.chunk_starts import ChunkStarts
from candata.policy_evaluation.commands import CommandBounds, candidate_motions
from candata.policy_evaluation.pilots import STEP_LIMIT_S, checked_begin
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.simulate import rollout
from candata.simulate.closed_loop import ClosedLoop, Pilot
from candata.training.simulator import past_observer
from candata.training.window_starts import commands_from, window_starts

Array = NDArray[np.float64]
#: Stream of a seed by which a start's candidates are drawn.
CANDIDATE_STREAM = 0
#: Name of the chunk without noise.
AS_PLANNED = "as planned"


@dataclass(frozen=True, eq=False)
class Candidates:
    """N chunks at each of S starts.

    Attributes
    ----------
    names : tuple of N str
        What they are called.
    commands : (S, N, R, A) float64
        At the scene's rate.
    playable : (S, N) bool
        Whether a chunk keeps the rate from the command before the start on.
    """

    names: tuple[str, ...]
    commands: Array
    playable: NDArray[np.bool_]


def noisy_candidates(
    planned: Array, starts: ChunkStarts, bounds: CommandBounds, count: int, share: float, seed: int
) -> Candidates:
    """Return planned chunks `(S, R, A)` and `count - 1` of each with smooth noise, within limits and rate.

    Parameters
    ----------
    planned : (S, R, A) float64
        What is done without noise.
    starts : ChunkStarts
        For the commands before.
    bounds : CommandBounds
        What may be commanded.
    count : int
        Chunks N at each start.
    share : float
        Noise at a knot, as a share of the standard deviation of the recorded commands.
    seed : int
        Of the noise, which a start draws whatever others there are.

    Raises
    ------
    UsageError
        When there are fewer than two candidates, or the planned commands are not finite.
    """
    if count < 2:
        raise UsageError("nothing to choose between", expected="at least 2 candidates", found=str(count))
    if not np.isfinite(planned).all():
        raise UsageError("the policy plans what is no number", expected="finite commands", found="NaN or infinite")
    rngs = [np.random.default_rng([seed, CANDIDATE_STREAM, number]) for number in starts.numbers]
    noise = bounds.noise(rngs, count, planned.shape[1], share)
    noise[:, 0] = 0.0
    commands = bounds.kept(planned[:, None] + noise, np.repeat(starts.previous[:, None], count, axis=1))
    names = (AS_PLANNED, *(f"noise {k}" for k in range(1, count)))
    return Candidates(names, commands, np.ones(commands.shape[:2], bool))


def motion_candidates(motions: Sequence[Motion], starts: ChunkStarts, bounds: CommandBounds, rows: int) -> Candidates:
    """Return the motions of a file as candidates of every start, unchanged.

    Raises
    ------
    UsageError
        When there are fewer than two.
    DataError
        When one holds what is no number, or goes beyond limits or rate.
    """
    bounds.check(motions)
    chunks = candidate_motions(motions, rows)
    commands = np.repeat(chunks[None], len(starts), axis=0)
    previous = np.repeat(starts.previous[:, None], len(motions), axis=1)
    return Candidates(tuple(motion.name for motion in motions), commands, bounds.is_playable(commands, previous))


def policy_chunks(policy: StepPolicy, scene: Scene, starts: ChunkStarts, rows: int, seed: int) -> Array:
    """Return what a closed loop commands `(S, rows, A)` from each start on in a simulation of the scene.

    Parameters
    ----------
    policy : StepPolicy
        What gives the commands; it begins at the start.
    scene : Scene
        What is simulated.
    starts : ChunkStarts
        Starts, whose past the simulation follows.
    rows : int
        Control steps.
    seed : int
        Of the policy.

    Raises
    ------
    DataError
        When the policy fails, takes too long, or gives what is no command.
    """
    windows = starts.native(rows).windows
    batch = windows.batch(np.arange(len(starts)))
    start = window_starts(windows, scene, batch)
    lead = int(start.lead.max())
    count = lead + rows
    commands = commands_from(windows, batch["episode"], start.first_row, count)
    pilots = [
        Pilot(
            episode,
            partial(checked_begin, partial(_begin, policy, scene, [seed, number]), scene, policy.name, "simulation"),
            lambda readings: readings,
            rows,
            np.zeros((rows, commands.shape[2])),
        )
        for number, episode in zip(starts.numbers.tolist(), starts.ids, strict=True)
    ]
    closed_loop = ClosedLoop(pilots, lead, scene.file.rate_hz, command_limits(scene), STEP_LIMIT_S)
    rollout(
        scene,
        commands,
        start.qpos,
        start.qvel,
        [()] * len(starts),
        observer=None if is_toss(scene) else past_observer(scene, start.followed, count),
        closed_loop=closed_loop,
    )
    closed_loop.check()
    return commands[:, lead:]


def _begin(policy: StepPolicy, scene: Scene, seed: Sequence[int]) -> Step:
    """Return the step of a policy that begins with its own random stream."""
    return policy.begin(scene, np.random.default_rng(seed))
