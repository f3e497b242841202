"""Every setting of the import of a log."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from candata.align import MAX_GAP_PERIODS
from candata.schema.record import Record
from candata.schema.scene import Positive, SceneFile


class ImportRecipe(Record):
    """Every setting of an import; null takes the log's, or the scene's, own.

    Attributes
    ----------
    episode : str
        Id of the episode.
    rate_hz : float, optional
        Rate of the grid where no scene is given; the device's by default.
    newton_per_count : float, optional
        Scale of the forces.
    threshold_n : float
        Contact is |Fx| + |Fy| + |Fz| above it.
    release_n : float, optional
        Contact ends below it; by default where the threshold is no longer exceeded.
    max_gap_periods : float
        Neighbours further apart, in periods of their stream, are the ends of a gap.
    uncalibrated : bool
        Take a log without calibration: nothing is subtracted from its forces.
    scene : str, optional
        Name of the scene; `roles` is what its file says.
    object, task : str, optional
        Of the episode; else what the companions say, or the scene.
    point_cloud : str, optional
        Name of the cloud of the scene's object: of episodes with poses of that object.
    outcome : str, optional
        Of the episode, and of those of a session that no mark judges.
    labels : dict of str to bool, int, float or str
        What else is known of the episodes.
    align : str
        How streams beside the hand are put on the clock of the log. `device`: by the device's own clock where it has
        one, else by the stamps; `clocks`: by motion too where it has none; `stamps`: by the stamps of arrival alone.
    """

    episode: str
    rate_hz: Positive | None = None
    newton_per_count: Positive | None = None
    threshold_n: Positive = 0.3
    release_n: Positive | None = Field(default=None, exclude_if=lambda force: force is None)
    max_gap_periods: float = Field(default=MAX_GAP_PERIODS, gt=1.0)
    uncalibrated: bool = False
    scene: str | None = None
    roles: SceneFile | None = None
    object: str | None = None
    task: str | None = None
    point_cloud: str | None = Field(default=None, exclude_if=lambda name: name is None)
    outcome: str | None = Field(default=None, exclude_if=lambda outcome: outcome is None)
    labels: dict[str, bool | int | float | str] = Field(default={}, exclude_if=lambda labels: not labels)
    align: Literal["device", "clocks", "stamps"] = "device"
