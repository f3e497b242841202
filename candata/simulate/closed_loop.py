"""Policies in a closed loop: what each sees before a control step, and the commands it gives."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.policies import Observation, Step

Array = NDArray[np.float64]
#: Longest time that a policy may take for one control step [s]. Chosen: a network of any size that would run on a robot
#: is a hundred times faster.
STEP_LIMIT_S = 10.0


class FailedStepsError(DataError):
    """Policies gave no commands; `by_episode` has the error of each such episode, and the text is that of the first."""

    def __init__(self, by_episode: Mapping[str, DataError]) -> None:
        first = next(iter(by_episode.values()))
        super().__init__(first.problem, expected=first.expected, found=first.found, where=first.where, fix=first.fix)
        self.by_episode = by_episode


@dataclass(frozen=True)
class Pilot:
    """What gives the commands of one episode.

    Attributes
    ----------
    episode : str
        Its id, for errors.
    begin : callable
        `() -> step`, where `step` is `Observation -> (A,)`.
    sense : callable
        Channels `(T, ...)` as perfect sensors read them -> the same with the episode's noise.
    rows : int
        Rows T of the episode.
    noise : (T, A) float64
        Added to the commands.
    """

    episode: str
    begin: Callable[[], Step]
    sense: Callable[[dict[str, Array]], Mapping[str, Array]]
    rows: int
    noise: Array


class ClosedLoop:
    """The commands of a batch, given row by row after the settling.

    Parameters
    ----------
    pilots : sequence of Pilot or None
        One for each simulation; None where the commands are planned.
    settle : int
        Rows before row 0, in which the first planned command is held.
    rate_hz : float
        Control steps a second.
    limits : (A, 2) float64
        Smallest and largest command; what a policy gives beyond is cut.
    step_limit_s : float
        Longest time that a policy may take for one control step [s].
    """

    def __init__(
        self,
        pilots: Sequence[Pilot | None],
        settle: int,
        rate_hz: float,
        limits: Array,
        step_limit_s: float = STEP_LIMIT_S,
    ) -> None:
        self._pilots, self._settle, self._rate_hz, self._limits = pilots, settle, rate_hz, limits
        self._step_limit_s = step_limit_s
        self._seen: list[dict[str, Array]] = [{} for _ in pilots]
        self._steps: dict[int, Step] = {}
        self._errors: dict[str, DataError] = {}

    def set_commands(self, row: int, readings: Mapping[str, Array], commands: Array) -> None:
        """Set the commands of a row, `commands[:, row]` of `(n, T, A)`, in place.

        Parameters
        ----------
        row : int
            Row of the run, settling included.
        readings : mapping of str to ndarray
            What the sensors of the worlds read now, `(n, ...)` a channel.
        commands : (n, T, A) float64
            Those of earlier rows are what was given.

        A policy that gives no commands keeps its last ones; see `check`.
        """
        number = row - self._settle
        for i, pilot in enumerate(self._pilots):
            if pilot is None or not 0 <= number < pilot.rows:
                continue
            earlier = commands[i, max(row - 1, 0)].copy()
            if pilot.episode not in self._errors:
                try:
                    seen = self._sensed(i, pilot, number, {name: value[i] for name, value in readings.items()})
                    observation = Observation(number, number / self._rate_hz, seen, earlier.copy())
                    given = self._given(i, pilot, observation) + pilot.noise[number]
                    commands[i, row] = np.clip(given, *self._limits.T)
                    continue
                except DataError as error:
                    self._errors[pilot.episode] = error
            commands[i, row] = earlier

    def check(self) -> None:
        """Refuse a run in which a policy failed, took too long, or gave what is no command.

        Raises
        ------
        FailedStepsError
            When one did; an episode of another policy is as good as if it had been played alone.
        """
        if self._errors:
            raise FailedStepsError(self._errors)

    def _given(self, i: int, pilot: Pilot, observation: Observation) -> Array:
        """Return the commands that a policy gives, which begins with its first row."""
        if observation.row == 0:
            with time_limit(self._step_limit_s):
                self._steps[i] = pilot.begin()
        return _checked_commands(self._steps[i], pilot.episode, observation, self._step_limit_s)

    def _sensed(self, i: int, pilot: Pilot, number: int, readings: dict[str, Array]) -> dict[str, Array]:
        """Return the readings of a row as the episode will store them.

        Noise is drawn for all rows at once, so the rows to come hold the readings of this one until they are there.
        """
        so_far = self._seen[i]
        for name, value in readings.items():
            if name not in so_far:
                so_far[name] = np.empty((pilot.rows, *value.shape))
            so_far[name][number:] = value
        return {name: value[number] for name, value in pilot.sense(so_far).items() if name in readings}


def _checked_commands(step: Step, episode: str, observation: Observation, limit_s: float) -> Array:
    """Return what a policy gives, once it is known to be commands."""
    try:
        with time_limit(limit_s):
            given = step(observation)
        commands = np.asarray(given)
        commands = commands if np.iscomplexobj(commands) else commands.astype(np.float64)
    except DataError:
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and type(error) is not SystemExit:
            raise  # a worker is told to leave
        problem = f"{type(error).__name__}: {error}"
        raise _failed_step("the policy failed", "commands", problem, episode, observation) from error
    shape = observation.action.shape
    if commands.shape != shape or np.iscomplexobj(commands) or not np.isfinite(commands).all():
        problem = (
            "complex numbers, or some that are not finite" if commands.shape == shape else f"shape {commands.shape}"
        )
        raise _failed_step("the policy gave no commands", f"{shape[0]} finite numbers", problem, episode, observation)
    return commands


def _failed_step(problem: str, expected: str, found: str, episode: str, observation: Observation) -> DataError:
    """Return the error for a step that gave nothing."""
    return DataError(
        problem,
        expected=expected,
        found=f"{found}, at row {observation.row} ({observation.time_s:.2f} s)",
        where=Where(episode=episode),
    )


@contextmanager
def time_limit(limit_s: float) -> Iterator[None]:
    """Raise TimeoutError in the block after some seconds; without effect outside of a process's main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"no answer within {limit_s:g} s")

    earlier = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, earlier)
