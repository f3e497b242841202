"""Mistakes that only the scene's own motion tells: each is named with what fits better, or as undecidable."""

from __future__ import annotations

import numpy as np
import pytest

from candata.checks import check, defects
from candata.datasets import open_dataset
from candata.simulate.episodes import EpisodeJob, make_episodes

#: Level and words of what is said of each mistake: the reading that fits better, with its error.
SAID = {
    "tips_exchanged": ("error", "right_tip reads what thumb_tip feels, thumb_tip reads what right_tip feels"),
    "joints_exchanged": ("error", "thumb_end follows the command of thumb_base: as if these columns were exchanged"),
    "commands_exchanged": ("error", "thumb_end follows the command of thumb_base: as if these columns were exchanged"),
    "pairs_exchanged": ("error", "columns of thumb_base and thumb_end were exchanged in joint_position and action"),
    "tip_in_kilograms": ("error", "thumb_tip 0.102 times those (kgf: 0.102)"),
    "force_in_kilograms": ("error", "0.102 times those on all fingertips (kgf: 0.102)"),
    "force_negated": ("error", "agree with the scene when taken as of the other sign"),
    "force_turned": ("error", "forces are in a turned frame"),
    "force_mirrored": ("error", "forces are in a turned frame"),
    "force_rows_late": ("info", "as if they came 3 rows (60 ms) late: force error"),
    "force_instant": ("warning", "as if `force: instant`: force error"),
    "pose_rows_late": ("info", "as if they came 3 rows (60 ms) late: position error"),
    "quaternion_conjugated": ("error", "as if they were conjugated: rotation error"),
    "world_mirrored": ("error", "as if its y axis were reversed"),
    "world_exchanged": ("error", "as if its axes x and y were exchanged"),
    "action_previous": ("error", "as if commands were logged late: expected commands that come first, found 1.0 steps"),
}
UNDECIDABLE = (
    "joints exchanged together with their commands",
    "conjugated quaternions",
    "a left-handed world, y axis reversed",
    "a left-handed world, axes x and y exchanged",
    "poses that come late",
    "forces that come late",
    "forces of the other sign",
    "axes of the forces in another order",
    "fingertips right_tip and thumb_tip exchanged",
    "forces of one instant taken for means, or the reverse",
    "forces in another unit",
)


def said(folder, episodes, mistake, scene):
    """Level and message of what `scene_match` finds in stored episodes with a mistake."""
    rng = np.random.default_rng(0)
    raws = [defects.as_stored(e) if mistake is None else defects.with_defect(e, mistake, rng) for e in episodes]
    root = defects.write(folder / "set", raws)
    return [(f.level, f.message) for f in check(open_dataset(root), scene=scene, rules=["scene_match"])]


def motions(scene, policy, count=6):
    """Episodes of one motion of a scene with its declared noise."""
    jobs = [EpisodeJob(f"{policy}-{i}", i, policy, 3) for i in range(count)]
    return make_episodes(scene, jobs, duration_s=1.5, noise=scene.file.noise)


def test_of_sound_recordings_nothing_is_said_nor_left_open(light, light_scene, tmp_path):
    assert said(tmp_path, light, None, light_scene) == []


@pytest.mark.parametrize("mistake", SAID)
def test_a_mistake_is_said_once_with_what_fits_better(light, light_scene, tmp_path, mistake):
    level, words = SAID[mistake]
    findings = said(tmp_path, light, mistake, light_scene)
    # Readings that come late may leave other mistakes undecidable.
    ((found_level, message),) = [finding for finding in findings if finding[0] != "unknown"]
    assert found_level == level
    assert words in message


def test_a_push_tells_which_fingertip_is_which(light_scene, tmp_path):
    """Two of three fingertips feel nearly the same: their directions tell nothing, the size of the error does."""
    ((level, message),) = said(tmp_path, motions(light_scene, "push"), "tips_exchanged", light_scene)
    assert level == "error"
    assert "as if right_tip and thumb_tip were exchanged: force error" in message


@pytest.mark.parametrize("mistake", [None, "pairs_exchanged", "force_negated", "quaternion_conjugated"])
def test_what_touches_nothing_leaves_mistakes_undecidable_and_they_are_listed(light_scene, tmp_path, mistake):
    ((level, message),) = said(tmp_path, motions(light_scene, "free_sweep"), mistake, light_scene)
    assert level == "unknown"
    assert [name for name in UNDECIDABLE if name not in message] == []


def test_a_lateness_that_too_few_episodes_show_is_listed_as_undecidable(light_scene, tmp_path):
    """Two pushes move the object; four sweeps in free air say nothing, for or against."""
    episodes = [*motions(light_scene, "push", 2), *motions(light_scene, "free_sweep", 4)]
    ((level, message),) = said(tmp_path, episodes, "pose_rows_late", light_scene)
    assert level == "unknown"
    assert "poses that come late" in message
