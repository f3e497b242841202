"""Forecast contact against recorded contact: shares, AUROC, and when contacts begin and end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.training import metrics
from candata.training.results import Contact, EventTiming
from candata.training.rollout import CONTACT_THRESHOLD

Flags = NDArray[np.bool_]

#: Longest time between a recorded event and the forecast one that answers to it [s]. Chosen: several steps of a model
#: at 10 Hz, and shorter than the hold between a grasp and its release.
ANSWER_S = 1.0


def contact_scores(forecast: NDArray | None, truth: NDArray | None, valid: Flags) -> Contact | None:
    """Return how well contact was forecast, over the valid steps; None where it was not, or is not recorded.

    Parameters
    ----------
    forecast : (...) float or None
        Probability of contact.
    truth, valid : (...) bool or None, (...) bool
        Recorded contact, and which steps count.
    """
    if forecast is None or truth is None:
        return None
    scores = metrics.f1(forecast[valid] >= CONTACT_THRESHOLD, truth[valid])
    return Contact(**scores, auroc=metrics.auroc(forecast[valid], truth[valid]))


def event_timing(
    forecast: NDArray | None, truth: Flags | None, present: Flags | None, valid: Flags, rate_hz: float, is_onset: bool
) -> EventTiming | None:
    """Return when contacts begin (or end) in closed loops; None where contact is not forecast, or not recorded.

    A recorded and a forecast event of one episode are matched when they are the nearest to each other that are left,
    no more than `ANSWER_S` apart. Times are those of steps: no finer than 1 / `rate_hz`.

    Parameters
    ----------
    forecast : (E, N) float or None
        Probability of contact at each step.
    truth, valid : (E, N) bool
        Recorded contact, and which steps count.
    present : (E,) bool
        Contact at the row at which the loops begin.
    rate_hz : float
        Steps a second.
    is_onset : bool
        Whether beginnings are meant, else ends.
    """
    if forecast is None or truth is None or present is None:
        return None
    recorded = _events(truth, present, valid, is_onset)
    answered = _events(forecast >= CONTACT_THRESHOLD, present, valid, is_onset)
    limit = round(ANSWER_S * rate_hz)
    lags = [
        lag
        for events, answers in zip(recorded, answered, strict=True)
        for lag in _lags(np.flatnonzero(events), np.flatnonzero(answers), limit)
    ]
    q25_s, median_s, q75_s = (np.quantile(lags, (0.25, 0.5, 0.75)) / rate_hz).tolist() if lags else (None, None, None)
    return EventTiming(
        recorded=int(recorded.sum()),
        matched=len(lags),
        spurious=int(answered.sum()) - len(lags),
        median_s=median_s,
        q25_s=q25_s,
        q75_s=q75_s,
    )


def _events(contact: Flags, present: Flags, valid: Flags, is_onset: bool) -> Flags:
    """Return `(E, N)`: the valid steps at which contact begins (or ends), the step before valid too."""
    before = np.concatenate([present[:, None], contact[:, :-1]], axis=1)
    valid_before = np.concatenate([np.ones((len(valid), 1), bool), valid[:, :-1]], axis=1)
    changes = contact & ~before if is_onset else before & ~contact
    return np.asarray(changes & valid & valid_before)


def _lags(recorded: NDArray[np.int64], answered: NDArray[np.int64], limit: int) -> list[int]:
    """Return the steps by which forecast events of an episode come late, the nearest pairs first, each event once."""
    lags = answered[None, :] - recorded[:, None]
    order = np.argsort(np.abs(lags), axis=None, kind="stable")
    rows, columns = np.unravel_index(order, lags.shape) if lags.size else ((), ())
    used_rows: set[int] = set()
    used_columns: set[int] = set()
    matched = []
    for row, column in zip(map(int, rows), map(int, columns), strict=True):
        if abs(lags[row, column]) <= limit and row not in used_rows and column not in used_columns:
            used_rows.add(row)
            used_columns.add(column)
            matched.append(int(lags[row, column]))
    return matched
