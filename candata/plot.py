"""Figures of an episode, of a diagnosed gap and of two datasets, by matplotlib (extra `plot`).

Each function returns a `matplotlib.figure.Figure`, which a notebook shows: `figure.savefig("gap.png")` keeps it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, open_dataset
from candata.datasets.compare import ComparisonRow, compare
from candata.datasets.distance import Bars
from candata.datasets.summary import ANY_FINGERTIP, touches
from candata.errors import MissingExtraError, UnknownNameError, UsageError
from candata.reports.comparison import row_unit, verdict
from candata.reports.envelope import runs
from candata.reports.inspection import units_of
from candata.reports.lanes import USUAL_CHANNELS, Lane, lanes
from candata.reports.numbers import percent
from candata.reports.outcome import headline
from candata.reports.words import effect_title, readable_name
from candata.schema.channels import DENSE_CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.json_text import read_json
from candata.schema.report import Report

try:
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
except ImportError:
    raise MissingExtraError("matplotlib", "plot") from None

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from candata.gap import Diagnosis

Array = NDArray[np.float64]
#: Channels that are drawn as bars, one a touch.
CONTACT_CHANNELS = ("fingertip_contact", "contact")
#: Width of a figure, height of a panel, and height of a line of a legend or of a bar [inch].
WIDTH_IN, PANEL_IN, LINE_IN = 9.0, 1.9, 0.22
#: Places, candidates and statistics that are drawn; the report and `candata inspect --json` have all.
MOST_PLACES, MOST_CANDIDATES, MOST_STATISTICS = 12, 10, 12
#: Places for bars in the figure of a gap, at least.
FEWEST_SLOTS = 6
#: Colours of lines, of the gap before and after the repair, of contact, and of what is not named.
COLOURS = tuple(colormaps["tab20"](k) for k in (*range(0, 20, 2), *range(1, 20, 2)))
BEFORE, AFTER, TOUCH, QUIET = "#cc6a1f", "#0f766e", "#a86a12", "#a9aeb4"


class _NotebookFigure(Figure):
    """A figure that shows itself in a notebook where pyplot was never imported."""

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG."""
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def episode(recording: Episode, channels: Sequence[str] | None = None) -> Figure:
    """Return a figure of an episode: a panel a channel, all on one time axis.

    Joints are drawn with their commands dashed, the object's pose as position and turn from the first valid row,
    a fingertip's force as the size of its vector, contact as bars.

    Parameters
    ----------
    recording : Episode
        Such as `candata.open_dataset("recordings")[0]`.
    channels : sequence of str, optional
        Channels to draw; by default the object's pose, the joints, forces and contact, as far as the episode has them.

    Raises
    ------
    UnknownNameError
        When the episode has no such channel.
    UsageError
        When nothing is left to draw.
    """
    drawable = [n for n in recording.arrays if not n.endswith(VALID_SUFFIX) and n not in (*DENSE_CHANNELS, "time_ns")]
    for name in channels or ():
        if name not in drawable:
            raise UnknownNameError("channel of the episode", name, drawable)
    names = [
        name for name in ((*USUAL_CHANNELS, *CONTACT_CHANNELS) if channels is None else channels) if name in drawable
    ]
    panels = lanes(recording, [name for name in names if name not in CONTACT_CHANNELS])
    touch = touches(recording) if any(name in CONTACT_CHANNELS for name in names) else {}
    if not panels and not touch:
        raise UsageError(f"episode {recording.meta.id} has nothing to draw", found=", ".join(drawable) or "time alone")
    heights = [max(PANEL_IN, LINE_IN * len(panel.lines)) for panel in panels]
    heights += [PANEL_IN / 2 + LINE_IN * len(touch)] if touch else []
    figure = _figure(sum(heights) + 0.6)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axis, panel in zip(axes, panels, strict=False):
        _draw_lines(axis, recording.time_s, panel)
    if touch:
        _draw_contact(axes[-1], recording.time_s, touch)
    axes[-1].set_xlabel("time [s]")
    facts = (recording.meta.source, recording.meta.task, recording.meta.object, recording.meta.outcome)
    figure.suptitle(", ".join([recording.meta.id, *filter(None, facts)]), x=0.01, ha="left", fontsize=11)
    return figure


def _draw_lines(axis: Axes, time_s: Array, panel: Lane) -> None:
    """Draw the lines of a panel and name them beside it."""
    for k, (name, values) in enumerate(panel.lines.items()):
        colour = COLOURS[k % len(COLOURS)]
        axis.plot(time_s, values, color=colour, linewidth=1.2, label=name)
        if name in panel.commands:
            axis.plot(time_s, panel.commands[name], color=colour, linewidth=0.9, linestyle=(0, (4, 2)))
    axis.set_ylabel(f"[{panel.unit or '1'}]")
    axis.set_title(panel.title, loc="left", fontsize=9)
    axis.grid(alpha=0.3)
    if len(panel.lines) > 1:
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)


def _draw_contact(axis: Axes, time_s: Array, touch: Mapping[str, NDArray[np.bool_]]) -> None:
    """Draw when each fingertip touches, one bar a touch; a row counts until the next."""
    ends = np.append(time_s[1:], time_s[-1])
    names = [name for name in touch if name != ANY_FINGERTIP] or [ANY_FINGERTIP]
    for k, name in enumerate(names):
        spans = [(time_s[start], ends[stop - 1] - time_s[start]) for start, stop in runs(touch[name])]
        axis.broken_barh(spans, (k - 0.35, 0.7), color=TOUCH)
    axis.set_yticks(range(len(names)), [name or "any fingertip" for name in names], fontsize=8)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_title("contact", loc="left", fontsize=9)
    axis.grid(alpha=0.3, axis="x")


def gap(report: Report | Diagnosis | str | Path) -> Figure:
    """Return a figure of a diagnosis: where the gap lies, which candidates gain, and how far the gap shrinks.

    Sizes are in noise floors: 1 is what sensor noise alone would give.

    Parameters
    ----------
    report : Report, Diagnosis, str or Path
        The result of `candata.diagnose`, its report, a `report.json`, or the folder that `--out` of `candata diagnose`
        named.

    Raises
    ------
    UsageError
        When there is no such file, or it is no report.
    """
    record = _report(report)
    places = record.where[:MOST_PLACES]
    candidates = [c for c in record.ranking if c.gain_low is not None and c.gain_high is not None][:MOST_CANDIDATES]
    slots = max(len(places), len(candidates), FEWEST_SLOTS)
    figure = _figure(1.2 + 1.3 * LINE_IN * slots)
    where, which, how_far = figure.subplots(1, 3, width_ratios=[1.2, 1.2, 0.7])
    place_names = [" ".join(filter(None, [readable_name(s.channel), s.element, s.phase])) for s in places]
    _draw_bars(where, "where [loss / floor]", place_names, [s.ratio for s in places], [BEFORE] * len(places), slots)
    named = {(effect.name, effect.element) for effect in record.effects}
    colours = [AFTER if (c.name, c.element) in named else QUIET for c in candidates]
    names, gains = [effect_title(c.name, c.element) for c in candidates], [c.held_out_gain for c in candidates]
    _draw_bars(which, "which [gain, floors]", names, gains, colours, slots)
    for k, candidate in enumerate(candidates):
        which.plot([candidate.gain_low, candidate.gain_high], [k, k], color="black", linewidth=1)
    _draw_shrinkage(how_far, record)
    closed = (
        "" if record.gap is None or record.gap.closed is None else f", {percent(record.gap.closed)} of the gap closed"
    )
    figure.suptitle(f"{headline(record)}: {record.data.dataset}{closed}", x=0.01, ha="left", fontsize=11)
    return figure


def _report(value: Any) -> Report:
    """Return the report that a value holds, or that lies under a path."""
    if isinstance(value, str | Path):
        path = Path(value)
        path = path / "report.json" if path.is_dir() else path
        return Report.parse(read_json(path), path)
    record = value if isinstance(value, Report) else getattr(value, "report", None)
    if not isinstance(record, Report):
        raise UsageError(
            "this is no diagnosis",
            expected="a Report, what candata.diagnose returns, or the path of a report.json",
            found=type(value).__name__,
        )
    return record


def _draw_bars(
    axis: Axes, title: str, names: Sequence[str], sizes: Sequence[float], colours: Sequence[str], slots: int
) -> None:
    """Draw level bars with their names at the left, in the first of `slots` places; say so where there are none."""
    axis.set_title(title, loc="left", fontsize=9)
    if not names:
        axis.text(0.5, 0.5, "nothing", ha="center", va="center", transform=axis.transAxes, color=QUIET)
        axis.set_axis_off()
        return
    axis.barh(range(len(names)), sizes, color=list(colours), height=0.7)
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.set_ylim(slots - 0.5, -0.5)
    axis.grid(alpha=0.3, axis="x")


def _draw_shrinkage(axis: Axes, report: Report) -> None:
    """Draw the gap before and after the repair above the floor."""
    if report.gap is None:
        _draw_bars(axis, "how far [floors]", [], [], [], FEWEST_SLOTS)
        return
    sizes = [report.gap.before, report.gap.after]
    axis.bar(["before", "after"], sizes, color=[BEFORE, AFTER], width=0.6)
    axis.axhline(report.gap.floor, color="black", linewidth=1, linestyle=(0, (4, 2)))
    for k, size in enumerate(sizes):
        axis.annotate(f"{size:.3g}", (k, size), ha="center", va="bottom", fontsize=8)
    axis.margins(y=0.12)
    axis.set_title("how far [floors]", loc="left", fontsize=9)


def comparison(this: Dataset | str | Path, against: Dataset | str | Path) -> Figure:
    """Return a figure of two datasets: the distributions of the statistics that lie furthest apart.

    They are those of `candata inspect THIS --against AGAINST`; a star marks a difference that luck would not make.

    Parameters
    ----------
    this, against : Dataset, str or Path
        Datasets or their folders.

    Raises
    ------
    UsageError
        When there is no dataset.
    DataError
        When a part is damaged, or the two have no statistic in common.
    """
    pair = compare(_dataset(this), _dataset(against))
    record = pair.comparison
    drawn = list(zip(record.rows, pair.bars, strict=True))[:MOST_STATISTICS]
    units = units_of({*record.this.scenes, *record.against.scenes})
    column_count = min(len(drawn), 3)
    row_count = -(-len(drawn) // column_count)
    figure = _figure(PANEL_IN * row_count + 0.7)
    axes = figure.subplots(row_count, column_count, squeeze=False).ravel()
    for axis, (row, bars) in zip(axes, drawn, strict=False):
        _draw_distributions(axis, row, bars, row_unit(row, units), (record.this.label, record.against.label))
    for axis in axes[len(drawn) :]:
        axis.set_axis_off()
    axes[0].legend(fontsize=7, frameon=False)
    figure.suptitle(verdict(record), x=0.01, ha="left", fontsize=10, wrap=True)
    return figure


def _dataset(value: Dataset | str | Path) -> Dataset:
    """Return the dataset itself, or the newest version of the one in a folder."""
    return value if isinstance(value, Dataset) else open_dataset(value)


def _draw_distributions(axis: Axes, row: ComparisonRow, bars: Bars, unit: str, labels: tuple[str, str]) -> None:
    """Draw both distributions of a statistic."""
    if len(bars.edges) > 1 and np.ptp(bars.edges) > 0:
        axis.stairs(bars.against, bars.edges, fill=True, color=QUIET, alpha=0.6, label=labels[1])
        axis.stairs(bars.this, bars.edges, color=BEFORE, linewidth=1.4, label=labels[0])
    star = " *" if row.differs else ""
    axis.set_title(f"{row.statistic} {row.element}{star}".strip(), loc="left", fontsize=8)
    axis.set_xlabel(f"[{unit or '1'}]", fontsize=8)
    axis.tick_params(labelsize=7)


def _figure(height_in: float) -> Figure:
    """Return an empty figure that no global state knows, and that a notebook shows as a picture."""
    figure = _NotebookFigure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
