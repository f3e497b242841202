"""The cube tosses: the same episodes from the original archive and from a prepared folder."""

import io
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

from candata.errors import DataError
from candata.fetch._files import git_tree_hash
from candata.fetch.cube_tosses import FOLDER, MAP, SOURCE, TOSSES, toss_columns
from candata.formats._mapping import read_map

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "cube_tosses"


def original(frames: np.ndarray) -> bytes:
    """A toss as the repository holds it: a torch archive with one float64 storage."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        archive.writestr("archive/data.pkl", b"not read")
        archive.writestr("archive/data/0", frames.astype("<f8").tobytes())
    return held.getvalue()


def frames_of(quaternion, rows: int = 3) -> np.ndarray:
    frames = np.arange(rows * 13, dtype=float).reshape(rows, 13)
    frames[:, :4] = quaternion
    return frames


@pytest.fixture
def archive(tmp_path) -> tuple[Path, str]:
    """An archive of two tosses, and git's name for their folder."""
    tosses = {"10.pt": original(frames_of([1, 0, 0, 0])), "2.pt": original(frames_of([-1, 0, 0, 0], 4))}
    path = tmp_path / "repository.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        members = {f"{FOLDER}/{name}": content for name, content in tosses.items()}
        for name, content in {**members, "LICENSE": b"text", "assets/other.pt": b""}.items():
            member = tarfile.TarInfo(f"dair_pll-523d372d/{name}")
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return path, git_tree_hash(tosses)


SHA256_OF_TEXT = "982d9e3eb996f559e633f4d194def3761d909f5a3b647d1a851fead67c32c9d1"


def test_an_archive_gives_the_tosses_in_the_order_of_their_numbers(archive):
    path, tree = archive
    fetched = TOSSES.from_archive(path, tree, SHA256_OF_TEXT)
    episodes = list(fetched.episodes)
    assert [(e.meta.id, len(e)) for e in episodes] == [("tosses-2", 4), ("tosses-10", 3)]
    assert fetched.notice == "text"
    np.testing.assert_array_equal(episodes[1]["object_pose"][0], [4, 5, 6, 1, 0, 0, 0])
    np.testing.assert_array_equal(episodes[1]["object_velocity"][0], [10, 11, 12, 7, 8, 9])


def test_an_archive_with_other_data_or_licence_is_refused(archive):
    path, tree = archive
    with pytest.raises(DataError, match="is not the published folder") as caught:
        TOSSES.from_archive(path)
    assert caught.value.found == f"git tree {tree}, 2 files"
    with pytest.raises(DataError, match="the licence file is missing or another one"):
        TOSSES.from_archive(path, tree)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DataError, match="the archive cannot be read") as caught:
        TOSSES.from_archive(path, tree)
    assert caught.value.fix == "delete the file and fetch again"


def test_an_archive_in_the_cache_is_not_downloaded_again(archive, tmp_path):
    path, tree = archive
    path.rename(tmp_path / "dair_pll-523d372d8c2b.tar.gz")
    said = []
    with pytest.raises(DataError, match=tree):  # this archive holds two tosses only
        SOURCE.download(tmp_path, said.append)
    assert len(said) == 1
    assert said[0].startswith("using ")


def test_orientations_start_with_a_positive_real_part():
    columns = toss_columns({"0": original(frames_of([-0.6, 0, 0.8, 0]))})
    assert columns["qw"].tolist() == [0.6] * 3
    assert columns["qy"].tolist() == [-0.8] * 3
    np.testing.assert_array_equal(columns["t"], np.arange(3) / 148)


def test_a_toss_that_is_no_archive_is_named():
    with pytest.raises(DataError, match="a toss cannot be read") as caught:
        toss_columns({"7": b"garbage"})
    assert caught.value.where.episode == "7"


def test_a_folder_without_the_licence_or_with_another_table_is_refused(tmp_path, shared):
    with pytest.raises(DataError, match=r"LICENSE.txt is missing"):
        TOSSES.from_folder(tmp_path)
    (tmp_path / "LICENSE.txt").write_bytes((shared / "realdata/cube_tosses/LICENSE.txt").read_bytes())
    (tmp_path / "tosses.parquet").write_bytes(b"PAR1")
    with pytest.raises(DataError, match=r"tosses.parquet is not the published file"):
        TOSSES.from_folder(tmp_path)


def test_the_example_s_map_is_the_source_s():
    assert read_map(EXAMPLE / "map.yaml") == MAP


def test_the_example_s_scene_is_the_cube_of_the_recordings():
    import mujoco

    from candata.schema.scene import SceneFile

    scene = SceneFile.parse(yaml.safe_load((EXAMPLE / "scene.yaml").read_text()), "scene.yaml")
    model = mujoco.MjModel.from_xml_path(str(EXAMPLE / scene.model))
    body, box = model.body(scene.object), model.geom("cube")
    np.testing.assert_allclose(box.size, 0.1048 / 2)
    np.testing.assert_allclose(body.mass, 0.37)
    np.testing.assert_allclose(body.inertia, 8.1e-4)
    assert model.geom(scene.support).friction[0] == box.friction[0] == 0.18
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    np.testing.assert_allclose(1 / (model.opt.timestep * scene.rate_hz), 10)


def test_the_prepared_tosses(shared):
    episodes = list(TOSSES.from_folder(shared / "realdata" / "cube_tosses").episodes)
    assert len(episodes) == 550
    assert sum(map(len, episodes)) == 58_362
    lengths = [len(episode) for episode in episodes]
    assert (min(lengths), max(lengths)) == (85, 139)
    # Backward differences: the velocity of row k is that of the step from k-1 to k. One row of delay would
    # give 9.81 / 148 = 0.066 m/s in free fall; the recorded filter leaves up to 0.012.
    early = episodes[0]
    moved = np.diff(early["object_pose"][:8, :3], axis=0) * 148
    assert np.abs(moved - early["object_velocity"][1:8, :3]).max() < 0.02
    assert {e.meta.source for e in episodes} == {"real"}
    assert episodes[3].meta.object == "cube"
