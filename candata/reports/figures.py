"""The figures as plain Plotly specifications; a word after @ is a colour of the page's theme."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from candata.gap.evidence import EpisodeLosses, HeatMap, Trace
from candata.reports import words
from candata.reports.numbers import digits
from candata.schema.report import Ranked, Report

Spec = dict[str, Any]

#: Family-wise p at or below which a cell of the heat map shows its number.
SIGNIFICANT_P = 0.05
#: Candidates drawn in the ranking.
MOST_RANKED = 12
#: Points drawn of a trace; more cannot be seen at the size shown.
MOST_POINTS = 600
#: Ticks of the heat map's colour bar, as ratios.
RATIO_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10000)


def heat_map(heat: HeatMap) -> Spec:
    """Return channel element by phase: loss over floor, log colour, grey where there is no data."""
    ratio, p = np.asarray(heat.ratio, float), np.asarray(heat.p, float)
    known = np.isfinite(ratio)
    level = np.log10(np.maximum(np.where(known, ratio, 1.0), 1.0))
    top = max(float(level.max(initial=0.0)), math.log10(5))
    ticks = [t for t in RATIO_TICKS if math.log10(t) <= top + 1e-9]
    shared = {"x": list(heat.phases), "y": list(heat.rows), "type": "heatmap", "xgap": 1.5, "ygap": 1.5}
    empty = {
        **shared,
        "z": [[None if k else 0.0 for k in row] for row in known],
        "colorscale": [[0, "@hole"], [1, "@hole"]],
        "showscale": False,
        "hovertemplate": "%{y}<br>%{x}: no data<extra></extra>",
    }
    cells = {
        **shared,
        "z": [_plain(row) for row in np.where(known, level, np.nan)],
        "zmin": 0,
        "zmax": top,
        "colorscale": [[i / 4, f"@heat{i}"] for i in range(5)],
        "customdata": _hover(ratio, p),
        "hovertemplate": "%{y}<br>%{x}: %{customdata}<extra></extra>",
        "text": [[_cell(r, q) for r, q in zip(*row, strict=True)] for row in zip(ratio, p, strict=True)],
        "texttemplate": "%{text}",
        "textfont": {"size": 10},
        "colorbar": _colour_bar(ticks),
    }
    rows = len(heat.rows)
    height = 92 + rows * (24 if rows <= 12 else 17 if rows <= 24 else 14)
    layout = {
        "height": height,
        "margin": {"l": 8, "r": 4, "t": 26, "b": 8},
        "xaxis": {"side": "top", "fixedrange": True, "automargin": True, "showgrid": False, "ticks": ""},
        "yaxis": {
            "autorange": "reversed",
            "fixedrange": True,
            "automargin": True,
            "showgrid": False,
            "dtick": 1,
            "ticks": "",
            "tickfont": {"size": 11 if rows <= 24 else 10},
        },
    }
    return {"data": [empty, cells], "layout": layout}


def ranking(report: Report) -> Spec:
    """Return the best candidates with their held-out gains and intervals; named ones stand out."""
    named = {(effect.name, effect.element) for effect in report.effects}
    shown = shown_candidates(report)
    labels = [words.title(c.name, c.element) for c in shown]
    colours = ["@accent" if (c.name, c.element) in named else "@quiet" for c in shown]
    data = [_candidate(c, text, colour) for c, text, colour in zip(shown, labels, colours, strict=True)]
    layout = {
        "height": 74 + 26 * len(shown),
        "margin": {"l": 8, "r": 12, "t": 8, "b": 44},
        "xaxis": {
            "title": {"text": "held-out gain", "font": {"size": 11}},
            "zeroline": True,
            "zerolinecolor": "@rule2",
            "fixedrange": True,
            "nticks": 5,
        },
        "yaxis": {
            "autorange": "reversed",
            "automargin": True,
            "fixedrange": True,
            "showgrid": False,
            "type": "category",
            "ticks": "",
        },
    }
    return {"data": data, "layout": layout}


def shown_candidates(report: Report) -> list[Ranked]:
    """Return the first candidates of the ranking, and named ones further down."""
    named = {(effect.name, effect.element) for effect in report.effects}
    head, tail = report.ranking[:MOST_RANKED], report.ranking[MOST_RANKED:]
    return [*head, *(c for c in tail if (c.name, c.element) in named)]


def trace(time_s: np.ndarray, one: Trace, after: str = "repaired") -> Spec:
    """Return recorded, nominal and repaired values of one element over time; `after` names the last."""
    step = max(1, math.ceil(len(time_s) / MOST_POINTS))
    lines = [
        ("recorded", one.real, "@recorded", 4.0, "solid"),
        ("nominal", one.before, "@before", 1.5, "solid"),
    ]
    if one.after is not None:
        lines.append((after, one.after, "@after", 1.5, "solid"))
    data = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "x": _plain(time_s[::step]),
            "y": _plain(values[::step]),
            "line": {"color": colour, "width": width, "dash": dash},
            "hovertemplate": f"%{{y:.4g}} {one.unit}",
        }
        for name, values, colour, width, dash in lines
    ]
    layout = {
        "height": 132,
        "margin": {"l": 46, "r": 6, "t": 6, "b": 24},
        "hovermode": "x unified",
        "xaxis": {"ticksuffix": " s", "showgrid": False, "fixedrange": True, "nticks": 6},
        "yaxis": {"fixedrange": True, "nticks": 4, "zeroline": False},
    }
    return {"data": data, "layout": layout}


def losses(values: EpisodeLosses, name_after: str = "repaired") -> Spec:
    """Return each held-out episode's loss before and after beside the floor's band, worst last."""
    order = np.argsort(values.before, kind="stable")
    place = list(range(1, len(order) + 1))
    ids = [values.ids[i] for i in order]
    before, after = (_plain(np.asarray(v)[order]) for v in (values.before, values.after))
    low, high = (_plain(np.asarray(v)[order]) for v in (values.floor_low, values.floor_high))
    edge = {
        "type": "scatter",
        "mode": "lines",
        "x": place,
        "line": {"width": 0, "shape": "hvh"},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    size = 8 if len(order) <= 60 else 5
    dots = {
        "type": "scatter",
        "mode": "markers",
        "x": place,
        "text": ids,
        "hovertemplate": "%{text}: %{y:.3g} times the floor<extra>%{fullData.name}</extra>",
    }
    data = [
        {**edge, "y": low},
        {**edge, "y": high, "fill": "tonexty", "fillcolor": "@band", "name": "floor", "showlegend": True},
        {**dots, "y": before, "name": "nominal", "marker": {"color": "@before", "size": size}},
        {**dots, "y": after, "name": name_after, "marker": {"color": "@after", "size": size}},
    ]
    layout = {
        "height": 280,
        "margin": {"l": 52, "r": 8, "t": 30, "b": 40},
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "xaxis": {
            "title": {"text": "held-out episode, by loss before", "font": {"size": 11}},
            "showgrid": False,
            "fixedrange": True,
            "nticks": 8,
        },
        "yaxis": {
            "type": "log",
            "title": {"text": "loss / floor", "font": {"size": 11}},
            "fixedrange": True,
            "dtick": "D2",
        },
    }
    return {"data": data, "layout": layout}


def _candidate(one: Ranked, text: str, colour: str) -> Spec:
    """Return one dot with its interval."""
    spec: Spec = {
        "type": "scatter",
        "mode": "markers",
        "x": [one.held_out_gain],
        "y": [text],
        "marker": {"color": colour, "size": 10 if colour == "@accent" else 8},
        "hovertemplate": f"{text}<br>gain %{{x:.4g}}, support {one.support:.2f}"
        + (f"<br>{words.plain(one.reason)}" if one.reason else "")
        + "<extra></extra>",
    }
    if one.gain_low is not None and one.gain_high is not None:
        spec["error_x"] = {
            "type": "data",
            "symmetric": False,
            "array": [one.gain_high - one.held_out_gain],
            "arrayminus": [one.held_out_gain - one.gain_low],
            "color": colour,
            "thickness": 2,
            "width": 0,
        }
    return spec


def _colour_bar(ticks: list[int]) -> Spec:
    """Return a thin colour bar below the map with ratios as ticks."""
    return {
        "orientation": "h",
        "thickness": 8,
        "y": 0,
        "yanchor": "top",
        "ypad": 8,
        "len": 1,
        "outlinewidth": 0,
        "tickvals": [math.log10(t) for t in ticks],
        "ticktext": [f"{t:,}×" for t in ticks],
    }


def _hover(ratio: np.ndarray, p: np.ndarray) -> list[list[str]]:
    """Return `4.2 times the floor, p = 0.001` of each cell."""
    return [
        [f"{words.times(r)}, {words.chance(q) if np.isfinite(q) else 'not tested'}" for r, q in zip(a, b, strict=True)]
        for a, b in zip(ratio, p, strict=True)
    ]


def _cell(ratio: float, p: float) -> str:
    """Return the ratio where it is significant, else nothing."""
    if not (np.isfinite(ratio) and np.isfinite(p) and p <= SIGNIFICANT_P):
        return ""
    return digits(float(f"{ratio:.2g}"))


def _plain(values: np.ndarray) -> list[float | None]:
    """Return numbers with five digits, None where they are not finite."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in np.asarray(values, float)]
