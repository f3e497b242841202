"""Rule: joint readings do not jump out for one row and back, as those of an encoder that was misread do."""

from __future__ import annotations

from collections.abc import Iterator

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView
from candata.gap.data.faults import JOINT_LEAST, spike_rows

REMEDY = "mark these rows invalid (NaN in the table, then --allow-gaps), and look at the encoder's wire and bus"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield joints whose readings jump out for one row and back."""
    joint = view.values("joint_position")
    if joint is None:
        return
    for column, name in enumerate(view.elements("joint_position")):
        reading = joint[:, column : column + 1]
        rows = spike_rows(reading, JOINT_LEAST)
        if rows.any():
            sizes = [abs(float(reading[k, 0] - (reading[k - 1, 0] + reading[k + 1, 0]) / 2)) for k in rows.nonzero()[0]]
            yield view.finding(
                "warning",
                "encoder_spikes",
                "a joint reading jumps out for one row and back",
                f"joint {name} by up to {max(sizes):.3g}, {rows.sum()} times",
                "joint_position",
                rows,
                REMEDY,
                joint=name,
                spikes=int(rows.sum()),
                largest=max(sizes),
            )


RULE = Rule(meaning="joint readings do not jump out and back", episode=_episode, needs=("joint_position",))
