"""Scores of forecasters whose errors are known, open and closed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import DataError
from candata.loaders import windows
from candata.loaders.increments import increments
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata.training import metrics, scoring
from candata.training.forecasters import BASELINES, ForecastArrays, KeepsVelocity, Stays
from candata.training.poses import position_error
from candata.training.rollout import close_loop, course, evenly_ranked
from tests.training.conftest import gliding

SPEED_M_S = float(np.linalg.norm([0.05, -0.02, 0.01]))


@dataclass
class Oracle:
    """Reads the future, and keeps what it was shown."""

    summary: str = "the oracle"
    seen: list = field(default_factory=list)

    def forecast(self, batch, seed):
        self.seen.append(batch)
        poses = np.concatenate([batch["history/object_pose"][:, -1:], batch["future/object_pose"]], axis=1)
        return ForecastArrays(increments(poses)[None], batch["future/contact"].astype(float))


@dataclass
class Drifts:
    """Moves a millimetre a step along x, in several samples around it, and always touches."""

    summary: str = "drifts"
    seen: list = field(default_factory=list)

    def forecast(self, batch, seed):
        self.seen.append({name: np.array(value) for name, value in batch.items()})
        steps = np.zeros((2, *batch["future_pad"].shape, 6))
        steps[:, ..., 0] = np.array([0.0005, 0.0015])[:, None, None]
        return ForecastArrays(steps, np.full(batch["future_pad"].shape, 0.9))


def score(windows, forecasters, execute, seed):
    """The scores of forecasters that all see the same windows."""
    return scoring.score(windows, {n: scoring.Entrant(f, windows, execute) for n, f in forecasters.items()}, seed)


@pytest.fixture
def glide(dataset):
    return windows(dataset(episodes=4), history=4, horizon=6, pad="both", step=2)


def test_the_oracle_is_perfect_open_and_closed(glide):
    found = score(glide, {"oracle": Oracle(), **BASELINES}, 3, 0)
    opened, closed = found.windows["oracle"], found.closed_loop["oracle"]
    # Poses are kept in float32: 1e-7 of a metre or so each, added up over a horizon.
    assert max(opened.position_error_m) < 1e-6
    assert opened.contact.f1 == closed.contact.f1 == 1.0
    assert opened.adds_auc == pytest.approx(1.0, abs=1e-4)
    assert closed.final_position_error_m < 1e-5
    assert (closed.success.count, closed.success.total) == (4, 4)


def test_the_baselines_have_the_errors_of_a_gliding_object(glide):
    found = score(glide, BASELINES, 3, 0)
    ahead_s = np.arange(1, 7) / 10
    np.testing.assert_allclose(found.windows["stays"].position_error_m, SPEED_M_S * ahead_s, rtol=1e-4)
    np.testing.assert_allclose(found.windows["stays"].rotation_error_rad, 0.4 * ahead_s, rtol=1e-3)
    np.testing.assert_allclose(found.windows["stays"].position_mse_m2, (SPEED_M_S * ahead_s) ** 2, rtol=1e-4)
    # One sample: its energy score is its error.
    assert found.windows["stays"].position_energy_m == found.windows["stays"].position_error_m
    assert found.closed_loop["keeps_velocity"].final_position_error_m < 1e-4
    # Loops begin after 3 steps of history and end with the episode.
    lengths = np.array([30, 31, 32, 33]) - 3
    assert found.rows == lengths.sum()
    assert found.closed_loop["stays"].final_position_error_m == pytest.approx(SPEED_M_S * lengths.mean() / 10, rel=1e-4)


def test_the_first_window_has_no_velocity_to_keep(glide):
    first = glide.batch([0])
    assert first["history_pad"][0, -2]
    assert not KeepsVelocity().forecast(first).increments.any()
    later = KeepsVelocity().forecast(glide.batch([5])).increments
    np.testing.assert_allclose(later[0, 0, :, :3], np.tile([0.005, -0.002, 0.001], (6, 1)), atol=1e-7)


def test_a_loop_is_fed_its_own_poses_and_contacts(glide):
    drifts, road = Drifts(), course(glide)
    loop = close_loop(road, drifts, execute=3, seed=0)
    begin = road.observed[:, -1, :3]
    steps = np.arange(1, road.truth.shape[1] + 1)
    inside = steps <= road.steps[:, None]
    expected = begin[:, None] + steps[None, :, None] * np.array([0.001, 0, 0])
    np.testing.assert_allclose(loop.poses[inside][:, :3], expected[inside], atol=1e-7)  # fed back in float32
    second = drifts.seen[1]
    np.testing.assert_allclose(second["history/object_pose"][:, 0, :3], begin, atol=1e-7)
    np.testing.assert_allclose(second["history/object_pose"][:, -1, :3], begin + np.array([0.003, 0, 0]), atol=1e-7)
    # The hand has not touched yet where the second forecast begins; the forecaster says it has.
    assert second["history/contact"][:, 1:].all()
    assert not second["history/contact"][:, 0].any()


def test_a_loop_replays_joints_and_actions_of_its_own_time(glide):
    drifts, road = Drifts(), course(glide)
    close_loop(road, drifts, execute=3, seed=0)
    rows = glide.cache.rows[glide.cache.begin[0] :]
    for number, batch in enumerate(batch for batch in drifts.seen if batch["episode"][0] == 0):
        present = 2 * (3 + 3 * number)
        np.testing.assert_array_equal(batch["history/joint_position"][0, -1], rows["joint_position"][present])
        if present + 2 <= 60:
            np.testing.assert_array_equal(batch["planned/action"][0, 1], rows["action"][present + 2])


def test_shorter_episodes_leave_the_loop_earlier(glide):
    drifts, road = Drifts(), course(glide)
    close_loop(road, drifts, execute=3, seed=0)
    assert [len(batch["row"]) for batch in drifts.seen] == [int((road.steps > 3 * k).sum()) for k in range(10)]
    assert len(drifts.seen[0]["row"]) == 4
    assert len(drifts.seen[-1]["row"]) == 3


def test_without_a_forecast_the_recorded_contact_is_fed(glide):
    road = course(glide)
    spy = Oracle()
    spy.forecast = lambda batch, seed: (
        spy.seen.append(batch),
        ForecastArrays(Stays().forecast(batch).increments, None),
    )[1]
    loop = close_loop(road, spy, execute=3, seed=0)
    assert loop.contact is None
    np.testing.assert_array_equal(spy.seen[4]["history/contact"], road.contact[:, 12:16])


def test_rows_that_are_not_valid_count_in_nothing(tmp_path, dataset):
    whole = dataset("whole", episodes=1)
    episode = next(iter(whole))
    bad = np.ones(len(episode), bool)
    bad[20:40] = False
    arrays = dict(episode.arrays) | {"object_pose_valid": bad}
    folder = create_dataset(tmp_path / "gap", name="gap")
    append(folder, [Episode(episode.meta.model_copy(update={"point_cloud": None}), arrays)], Lineage(operation="t"))
    found = windows(open_dataset(folder), history=4, horizon=6, pad="both", step=2)
    road = course(found)
    assert road.valid.sum() == 27 - 10
    assert not road.valid[0, 20 // 2 - 4 : 40 // 2 - 4].any()
    scores = score(found, BASELINES, 3, 0)
    assert scores.closed_loop["keeps_velocity"].final_position_error_m < 1e-4
    assert scores.closed_loop["stays"].adds_auc is None
    assert scores.pairs == ()
    assert found.cache.valid.sum() < len(episode)
    assert scores.gap_rows == 10


def test_a_loop_begins_at_a_valid_row(glide):
    """Before it, the pose that stands in is a later one: a loop from there would be given the future."""
    valid = glide.cache.valid.copy()
    begin = int(glide.cache.begin[1])
    valid[begin : begin + 21] = False
    road = course(replace(glide, cache=replace(glide.cache, valid=valid)))
    rows = road.windows.present_row - glide.cache.begin
    # Rows 0 to 20 of the second episode are lost; steps of two rows after a history of four begin at row 6.
    assert rows.tolist() == [6, 22, 6, 6]
    assert road.steps.tolist() == [27, 20, 29, 30]
    np.testing.assert_array_equal(road.observed[1, -1], glide.cache.rows["object_pose"][begin + 22])


def test_rows_beyond_a_break_of_the_clock_are_not_scored(glide):
    """Where rows are missing, the replayed actions miss too: the loop cannot be held to what came after."""
    stretch = glide.cache.stretch.copy()
    begin = int(glide.cache.begin[1])
    stretch[begin + 30 : begin + 63] = 1
    road = course(replace(glide, cache=replace(glide.cache, stretch=stretch)))
    # The loop of two rows a step begins at row 6: rows 8 to 28 count.
    assert road.valid.sum(1).tolist() == [27, 11, 29, 30]


def test_nothing_to_follow_is_an_error(glide):
    cache = replace(glide.cache, valid=np.zeros_like(glide.cache.valid))
    with pytest.raises(DataError, match="no episode can be followed"):
        course(replace(glide, cache=cache))


def test_a_pair_is_the_difference_of_the_areas(glide):
    found = score(glide, {"oracle": Oracle(), "stays": Stays()}, 3, 0)
    areas = [found.closed_loop[name].adds_auc for name in ("oracle", "stays")]
    (pair,) = found.pairs
    assert (pair.forecaster, pair.reference) == ("oracle", "stays")
    assert pair.value == pytest.approx(areas[0] - areas[1], abs=1e-12)
    assert pair.low is pair.high is None
    assert found.closed_loop["oracle"].adds_auc_interval is None
    assert found.by_episode[0].adds_auc.keys() == {"oracle", "stays"}


def test_a_pair_has_an_interval_from_8_episodes_on(dataset):
    many = windows(dataset("many", episodes=8), history=4, horizon=6, pad="both", step=2)
    found = score(many, {"oracle": Oracle(), "stays": Stays()}, 3, 0)
    (pair,) = found.pairs
    assert 0 < pair.low <= pair.value <= pair.high
    low, high = found.closed_loop["stays"].adds_auc_interval
    assert low < found.closed_loop["stays"].adds_auc < high


def test_adds_in_the_loop_is_that_of_each_row(glide):
    road = course(glide)
    loop = close_loop(road, Stays(), execute=6, seed=0)
    cloud = glide.clouds[0]
    rows = [
        metrics.adds(cloud, loop.poses[e, k], road.truth[e, k]) for e, k in zip(*np.nonzero(road.valid), strict=True)
    ]
    found = score(glide, {"stays": Stays()}, 6, 0).closed_loop["stays"]
    assert found.adds_m == pytest.approx(np.mean(rows), rel=1e-12)
    assert found.adds_auc == pytest.approx(metrics.auc(np.array(rows)), rel=1e-12)


def test_no_object_is_scored_with_the_cloud_of_another(glide):
    clouds = (None, *glide.cache.file.clouds[1:])
    part = replace(glide, cache=replace(glide.cache, file=glide.cache.file.model_copy(update={"clouds": clouds})))
    found = score(part, BASELINES, 3, 0)
    assert found.windows["stays"].adds_auc is found.closed_loop["stays"].adds_auc is None
    others = part.owner > 0
    rest = replace(part, owner=part.owner[others], present_row=part.present_row[others])
    assert score(rest, BASELINES, 3, 0).closed_loop["stays"].adds_auc is not None


def test_many_windows_are_thinned_evenly(glide, monkeypatch):
    monkeypatch.setattr(scoring, "MOST_WINDOWS", 5)
    assert scoring.chosen_windows(glide).tolist() == np.linspace(0, len(glide) - 1, 5).round().astype(int).tolist()


def test_tracks_begin_with_the_row_last_observed(glide):
    found = score(glide, BASELINES, 3, 0)
    track = next(one for one in found.tracks if one.id == "glide-00")
    assert track.time_s[0] == pytest.approx(0.3)
    assert len(track.time_s) == len(track.truth) == len(track.contact) == len(track.poses["stays"]) == 28
    assert position_error(track.poses["stays"], track.truth)[0] == 0
    assert np.isnan(track.forecast_contact["stays"][0])


def test_the_episodes_shown_are_spread_from_worst_to_best():
    assert evenly_ranked([5.0, 1.0, 3.0, 2.0, 4.0], 3) == [1, 2, 0]
    assert evenly_ranked([1.0], 4) == [0]


def test_entrants_of_other_histories_follow_the_same_episodes_from_the_same_row(glide):
    """A loop begins where the longest history is whole, whoever follows it."""
    drifts = Drifts()
    entrants = {
        "short": scoring.Entrant(drifts, replace(glide, history=2, horizon=3), 3),
        "long": scoring.Entrant(Oracle(), glide, 6),
        "stays": scoring.Entrant(Stays(), glide, 6),
    }
    found = scoring.score(glide, entrants, 0)
    assert found.begins_after == 4
    assert found.rows == score(glide, BASELINES, 3, 0).rows
    assert {len(found.windows[name].position_error_m) for name in ("short", "long")} == {3, 6}
    first_chunk = drifts.seen[1]
    assert first_chunk["history/object_pose"].shape[1] == 2
    assert first_chunk["row"].tolist() == [6] * 4
    assert found.closed_loop["long"].final_position_error_m < 1e-5
    # A millimetre a step along x, from the same begin to the same end as all others.
    steps = np.array([30, 31, 32, 33]) - 3
    expected = [np.linalg.norm(k / 10 * np.array([0.05, -0.02, 0.01]) - [0.001 * k, 0, 0]) for k in steps]
    assert found.closed_loop["short"].final_position_error_m == pytest.approx(np.mean(expected), rel=1e-4)


def test_long_loops_are_scored_at_their_time_over_the_episodes_that_are_so_long(glide):
    found = score(glide, {"stays": Stays()}, 3, 0).closed_loop["stays"].long_loops
    assert [(loop.time_s, loop.episodes) for loop in found] == [(2.0, 4), (5.0, 0), (10.0, 0)]
    assert found[0].position_error_m == pytest.approx(2 * SPEED_M_S, rel=1e-4)
    assert found[0].rotation_error_rad == pytest.approx(2 * 0.4, rel=1e-3)
    assert found[1].position_error_m is found[1].adds_auc is None


def test_groups_are_scored_apart_and_their_rows_counted(tmp_path):
    folder = create_dataset(tmp_path / "two", name="two")
    tasks = ("push", "push", None)
    episodes = [gliding(f"e{k}", k, rows=61, task=task) for k, task in enumerate(tasks)]
    still = dict(episodes[2].arrays) | {"object_pose": np.tile(episodes[2].arrays["object_pose"][:1], (61, 1))}
    append(folder, [*episodes[:2], replace(episodes[2], arrays=still)], Lineage(operation="t"))
    found = score(windows(open_dataset(folder), history=4, horizon=6, pad="both", step=2), {"stays": Stays()}, 3, 0)
    tasks_found = found.breakdown["task"]
    assert {name: (group.episodes, group.rows) for name, group in tasks_found.items()} == {
        "not stated": (1, 27),
        "push": (2, 54),
    }
    assert tasks_found["not stated"].scores["stays"].position_error_m == 0
    mean_s = np.arange(1, 28).mean() / 10
    assert tasks_found["push"].scores["stays"].position_error_m == pytest.approx(SPEED_M_S * mean_s, rel=1e-4)
    assert "object" not in found.breakdown
    phases = found.breakdown["phase"]
    # Touched from row 30 of 61 at 20 Hz, never let go; loops have every second row from row 8 on.
    assert {name: group.rows for name, group in phases.items()} == {"free": 33, "onset": 3, "sustained": 45}
    assert phases["sustained"].scores["stays"].position_error_m > phases["free"].scores["stays"].position_error_m


def test_the_mixed_mse_is_that_of_the_six_numbers_of_an_increment(glide):
    stays = score(glide, {"stays": Stays()}, 3, 0).windows["stays"]
    step = np.array([0.005, -0.002, 0.001, 0, 0, 0.04])
    assert stays.increment_mse == pytest.approx((step**2).mean(), rel=1e-3)
    assert score(glide, {"oracle": Oracle()}, 3, 0).windows["oracle"].increment_mse < 1e-12
