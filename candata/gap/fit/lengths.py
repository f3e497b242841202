"""Lengths of a tracker, measured on tosses before anything is fitted: they enter the search as known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.gap.fit.candidates import candidate
from candata.gap.fit.problem import Problem
from candata.gap.measure.length_scale import length_scale, ruled_out


def with_lengths(problem: Problem) -> Problem:
    """Return the problem with what free fall and rest say of the tracker's lengths, before anything is fitted."""
    scene, recs = problem.replayer.scene, problem.recs
    found = length_scale(scene, recs, problem.begin, problem.streams)
    if found.scale is None:
        return replace(problem, ruled_out=ruled_out(found))
    c, s = candidate("pose_scale", scene), found.scale
    note = (
        f"the tracker's lengths are {s.value:.4f} of true ({s.low:.4f} to {s.high:.4f}), read off free fall and the "
        f"height at rest of {s.episodes} tosses, without a fit of contact"
    )
    measured = ((c, np.log([s.value]) if c.logarithmic[0] else np.array([s.value])),)
    noted = replace(recs, notes=(*recs.notes, note))
    return replace(problem, recs=noted, ruled_out=ruled_out(found), measured=measured)
