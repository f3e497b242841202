"""Commands that may be played: within limits, no faster than recordings, with smooth noise on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UsageError, Where
from candata.loaders import Windows
from candata.policies import Motion, command_limits
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Time between the knots of smooth noise [s]. Chosen: as long as a finger takes to close on an object.
KNOT_S = 0.4
#: A command is too fast, or beyond a limit, when it is so by more than this share: float32 rounds.
ROUNDING_SHARE = 1e-4


@dataclass(frozen=True)
class CommandBounds:
    """What commands may be, and how they usually vary.

    Attributes
    ----------
    names : tuple of str
        Actuators.
    limits : (A, 2) float64
        Smallest and largest command of the scene.
    step : (A,) float64
        Largest change from one control step to the next in the training recordings, not across missing rows.
    spread : (A,) float64
        Standard deviation of the commands in the training recordings.
    rate_hz : float
        Control steps a second.
    """

    names: tuple[str, ...]
    limits: Array
    step: Array
    spread: Array
    rate_hz: float

    def kept(self, commands: Array, previous: Array) -> Array:
        """Return commands `(..., R, A)` moved, row by row, within limits and rate after `previous (..., A)`."""
        kept = np.empty_like(commands)
        last = previous
        for row in range(commands.shape[-2]):
            within = np.clip(commands[..., row, :], last - self.step, last + self.step)
            kept[..., row, :] = last = np.clip(within, *self.limits.T)
        return kept

    def noise(self, rngs: Sequence[np.random.Generator], count: int, rows: int, share: float) -> Array:
        """Return smooth noise `(S, count, rows, A)`: straight between knots, zero before the first step.

        Each start draws by a generator of its own. `share` is the standard deviation at a knot, in that of the recorded
        commands.

        Raises
        ------
        UsageError
            When it is not finite.
        """
        if not np.isfinite(share):
            raise UsageError("the noise of commands is no number", expected="a finite share", found=f"{share:g}")
        time_s = np.arange(1, rows + 1) / self.rate_hz
        knots = max(1, int(np.ceil(time_s[-1] / KNOT_S - 1e-9)))
        heights = np.stack([rng.standard_normal((count, knots, len(self.names))) for rng in rngs])
        heights = np.concatenate([np.zeros_like(heights[:, :, :1]), heights], axis=-2)
        place = time_s / KNOT_S
        before = np.minimum(place.astype(int), knots - 1)
        part = (place - before)[:, None]
        straight = (1 - part) * heights[..., before, :] + part * heights[..., before + 1, :]
        return share * self.spread * straight

    def is_playable(self, commands: Array, previous: Array) -> NDArray[np.bool_]:
        """Tell which chunks `(..., R, A)` keep the rate, from `previous (..., A)` on `(...)`."""
        steps = np.abs(np.diff(commands, axis=-2, prepend=previous[..., None, :]))
        return np.asarray((steps <= self.step * (1 + ROUNDING_SHARE) + ROUNDING_SHARE * self._range).all((-1, -2)))

    def check(self, motions: Sequence[Motion]) -> None:
        """Return nothing when motions can be played.

        Raises
        ------
        DataError
            When a command is no number, beyond a limit, or changes faster than any recorded one.
        """
        for motion in motions:
            low, high = self.limits.T + np.array([[-1], [1]]) * ROUNDING_SHARE * self._range
            self._refuse(motion, ~np.isfinite(motion.commands), "is no number", "finite numbers")
            beyond = (motion.commands < low) | (motion.commands > high)
            self._refuse(motion, beyond, "goes beyond a limit", "commands within the scene's limits")
            most = self.step * (1 + ROUNDING_SHARE) + ROUNDING_SHARE * self._range
            too_fast = np.abs(np.diff(motion.commands, axis=0)) > most
            words = "no faster than the training recordings"
            self._refuse(motion, np.concatenate([too_fast[:1] & False, too_fast]), "is too fast", words)

    @property
    def _range(self) -> Array:
        """Return `(A,)` the width of the limits."""
        return np.asarray(self.limits[:, 1] - self.limits[:, 0])

    def _refuse(self, motion: Motion, bad: NDArray[np.bool_], problem: str, expected: str) -> None:
        """Refuse a motion in which something is bad `(T, A)`."""
        if bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0])
            raise DataError(
                f"candidate {motion.name!r} {problem}",
                expected=expected,
                found=f"{motion.commands[row, column]:g} at row {row}",
                where=Where(channel=self.names[column], index=row),
            )


def command_bounds(scene: Scene, windows: Windows) -> CommandBounds:
    """Return the bounds of a scene's commands, as the windows' training episodes use them.

    Raises
    ------
    DataError
        When no commands are recorded.
    """
    if "action" not in windows.channels:
        raise DataError("no commands are recorded", expected="the channel action", where=Where(channel="action"))
    cache, steps, sums = windows.cache, [], []
    for episode in windows.fit_episodes.tolist():
        part = slice(cache.begin[episode], cache.end[episode])
        commands, valid = cache.rows["action"][part].astype(np.float64), cache.valid[part]
        recorded = valid[1:] & valid[:-1] & (np.diff(cache.stretch[part]) == 0)
        steps.append(np.abs(np.diff(commands, axis=0)[recorded]).max(0, initial=0.0))
        sums.append((len(commands), commands.sum(0), (commands**2).sum(0)))
    count, total, square = (sum(part) for part in zip(*sums, strict=True))
    spread = np.sqrt(np.maximum(square / count - (total / count) ** 2, 0.0))
    return CommandBounds(
        tuple(scene.file.actuator_names),
        command_limits(scene),
        np.max(steps, axis=0),
        spread,
        scene.file.rate_hz,
    )


def candidate_motions(motions: Sequence[Motion], rows: int) -> Array:
    """Return motions as chunks `(N, rows, A)`: a longer one is cut, a shorter one holds its last command.

    Raises
    ------
    UsageError
        When there are fewer than two.
    """
    if len(motions) < 2:
        raise UsageError("nothing to choose between", expected="at least 2 motions", found=str(len(motions)))
    last = [np.minimum(np.arange(rows), len(motion.commands) - 1) for motion in motions]
    return np.stack([motion.commands[at] for motion, at in zip(motions, last, strict=True)])
