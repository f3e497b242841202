"""FoundationPose folders: matrices become poses, and what is no rigid motion is refused by its frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from candata.errors import DataError, UsageError
from candata.formats import Reading
from candata.plugins import load
from candata.schema.episode import Episode

FORMAT = load("candata.formats", "FORMAT", "foundationpose")
CAMERA = [[0, -1, 0, 0.5], [0, 0, -1, 0.2], [1, 0, 0, 0], [0, 0, 0, 1]]


def matrices(count: int = 12) -> np.ndarray:
    """Motions `(count, 4, 4)` that turn past half a turn, so that a quaternion's sign would jump."""
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 5, count)[:, None] * [0.6, 0, 0.8]).as_matrix()
    made[:, :3, 3] = np.arange(count)[:, None] * [0.01, 0.02, 0.03]
    return made


def write(folder: Path, found: np.ndarray, names=None, pictures=()) -> Path:
    """Write a sequence as FoundationPose writes its results."""
    (folder / "ob_in_cam").mkdir(parents=True)
    for k, matrix in enumerate(found):
        np.savetxt(folder / "ob_in_cam" / f"{names[k] if names else f'{k:07d}'}.txt", matrix)
    np.savetxt(folder / "cam_K.txt", [[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    for name in pictures:
        (folder / "rgb").mkdir(exist_ok=True)
        (folder / "rgb" / f"{name}.png").write_bytes(b"")
    return folder


def read(folder: Path, mapping=None, **told) -> list[Episode]:
    path = folder.parent / "frames.yaml"
    path.write_text(yaml.safe_dump({"rate_hz": 30} if mapping is None else mapping))
    return list(FORMAT.read(folder, Reading(mapping=path, **told)))


def test_matrices_become_poses_at_the_stated_rate(tmp_path):
    truth = matrices()
    notes: list[str] = []
    (episode,) = read(write(tmp_path / "mustard", truth), {"rate_hz": 30, "object": "mustard"}, note=notes.append)
    assert (episode.meta.id, episode.meta.object, episode.meta.rate_hz) == ("mustard", "mustard", 30)
    assert episode["time_ns"].tolist() == [round(k * 1e9 / 30) for k in range(12)]
    pose = episode["object_pose"].astype(float)
    assert pose[:, :3] == pytest.approx(truth[:, :3, 3])
    # savetxt keeps 18 digits; float32 is the limit.
    assert Rotation.from_quat(pose[:, [4, 5, 6, 3]]).as_matrix() == pytest.approx(truth[:, :3, :3], abs=1e-6)
    assert ((pose[1:, 3:] * pose[:-1, 3:]).sum(axis=1) > 0).all()
    assert "camera's frame" in notes[0]


def test_the_camera_s_pose_takes_them_to_the_world(tmp_path):
    truth = matrices()
    (episode,) = read(write(tmp_path / "s", truth), {"rate_hz": 30, "camera_pose": CAMERA})
    assert episode["object_pose"][:, :3] == pytest.approx((np.array(CAMERA) @ truth)[:, :3, 3], abs=1e-6)


def test_names_may_be_times(tmp_path):
    times = [1_581_120_424_100_262_102 + k * 33_000_000 for k in range(12)]
    folder = write(tmp_path / "s", matrices(), times)
    (episode,) = read(folder, {"rate_hz": 30, "stamps": "ns"})
    assert episode["time_ns"].tolist() == times
    for wrong in ({"rate_hz": 30, "stamps": "s"}, {"rate_hz": 30, "stamps": "us"}, {"rate_hz": 5, "stamps": "ns"}):
        with pytest.raises(DataError, match="file names"):
            read(folder, wrong)
    with pytest.raises(DataError, match="lie too far apart") as caught:
        read(folder)
    assert "stamps: ns" in str(caught.value)


@pytest.mark.parametrize("how", ["number", "picture", "nan"])
def test_a_missing_frame_is_refused_or_marked(tmp_path, how):
    found, names = matrices(), [f"frame_{k:04d}" for k in range(12)]
    if how == "nan":
        found[5] = np.nan
    folder = write(tmp_path / "s", found, names, names if how == "picture" else ())
    if how != "nan":
        (folder / "ob_in_cam" / "frame_0005.txt").unlink()
    with pytest.raises(DataError, match="frames are missing") as caught:
        read(folder)
    assert caught.value.where.index == 5
    (episode,) = read(folder, allow_gaps=True)
    assert np.flatnonzero(~episode.valid("object_pose")).tolist() == [5]
    assert episode.meta.invalid_counts == {"object_pose": 1}
    assert len(episode) == 12


def scaled(matrix):
    matrix[:3, :3] *= 1.01


def mirrored(matrix):
    matrix[:3, 0] *= -1


def bent(matrix):
    matrix[3, 0] = 0.1


@pytest.mark.parametrize(("bend", "words"), [(scaled, "off by"), (mirrored, "mirror image"), (bent, "last row")])
def test_what_is_no_rigid_motion_is_refused_by_its_frame(tmp_path, bend, words):
    found = matrices()
    bend(found[7])
    for allow_gaps in (True, False):
        with pytest.raises(DataError, match="frame 0000007 is no rigid motion") as caught:
            read(write(tmp_path / str(allow_gaps), found), allow_gaps=allow_gaps)
        assert words in str(caught.value)
        assert "0000007.txt" in str(caught.value.where)


@pytest.mark.parametrize("text", ["", "1 2 3", "a " * 16, "\x00\xff", "1 " * 17])
def test_a_file_that_is_no_matrix_is_refused(tmp_path, text):
    folder = write(tmp_path / "s", matrices())
    (folder / "ob_in_cam" / "0000003.txt").write_text(text, encoding="latin-1")
    with pytest.raises(DataError, match="frame 0000003 holds no"):
        read(folder)


def test_folders_and_maps_that_are_wrong(tmp_path):
    folder = write(tmp_path / "s", matrices())
    with pytest.raises(UsageError, match="a map is needed") as caught:
        list(FORMAT.read(folder, Reading()))
    assert "rate_hz: 30" in str(caught.value)
    with pytest.raises(DataError, match="holds no poses"):
        read(folder / "rgb")
    for wrong in ({}, {"rate_hz": -1}, {"rate_hz": 30, "camera_pose": [[1, 0]]}, {"rate_hz": 30, "stamps": "h"}):
        with pytest.raises(UsageError, match=r"frames\.yaml"):
            read(folder, wrong)
    with pytest.raises(UsageError, match="camera_pose is no rigid motion"):
        read(folder, {"rate_hz": 30, "camera_pose": [[2, 0, 0, 0], *CAMERA[1:]]})
    (folder / "ob_in_cam" / "last.txt").write_text("")
    with pytest.raises(DataError, match="does not end in its number"):
        read(folder)
    (folder / "ob_in_cam" / "last.txt").rename(folder / "ob_in_cam" / "x_3.txt")
    with pytest.raises(DataError, match="two frames bear one number"):
        read(folder)


def test_a_sequence_without_a_pose_is_refused(tmp_path):
    folder = write(tmp_path / "s", matrices() * np.nan)
    with pytest.raises(DataError, match="no frame holds a pose"):
        read(folder, allow_gaps=True)


def test_a_folder_of_sequences_gives_an_episode_each(tmp_path):
    write(tmp_path / "all" / "a", matrices())
    write(tmp_path / "all" / "b", matrices(5))
    assert [(e.meta.id, len(e)) for e in read(tmp_path / "all")] == [("a", 12), ("b", 5)]
