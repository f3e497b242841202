"""The elbow tosses: original files and the prepared folder, the example's map and scene."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from candata.errors import DataError
from candata.fetch._files import git_tree_hash
from candata.fetch.elbow_tosses import FOLDER, MAP, TOSSES, toss_columns
from candata.formats._mapping import read_map

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "elbow_tosses"


def original(frames: np.ndarray) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        archive.writestr("archive/data/0", frames.astype("<f8").tobytes())
    return held.getvalue()


def frames_of(hinge, w) -> np.ndarray:
    frames = np.zeros((len(hinge), 15))
    frames[:, 0], frames[:, 7] = w, hinge
    frames[:, 4:7] = [1, 2, 3]
    return frames


def test_the_hinge_goes_on_past_half_a_turn_and_quaternions_keep_their_sign():
    columns = toss_columns(
        {"3": original(frames_of([3.1, -3.1, -3.0], [1, -1, 1])), "1": original(frames_of([0], [1]))}
    )
    assert columns["episode"].tolist() == [1, 3, 3, 3]
    np.testing.assert_allclose(columns["hinge"][1:], [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3.0])
    assert columns["qw"].tolist() == [1, 1, 1, 1]
    assert columns["pz"].tolist() == [3] * 4


def test_another_archive_is_refused(tmp_path):
    tosses = {"0.pt": original(frames_of([0, 0.1], [1, 1]))}
    path = tmp_path / "repository.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        for name, content in {f"{FOLDER}/0.pt": tosses["0.pt"], "LICENSE": b"text"}.items():
            member = tarfile.TarInfo(f"dair_pll-b5d0a2f9/{name}")
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    with pytest.raises(DataError, match="is not the published folder"):
        TOSSES.from_archive(path)
    with pytest.raises(DataError, match="the licence file is missing or another one"):
        TOSSES.from_archive(path, git_tree_hash(tosses))


def test_the_example_s_map_is_the_source_s():
    assert read_map(EXAMPLE / "map.yaml") == MAP


def test_the_example_s_links_are_those_of_the_recordings():
    model = mujoco.MjModel.from_xml_path(str(EXAMPLE / "scene.xml"))
    for link in ("link1", "link2"):
        np.testing.assert_allclose(model.geom(link).size, [0.05, 0.025, 0.025])
    np.testing.assert_allclose(model.body("link2").pos, [-0.035, 0.06, 0])
    np.testing.assert_allclose(model.body_mass[1:], 0.37)


def test_the_prepared_tosses(shared):
    episodes = list(TOSSES.from_folder(shared / "realdata" / "elbow_tosses").episodes)
    assert len(episodes) == 541
    assert {len(e) for e in episodes} == {121}
    assert episodes[0].meta.joint_names == ("hinge",)
    # Velocities are backward differences of the poses, most to rounding: one row off would leave 0.07 m/s in free fall.
    moved = np.diff(episodes[0]["object_pose"][:6, :3], axis=0) * 148
    assert np.median(np.abs(moved - episodes[0]["object_velocity"][1:6, :3])) < 0.01
