"""Preparation: from recordings and a scene to the problem that is searched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.effects import effect_names
from candata.errors import DataError, Where
from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import Recordings, read, title
from candata.gap.data.testability import library as searchable
from candata.gap.fit.folds import FEWEST, folds
from candata.gap.fit.length_scale import with_lengths
from candata.gap.fit.problem import Problem, SoFar
from candata.gap.fit.signatures import library, sharing_note
from candata.gap.measure.floor import spread
from candata.gap.measure.reference import changed_since
from candata.gap.measure.repeats import slow_deviation
from candata.gap.measure.score import score
from candata.gap.mismatch.check import checked
from candata.gap.replay.effort_unit import with_effort_unit
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import start_notes, starts
from candata.gap.run.pace import Forecast, Pace
from candata.gap.run.streams import Streams
from candata.gap.screening.episodes import with_telling
from candata.scenes.traits import is_toss

Progress = Callable[[str], None]
#: Episodes, and tosses, on which effects are searched; what a larger dataset holds beyond is left untouched until the
#: end. A toss is short, and chance decides how it lands. Record 43.
SEARCHED, TOSSES = 64, 128
#: Fewest episodes left untouched; where fewer would be, all are searched. Chosen: an interval over few tells little.
UNTOUCHED = 16


class Posed(NamedTuple):
    """All recordings, which of them are left untouched by the search, and its problem; None where they are too few."""

    everything: Recordings
    untouched: NDArray[np.int64]
    problem: Problem | None


def posed(
    dataset: Dataset,
    replayer: Replayer,
    seed: int,
    cache: Path | None,
    only: tuple[str, ...] = (),
    progress: Progress = lambda stage: None,
    share: bool | None = False,
    forecast: Forecast | None = None,
    sofar: SoFar | None = None,
    against: Dataset | None = None,
) -> Posed:
    """Return the search problem that a dataset poses; parameters and errors are those of `diagnose` and `library`.

    Simulations of the `replayer` are counted by the `forecast`; what is known by then is kept in `sofar`.
    """
    if len(dataset) == 0:
        raise DataError("the dataset is empty", expected="recorded episodes", where=Where(path=str(dataset.path)))
    streams, scene = Streams(seed), replayer.scene
    sofar, forecast = sofar or SoFar(), forecast or Forecast()
    progress("reading")
    sofar.recs = read(scene, dataset)
    reference = None if against is None else read(scene, against)
    sofar.recs, reference = with_effort_unit(replayer, checked(replayer, sofar.recs, reference), reference)
    if against is not None and reference is not None:
        progress("comparing with the reference")
        sofar.recs = changed_since(replayer, sofar.recs, reference, title(against), seed)
    everything = sofar.recs
    order = streams.of("searched episodes", everything.ids).permutation(len(everything))
    most = TOSSES if is_toss(scene) else SEARCHED
    most = most if len(everything) - most >= UNTOUCHED else len(everything)
    searched, untouched = np.sort(order[:most]), np.sort(order[most:])
    if len(everything) < FEWEST or not everything.moving:
        return Posed(everything, untouched, None)
    left_out = frozenset(effect_names(everything.channels)) - frozenset(searchable(scene, everything, only))
    problem = _problem(replayer, everything.take(searched), streams, cache, progress, share, forecast)
    problem = replace(problem, ruled_out=problem.ruled_out | left_out, sofar=sofar)
    sofar.problem = problem
    return Posed(everything, untouched, problem)


def _problem(
    replayer: Replayer,
    recs: Recordings,
    streams: Streams,
    cache: Path | None,
    progress: Progress,
    share: bool | None = False,
    forecast: Forecast | None = None,
) -> Problem:
    """Return the search problem."""
    progress("replaying the nominal scene")
    forecast = forecast or Forecast()
    begin, clock_s = starts(replayer.scene, recs), monotonic()
    forecast.begin()
    readings = replay_all(replayer, recs, begin, [()])[0]
    pace = Pace(progress, 0.0 if is_toss(replayer.scene) else monotonic() - clock_s, forecast)
    plan = layout(replayer.scene, recs, begin, readings)
    raw = residual(recs, plan, readings)
    progress("measuring the floor")
    shelf = library(replayer, recs, begin, plan, raw, cache, progress, share)
    kind, noise, notes, loss_error = sensor_noise(replayer.scene.file.noise, recs, readings, replayer.scene.sliding)
    slow, slow_notes = slow_deviation(replayer.scene, recs, raw, shelf.nulls(noise), plan, kind)
    notes = (*start_notes(replayer.scene, begin), *notes, *slow_notes, *sharing_note(shelf))
    recs = replace(recs, notes=(*recs.notes, *notes), slow=slow)
    shelf = replace(shelf, recs=recs) if slow else shelf
    level = score(raw, spread(noise, plan, shelf.nulls(noise)), plan, loss_error, streams.seed)
    parts = folds(recs.tasks, streams.of("folds", recs.ids), recs.independent)
    problem = Problem(replayer, recs, begin, plan, level, parts, noise, kind, streams, shelf, readings, raw, pace=pace)
    return with_lengths(problem) if is_toss(replayer.scene) else with_telling(problem)
