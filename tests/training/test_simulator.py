"""The simulator as a forecaster: right where the world is the scene's, blind to what comes after the present."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.errors import DataError, RateError, UsageError
from candata.loaders import windows
from candata.loaders.increments import integrate
from candata.scenes.contract import OBJECTS
from candata.schema.effect import EffectSetting
from candata.simulate.generate import generate
from candata.training.poses import position_error
from candata.training.rollout import at_rows, close_loop, course
from candata.training.simulator import Simulator, simulator

CHANNELS = ("object_pose", "joint_position", "action", "contact")
HEAVY_AND_LATE = (
    EffectSetting(name="object_mass", parameters={"mass_scale": 2.0}),
    EffectSetting(name="actuation_delay", parameters={"delay_s": 0.08}),
)


def gripper_windows(folder, horizon=8, **options):
    return windows(folder, channels=CHANNELS, history=4, horizon=horizon, pad="both", step=5, **options)


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """The same in a world with another mass and late commands."""
    folder = tmp_path_factory.mktemp("changed") / "data"
    generate(folder, "gripper_tabletop", 3, 1, workers=1, noise=False, duration_s=1.6, effects=HEAVY_AND_LATE)
    return folder


@pytest.fixture(scope="module")
def tosses(tmp_path_factory):
    """Tosses of a cube, with the tracker's noise."""
    folder = tmp_path_factory.mktemp("tosses") / "data"
    generate(folder, "cube_toss", 4, 1, workers=1, duration_s=0.6)
    return folder


def mean_error(feed, forecaster) -> float:
    batch = feed.batch(np.arange(len(feed)))
    poses = integrate(batch["history/object_pose"][:, -1], forecaster.forecast(batch, (0,)).increments[0])
    return float(position_error(poses, batch["future/object_pose"])[~batch["future_pad"]].mean())


def test_in_the_scenes_own_world_it_forecasts_what_was_recorded(nominal):
    feed = gripper_windows(nominal)
    batch = feed.batch(np.arange(len(feed)))
    moved_m = position_error(batch["history/object_pose"][:, -1:], batch["future/object_pose"])[~batch["future_pad"]]
    assert moved_m.mean() > 0.005  # else staying would do
    assert mean_error(feed, simulator(feed, None)) < 0.1 * moved_m.mean()


def test_the_effects_of_another_world_bring_it_near_to_that(changed):
    feed = gripper_windows(changed)
    repaired = simulator(feed, "gripper_tabletop", HEAVY_AND_LATE)
    assert mean_error(feed, repaired) < 0.5 * mean_error(feed, simulator(feed, "gripper_tabletop"))


def test_touch_is_told_as_contact(nominal):
    feed = gripper_windows(nominal)
    batch = feed.batch(np.arange(len(feed)))
    is_known = ~batch["future_pad"]
    contact = simulator(feed, None).forecast(batch).contact
    assert set(np.unique(contact)) == {0.0, 1.0}
    assert ((contact == 1) == batch["future/contact"])[is_known].mean() > 0.9


def test_what_was_recorded_after_the_present_is_not_read_but_for_commands(nominal, tmp_path, rewritten):
    row = 40

    def other_future(episode):
        later = np.arange(len(episode)) > row
        pose, joints = episode["object_pose"].copy(), episode["joint_position"].copy()
        pose[later, :3] += 0.1
        joints[later] += 0.2
        return {"object_pose": pose, "joint_position": joints}

    def other_commands(episode):
        later = np.arange(len(episode))[:, None] >= row
        return {"action": np.where(later, episode["action"][row - 1], episode["action"])}

    def forecast(dataset):
        feed = gripper_windows(dataset)
        batch = feed.batch(np.flatnonzero(feed.present_row - feed.cache.begin[feed.owner] == row))
        return simulator(feed, None).forecast(batch).increments

    recorded = forecast(nominal)
    assert np.array_equal(recorded, forecast(rewritten(tmp_path / "poses", nominal, other_future)))
    assert not np.allclose(recorded, forecast(rewritten(tmp_path / "commands", nominal, other_commands)), atol=1e-4)


def test_a_free_run_moves_its_joints_as_they_were_recorded_in_its_own_world(nominal, changed):
    def joint_error(folder):
        course_all = course(gripper_windows(folder))
        joints = simulator(course_all.windows, "gripper_tabletop").free_run(course_all).joints
        begin, stride = course_all.windows.present_row, int(course_all.windows.stride[0])
        steps = stride * np.arange(1, course_all.valid.shape[1] + 1)
        rows = course_all.windows.cache.rows["joint_position"][begin[:, None] + steps]
        return np.abs(joints - rows)[course_all.valid].mean()

    # 80 ms late commands make the other world's joints late.
    assert joint_error(nominal) < 0.2 * joint_error(changed)


def test_a_window_is_forecast_alike_in_any_company(nominal):
    feed = gripper_windows(nominal)
    forecaster, numbers = simulator(feed, None), np.arange(len(feed))
    together = forecaster.forecast(feed.batch(numbers)).increments
    few = numbers[[17, 3, 30]]
    assert np.allclose(forecaster.forecast(feed.batch(few)).increments[0], together[0, few], atol=1e-9)


def test_a_free_run_goes_on_where_the_first_forecast_ends(nominal):
    feed = gripper_windows(nominal)
    forecaster, course_all = simulator(feed, None), course(feed)
    loop = close_loop(course_all, forecaster, 4, 0)
    batch = at_rows(course_all.windows, course_all.episodes, np.zeros(len(course_all.episodes), np.int64))
    first = integrate(course_all.observed[:, -1], forecaster.forecast(batch).increments[0])
    horizon = first.shape[1]
    assert loop.poses.shape == course_all.truth.shape
    assert loop.contact.shape == course_all.truth.shape[:2]
    assert np.allclose(loop.poses[:, :horizon], first, atol=1e-6)  # a batch holds single precision
    assert position_error(loop.poses, course_all.truth)[course_all.valid].mean() < 0.01


def test_poses_that_a_closed_loop_made_are_where_it_starts(nominal):
    feed = gripper_windows(nominal)
    batch = feed.batch(np.flatnonzero(feed.present_row - feed.cache.begin[feed.owner] == 0))
    forecaster = simulator(feed, None)
    moved = dict(batch) | {"history/object_pose": batch["history/object_pose"] + np.float32([0, 0, 0.3, 0, 0, 0, 0])}
    fallen = integrate(moved["history/object_pose"][:, -1], forecaster.forecast(moved).increments[0])
    recorded = integrate(batch["history/object_pose"][:, -1], forecaster.forecast(batch).increments[0])
    # Lifted off the table it begins higher, and falls.
    assert (fallen[:, 0, 2] - recorded[:, 0, 2] > 0.1).all()
    assert (fallen[:, -1, 2] < fallen[:, 0, 2] - 0.1).all()


def test_a_gap_in_the_past_is_bridged(nominal, tmp_path, rewritten):
    def gap(episode):
        valid = ~np.isin(np.arange(len(episode)), [22, 23, 24, 25, 26])
        pose = episode["object_pose"].copy()
        pose[~valid] = np.nan
        return {"object_pose": pose, "object_pose_valid": valid}

    feed = gripper_windows(rewritten(tmp_path / "gap", nominal, gap))
    assert mean_error(feed, simulator(feed, None)) < 0.003


@pytest.mark.parametrize("rate_hz", [148.0, 37.0])
def test_a_toss_flies_on(tosses, rate_hz):
    feed = windows(tosses, channels=("object_pose",), history=5, horizon=4, rate_hz=rate_hz)
    start = feed.present_row - feed.cache.begin[feed.owner]
    feed = replace(feed, present_row=feed.present_row[start < 40], owner=feed.owner[start < 40])
    batch = feed.batch(np.arange(0, len(feed), 7))
    forecast = integrate(batch["history/object_pose"][:, -1], simulator(feed, None).forecast(batch).increments[0])
    error = np.median(position_error(forecast, batch["future/object_pose"])[:, -1])
    step = integrate(batch["history/object_pose"][:, -1], np.zeros((len(forecast), 4, 6)))
    moved = np.median(position_error(step, batch["future/object_pose"])[:, -1])
    assert error < 0.2 * moved


def test_each_episode_is_played_with_its_own_object(tmp_path):
    folders = tmp_path / "objects"
    for name, mass_kg in (("empty", 0.05), ("full", 0.5)):
        (folders / name).mkdir(parents=True)
        can = OBJECTS.load("can").file.model_copy(update={"name": name, "mass_kg": mass_kg})
        (folders / name / "object.yaml").write_text(can.model_dump_json())
    objects = [str(folders / name) for name in ("empty", "full")]
    played = {"workers": 1, "noise": False, "duration_s": 1.6, "objects": objects, "policies": ("push",)}
    generate(tmp_path / "data", "gripper_tabletop", 2, 1, **played)
    feed = gripper_windows(tmp_path / "data")
    with pytest.raises(UsageError, match=r"gripper_tabletop\+FOLDER"):
        simulator(feed, None)  # the recordings know the objects by name alone
    made = simulator(feed, f"gripper_tabletop+{folders}")
    assert len(made.scenes.scenes) == 2
    # Before the push: how a can that has been tipped comes down is a matter of chance.
    early = feed.present_row - feed.cache.begin[feed.owner] < 20
    assert mean_error(replace(feed, present_row=feed.present_row[early], owner=feed.owner[early]), made) < 0.001


class TestRefusals:
    """What does not fit is refused before the first step, and says what to do."""

    def test_recordings_without_a_scene(self, nominal, tmp_path, rewritten):
        feed = gripper_windows(rewritten(tmp_path / "data", nominal, lambda _: {}, scene=None))
        with pytest.raises(UsageError, match="name no scene"):
            simulator(feed, None)
        assert isinstance(simulator(feed, "gripper_tabletop"), Simulator)

    def test_a_scene_of_the_recordings_that_is_not_there(self, nominal, tmp_path, rewritten):
        feed = gripper_windows(rewritten(tmp_path / "data", nominal, lambda _: {}, scene="gripper_tabletop+no_such"))
        with pytest.raises(UsageError, match="is not built in"):
            simulator(feed, None)

    def test_another_hand(self, nominal):
        with pytest.raises(DataError, match="does not fit scene xhand_tabletop"):
            simulator(gripper_windows(nominal), "xhand_tabletop")

    def test_joints_in_another_order(self, nominal, tmp_path, rewritten):
        names = open_dataset(nominal).episode(open_dataset(nominal).ids[0]).meta.joint_names
        feed = gripper_windows(rewritten(tmp_path / "data", nominal, lambda _: {}, joint_names=names[::-1]))
        with pytest.raises(DataError, match="another order"):
            simulator(feed, None)

    def test_another_rate(self, nominal, tmp_path, rewritten):
        feed = gripper_windows(rewritten(tmp_path / "data", nominal, lambda _: {}, rate_hz=40.0))
        with pytest.raises(RateError, match="not that of scene"):
            simulator(feed, None)

    def test_another_object(self, nominal, tmp_path, rewritten):
        data = rewritten(tmp_path / "data", nominal, lambda _: {}, scene="gripper_tabletop+mug", object="mug")
        with pytest.raises(DataError, match="another object"):
            simulator(gripper_windows(data), "gripper_tabletop")

    def test_windows_without_commands(self, nominal):
        with pytest.raises(DataError, match="action does not fit"):
            simulator(windows(nominal, horizon=4, channels=("object_pose", "joint_position")), None)
