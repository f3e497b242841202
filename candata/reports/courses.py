"""Figures of an evaluation, as plain Plotly specifications in the manner of `figures`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from candata.training.results import Evaluation, Track

Spec = dict[str, Any]

#: Colours of the forecasters in the order of an evaluation: the model, then the baselines.
COLOURS = ("@after", "@before", "@tie")
DASHES = ("solid", "dash", "dot")
#: Points drawn of a course; more cannot be seen at the size shown.
MOST_POINTS = 400


def against_horizon(found: Evaluation, measure: str, factor: float, unit: str) -> Spec:
    """Return a measure of all forecasters over the steps of the horizon.

    Parameters
    ----------
    found : Evaluation
        What was found.
    measure : str
        Field of `WindowScores` that holds a value a step.
    factor, unit : float, str
        From SI to the unit shown.
    """
    data = []
    for number, (name, one) in enumerate(found.forecasters.items()):
        values = getattr(one.windows, measure)
        data.append(_line(found, number, one.summary, values, factor, unit))
        if measure == "position_error_m" and found.samples > 1 and number == 0:
            energy = _line(found, number, "energy score of its samples", one.windows.position_energy_m, factor, unit)
            data.append({**energy, "line": {"color": COLOURS[0], "width": 1.2, "dash": "dot"}, "name": name})
    layout = {
        "height": 240,
        "margin": {"l": 46, "r": 8, "t": 8, "b": 40},
        "hovermode": "x unified",
        "xaxis": {"title": {"text": "seconds ahead", "font": {"size": 11}}, "showgrid": False, "fixedrange": True},
        "yaxis": {"ticksuffix": f" {unit}", "fixedrange": True, "nticks": 5, "rangemode": "tozero"},
    }
    return {"data": data, "layout": layout}


def _line(found: Evaluation, number: int, name: str, values: Sequence[float | None], factor: float, unit: str) -> Spec:
    """Return the line of one forecaster."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": [round((k + 1) / found.rate_hz, 4) for k in range(len(values))],
        "y": [None if v is None else float(f"{factor * v:.4g}") for v in values],
        "line": {"color": COLOURS[number % 3], "width": 2.4 if number == 0 else 1.6, "dash": DASHES[number % 3]},
        "hovertemplate": f"{name}: %{{y:.3g}} {unit}<extra></extra>",
    }


def course(track: Track) -> Spec:
    """Return the paths of the object's origin in 3D: recorded, the model's, the baselines'; equal scales, in cm."""
    step = max(1, math.ceil(len(track.time_s) / MOST_POINTS))
    names = list(track.poses)
    drawn = [_path("recorded", track.truth, track.time_s, "@ink", 5.0, step)]
    for number, name in reversed(list(enumerate(names))):
        drawn.append(
            _path(name, track.poses[name], track.time_s, COLOURS[number % 3], 6.0 if number == 0 else 3.0, step)
        )
    begin = 100 * track.truth[0, :3]
    drawn.append(
        {
            "type": "scatter3d", "mode": "markers", "x": [_short(begin[0])], "y": [_short(begin[1])],
            "z": [_short(begin[2])], "marker": {"size": 4, "color": "@ink"},
            "hovertemplate": "the loop begins here<extra></extra>",
        }
    )  # fmt: skip
    low, high = _cube([track.truth, track.poses[names[0]]])
    axis = {"gridcolor": "@rule2", "zeroline": False, "showbackground": False, "nticks": 5, "tickfont": {"size": 9}}
    scene = {
        key: {**axis, "title": {"text": f"{key[0]} [cm]", "font": {"size": 10}}, "range": [low[i], high[i]]}
        for i, key in enumerate(("xaxis", "yaxis", "zaxis"))
    }
    camera = {"eye": {"x": 1.25, "y": 1.25, "z": 0.7}, "center": {"x": 0, "y": 0, "z": -0.12}}
    layout = {
        "height": 320,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "scene": {**scene, "aspectmode": "cube", "camera": camera},
    }
    return {"data": drawn, "layout": layout}


def _cube(paths: Sequence[np.ndarray]) -> tuple[list[float], list[float]]:
    """Return the corners [cm] of the least cube, 6 cm or more wide, that holds the paths."""
    points = 100 * np.concatenate([path[:, :3] for path in paths])
    middle = (points.min(0) + points.max(0)) / 2
    half = max(3.0, 0.55 * float((points.max(0) - points.min(0)).max()))
    return [_short(v) for v in middle - half], [_short(v) for v in middle + half]


def _path(name: str, poses: np.ndarray, time_s: np.ndarray, colour: str, width: float, step: int) -> Spec:
    """Return one path of the object's origin."""
    points, times = 100 * poses[::step, :3], time_s[::step]
    return {
        "type": "scatter3d",
        "mode": "lines",
        **{axis: [_short(v) for v in points[:, i]] for i, axis in enumerate("xyz")},
        "customdata": [round(float(t), 3) for t in times],
        "line": {"color": colour, "width": width},
        "hovertemplate": f"{name}, %{{customdata}} s<br>%{{x:.1f}}, %{{y:.1f}}, %{{z:.1f}} cm<extra></extra>",
    }


def timeline(track: Track) -> Spec:
    """Return recorded contact as a band, and the model's probability of contact as a line."""
    time = [round(float(t), 3) for t in track.time_s]
    data: list[Spec] = []
    if track.contact is not None:
        flags = [float(v) for v in track.contact]
        data.append(
            {
                "type": "scatter", "mode": "lines", "x": time, "y": flags, "fill": "tozeroy", "fillcolor": "@band",
                "line": {"width": 0, "shape": "hv"}, "hovertemplate": "recorded: %{y}<extra></extra>",
            }
        )  # fmt: skip
    if track.forecast_contact is not None:
        values = [None if math.isnan(v) else round(float(v), 4) for v in track.forecast_contact]
        data.append(
            {
                "type": "scatter", "mode": "lines", "x": time, "y": values, "line": {"color": "@after", "width": 2},
                "hovertemplate": "forecast: %{y:.2f}<extra></extra>",
            }
        )  # fmt: skip
    layout = {
        "height": 84,
        "margin": {"l": 30, "r": 6, "t": 4, "b": 22},
        "hovermode": "x unified",
        "xaxis": {"ticksuffix": " s", "showgrid": False, "fixedrange": True, "nticks": 6},
        "yaxis": {"fixedrange": True, "range": [-0.04, 1.08], "tickvals": [0, 1], "zeroline": False},
    }
    return {"data": data, "layout": layout}


def episodes(found: Evaluation) -> Spec:
    """Return each episode's ADD-S AUC over how far its object moved, by forecaster."""
    data = []
    for number, (name, one) in enumerate(found.forecasters.items()):
        rows = [e for e in found.by_episode if name in e.adds_auc]
        data.append(
            {
                "type": "scatter", "mode": "markers", "x": [_short(100 * e.moved_m) for e in rows],
                "y": [_short(100 * e.adds_auc[name]) for e in rows], "text": [e.id for e in rows],
                "marker": {
                    "color": COLOURS[number % 3], "size": 8 if number == 0 else 6,
                    "symbol": ("circle", "diamond", "x")[number % 3], "opacity": 0.85,
                },
                "hovertemplate": f"%{{text}}<br>{one.summary}: %{{y:.1f}} %<br>moved %{{x:.1f}} cm<extra></extra>",
            }
        )  # fmt: skip
    layout = {
        "height": 300,
        "margin": {"l": 46, "r": 8, "t": 8, "b": 42},
        "xaxis": {
            "title": {"text": "largest motion of the object [cm]", "font": {"size": 11}}, "fixedrange": True,
            "rangemode": "tozero", "zeroline": False,
        },
        "yaxis": {"ticksuffix": " %", "fixedrange": True, "nticks": 6, "zeroline": False},
    }  # fmt: skip
    return {"data": data, "layout": layout}


def names_of(forecasters: Mapping[str, object]) -> dict[str, str]:
    """Return forecaster to the colour of the theme that it is drawn in."""
    return {name: COLOURS[number % 3].removeprefix("@") for number, name in enumerate(forecasters)}


def _short(value: float) -> float:
    """Return a number with five digits."""
    return float(f"{float(value):.5g}")
