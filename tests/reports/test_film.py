"""Pictures of an episode: what moves is seen, marks and ghosts lie where they belong, with and without GL."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import MissingExtraError, SetupError, UnknownNameError, UsageError
from candata.reports.film import Moments, footage, pictures
from candata.reports.film_file import check_film, strip, write_film
from candata.reports.ghost import COLOUR
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

ROWS, SIZE = 5, (80, 60)
TWO = Moments(count=2)
LIFTED = {"object_pose": np.array([[0, 0, 0.04, 1, 0, 0, 0]] * 4 + [[0.1, 0.0, 0.14, 1, 0, 0, 0]])}


def make_episode(name="e", rows=ROWS, **changes):
    """An episode of the gripper's scene in which nothing moves and nothing touches."""
    scene = load_scene("gripper_tabletop")
    count, tips = len(scene.file.joints), len(scene.file.fingertips)
    arrays = {
        "time_ns": np.arange(rows) * 20_000_000,
        "object_pose": np.tile([0, 0, 0.04, 1.0, 0, 0, 0], (rows, 1)),
        "joint_position": np.zeros((rows, count)),
        "fingertip_force": np.zeros((rows, tips, 3)),
        "fingertip_contact": np.zeros((rows, tips), bool),
    }
    meta = {"source": "sim", "rate_hz": 50.0, "scene": "gripper_tabletop", "joint_names": scene.file.joints}
    meta |= {k: changes.pop(k) for k in list(changes) if k in (*meta, "labels", "object")}
    arrays = {k: v for k, v in (arrays | changes).items() if v is not None}
    return Episode(EpisodeMeta.model_validate({"id": name, **meta}), arrays)


@pytest.fixture
def dataset(tmp_path):
    def make(*episodes, name="ds"):
        root = create_dataset(tmp_path / name)
        append(root, list(episodes), Lineage(operation="test"))
        return open_dataset(root)

    return make


def frames_of(shown, **options):
    """All pictures of a footage, as signed numbers, and the library that made them."""
    chunks = list(pictures(shown, *SIZE, **options))
    return np.array([frame for chunk in chunks for frame in chunk.frames], int), chunks[0].library


def below_text(frames):
    """The part of the pictures in which no time is written."""
    return frames[:, 12:]


def test_the_picture_changes_where_the_object_moves_and_else_nowhere(dataset, no_gl):
    still, _ = frames_of(footage(dataset(make_episode()), "e", TWO))
    moved, library = frames_of(footage(dataset(make_episode(**LIFTED), name="moved"), "e", TWO))
    assert library is None
    assert np.array_equal(*below_text(still))
    assert np.abs(np.diff(below_text(moved), axis=0)).max() > 50
    assert not np.array_equal(still[0, :12], still[1, :12])  # the time


@pytest.mark.parametrize("drawn", [True, False])
def test_the_ghost_is_seen_apart_from_the_object(dataset, no_gl, monkeypatch, drawn):
    if not drawn:
        monkeypatch.delenv("MUJOCO_GL")
    data, other = dataset(make_episode()), dataset(make_episode("o", **LIFTED), name="other")
    frames, library = frames_of(footage(data, "e", TWO, over=(other, "o")))
    if not drawn and library is None:
        pytest.skip("no GL library here")
    change = np.diff(below_text(frames), axis=0)[0]
    assert ((change[..., 0] - change[..., 1]) > 40).sum() > 20  # pixels that turned pink
    unmixed_colour = 255 * np.array(COLOUR)
    assert (np.abs(frames - unmixed_colour).max(axis=3) > 30).all()  # what lies behind is seen through it


def test_a_ghost_that_has_ended_is_gone(dataset, no_gl):
    data, other = dataset(make_episode()), dataset(make_episode("e", rows=2), name="other")
    shown = footage(data, "e", TWO, over=(other, "e"))
    assert np.isfinite(shown.ghost.qpos).all(axis=1).tolist() == [True, False]


def test_a_mark_lies_on_the_fingertip_in_touch_and_grows_with_its_force(dataset, no_gl):
    def marked(force_n):
        contact, force = np.zeros((ROWS, 3), bool), np.zeros((ROWS, 3, 3))
        contact[-1, 1], force[-1, 1, 0] = True, force_n
        data = dataset(make_episode(fingertip_contact=contact, fingertip_force=force), name=f"f{force_n}")
        frames, _ = frames_of(footage(data, "e", TWO), camera="report")
        return np.abs(np.diff(below_text(frames), axis=0)[0]).max(axis=2) > 0

    light, firm = marked(0.4), marked(9.0)
    assert 0 < light.sum() < firm.sum()
    rows, columns = np.nonzero(firm)
    light_rows, light_columns = np.nonzero(light)
    assert (rows.mean(), columns.mean()) == pytest.approx((light_rows.mean(), light_columns.mean()), abs=1)  # pixels


def test_invalid_rows_are_left_out_and_unknown_joints_said(dataset):
    pose = make_episode()["object_pose"].copy()
    pose[0] = np.nan
    names = (*load_scene("gripper_tabletop").file.joints[:-1], "tail")
    data = dataset(make_episode(object_pose=pose, object_pose_valid=np.arange(ROWS) > 0, joint_names=names))
    shown = footage(data, "e", TWO)
    assert shown.time_s == pytest.approx([0.02, 0.08])
    assert [note.split(":")[0] for note in shown.notes] == [
        "joints not in the episode, left where the model has them",
        "joints that the scene lacks, not shown",
    ]


def test_moments_follow_the_clock(dataset):
    data = dataset(make_episode(rows=51))
    assert len(footage(data, "e", Moments(fps=10)).qpos) == 11
    assert footage(data, "e", Moments(fps=10)).time_s == pytest.approx(np.arange(11) / 10)
    assert len(footage(data, "e", Moments(count=4)).qpos) == 4


def test_another_scene_digest_is_said(dataset):
    data = dataset(make_episode(labels={"scene_digest": "0" * 64}))
    (note,) = footage(data, "e", TWO).notes
    assert "not that of the episode" in note


@pytest.mark.parametrize(
    ("changes", "scene", "text"),
    [
        ({"scene": None}, None, "name no scene"),
        ({"scene": "../mine.yaml"}, None, "is not built in"),
        ({"scene": "gripper_tabletop+mug"}, None, r"gripper_tabletop\+FOLDER"),
        ({"joint_names": tuple("abcdefgh")}, None, "not those of the scene"),
        ({"object_pose": None}, "cube_toss", "does not fit"),
    ],
)
def test_a_scene_that_is_missing_or_does_not_fit_is_one_error(dataset, changes, scene, text):
    with pytest.raises(UsageError, match=text):
        footage(dataset(make_episode(**changes)), "e", TWO, scene)


def test_unknown_episodes_and_cameras_are_named(dataset):
    data = dataset(make_episode())
    with pytest.raises(UnknownNameError, match="unknown episode 'x'"):
        footage(data, "x", TWO)
    with pytest.raises(UnknownNameError, match="unknown camera 'x'"):
        next(pictures(footage(data, "e", TWO), *SIZE, camera="x"))


def test_a_ghost_of_another_object_is_said(dataset):
    data, other = dataset(make_episode(object="can")), dataset(make_episode(object="mug"), name="other")
    (note,) = footage(data, "e", TWO, over=(other, "e")).notes
    assert note == "the ghost is mug, drawn in the shape of can"


def test_a_ghost_needs_an_object(dataset):
    data, other = dataset(make_episode()), dataset(make_episode(object_pose=None), name="other")
    with pytest.raises(UsageError, match="no object to show as a ghost"):
        footage(data, "e", TWO, over=(other, "e"))


IMAGES = [np.full((9, 15, 3), value, np.uint8) for value in (10, 120, 240)]


def test_a_strip_holds_all_pictures_side_by_side():
    image = strip(IMAGES)
    assert image.shape == (9, 3 * 15 + 2 * 4, 3)
    assert image[4, [7, 26, 45], 0].tolist() == [10, 120, 240]
    assert strip(IMAGES * 3).shape == (2 * 9 + 4, 6 * 15 + 5 * 4, 3)


def test_a_gif_holds_all_pictures_at_their_pace(tmp_path):
    pillow = pytest.importorskip("PIL.Image")
    write_film(tmp_path / "a.gif", IMAGES, 10)
    with pillow.open(tmp_path / "a.gif") as image:
        assert (image.n_frames, image.size, image.info["duration"]) == (3, (15, 9), 100)
        image.seek(1)
        assert abs(image.convert("RGB").getpixel((7, 4))[0] - 120) < 3  # its palette may round a little


def test_an_mp4_of_odd_size_is_written(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write_film(tmp_path / "a.mp4", IMAGES, 10)
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4")) == (3, pytest.approx(0.3))


@pytest.mark.parametrize(("name", "module"), [("a.gif", "PIL"), ("a.mp4", "imageio_ffmpeg")])
def test_a_missing_package_is_one_hint(monkeypatch, tmp_path, name, module):
    imported = builtins.__import__

    def without(package, *arguments, **options):
        if package == module:
            raise ImportError(package)
        return imported(package, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"candata\[film\]"):
        check_film(tmp_path / name)


def test_bad_endings_and_places_leave_nothing(tmp_path):
    with pytest.raises(UsageError, match=r"one of \.gif, \.mp4, \.png"):
        write_film(tmp_path / "a.jpg", IMAGES, 10)
    (tmp_path / "a.png").mkdir()
    with pytest.raises(SetupError, match="cannot be written"):
        write_film(tmp_path / "a.png", IMAGES, 10)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
