"""Closed-loop scores by what rows or episodes have in common: object, task, outcome, contact phase."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.schema.json_text import parse_json
from candata.schema.phases import CONTACT_PHASES, contact_phases
from candata.training import metrics
from candata.training.loop_errors import LoopErrors
from candata.training.results import Group, GroupScores
from candata.training.rollout import Course

#: What an episode states of itself that results are broken down by.
LABELS = ("object", "task", "outcome")
#: Label of an episode that does not state it, where others do.
NOT_STATED = "not stated"


def breakdown(dataset: Dataset, course: Course, errors: Mapping[str, LoopErrors]) -> dict[str, dict[str, Group]]:
    """Return the scores by kind and label; a kind that no episode states is left out.

    Contact phases are those of `candata.schema.phases`, of the recorded contact at the recording's own rate.
    """
    groups = {}
    for kind, labels in _labels(dataset, course).items():
        names = sorted(set(labels))
        number = {name: k for k, name in enumerate(names)}
        numbers = np.array([number[label] for label in labels])
        groups[kind] = _groups(names, np.broadcast_to(numbers[:, None], course.valid.shape), course, errors)
    phases = _phases(course)
    if phases is not None:
        groups["phase"] = _groups(CONTACT_PHASES, phases, course, errors)
    return groups


def _labels(dataset: Dataset, course: Course) -> dict[str, list[str]]:
    """Return the labels of the course's episodes, by kind."""
    catalog = dataset.catalog(["id", "meta"])
    meta = dict(zip(catalog["id"].to_pylist(), catalog["meta"].to_pylist(), strict=True))
    fields = [parse_json(meta[course.windows.episode_ids[e]]) for e in course.episodes.tolist()]
    stated = {kind: [episode.get(kind) for episode in fields] for kind in LABELS}
    return {kind: [label or NOT_STATED for label in labels] for kind, labels in stated.items() if any(labels)}


def _phases(course: Course) -> NDArray[np.int64] | None:
    """Return `(E, N)`: each row's phase as an index into `CONTACT_PHASES`; None without recorded contact."""
    windows = course.windows
    if "contact" not in windows.channels:
        return None
    cache, phases = windows.cache, np.zeros(course.valid.shape, np.int64)
    number = {name: k for k, name in enumerate(CONTACT_PHASES)}
    starts = (windows.present_row - cache.begin[course.episodes]).tolist()
    for k, (episode, start) in enumerate(zip(course.episodes.tolist(), starts, strict=True)):
        contact = cache.rows["contact"][cache.begin[episode] : cache.end[episode]]
        names = contact_phases(contact, cache.file.rate_hz[episode])
        rows = start + np.arange(1, course.steps[k] + 1) * windows.stride[episode]
        phases[k, : course.steps[k]] = [number[name] for name in names[rows].tolist()]
    return phases


def _groups(
    names: Sequence[str], numbers: NDArray[np.int64], course: Course, errors: Mapping[str, LoopErrors]
) -> dict[str, Group]:
    """Return the groups by name; `numbers (E, N)` says which of them each row belongs to."""
    of_row, count = numbers[course.valid], len(names)
    rows = np.bincount(of_row, minlength=count)
    episode_of_row = np.nonzero(course.valid)[0]
    episodes = np.bincount(np.unique(of_row + count * episode_of_row) % count, minlength=count)

    def means(values: NDArray | None) -> list[float | None]:
        if values is None:
            return [None] * count
        sums = np.bincount(of_row, weights=values[course.valid], minlength=count)
        return (sums / np.maximum(rows, 1)).tolist()

    columns = {
        name: zip(
            means(None if loop.adds is None else metrics.auc_share(loop.adds)),
            means(loop.adds),
            means(loop.position),
            means(loop.rotation),
            strict=True,
        )
        for name, loop in errors.items()
    }
    by_group = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    fields = ("adds_auc", "adds_m", "position_error_m", "rotation_error_rad")
    return {
        name: Group(
            episodes=int(episodes[k]),
            rows=int(rows[k]),
            scores={
                forecaster: GroupScores.model_validate(dict(zip(fields, values, strict=True)))
                for forecaster, values in by_group[k].items()
            },
        )
        for k, name in enumerate(names)
        if rows[k]
    }
