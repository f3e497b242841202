"""A recorded supply: effects follow it where it is a reading, and a supply that sags is named from it alone."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.data.testability import library
from candata.gap.replay.replayer import Replayer, replay
from candata.gap.replay.starts import starts
from candata.schema.episode import Episode, EpisodeMeta
from candata.simulate import at_rest, rollout, with_effects
from tests.effects.pendulum import excitation, write_pendulum
from tests.effects.sagging import play_on_weak_supply

COUNT, DURATION_S = 8, 1.5
#: Noise of an encoder of 4096 steps a turn, 1 sd [rad], and of a reading of the supply [V].
ENCODER_RAD, READING_V = 0.5e-3, 0.02
#: What explains the same recordings in part.
RIVALS = ("torque_limit", "drive_voltage", "servo_gain")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return write_pendulum(tmp_path_factory.mktemp("pendulum"))


@pytest.fixture(scope="module")
def sagging(pendulum) -> list[Episode]:
    """Episodes of a servo whose supply sags under its load, played by plain MuJoCo."""
    rng, out = np.random.default_rng(1), []
    for i in range(COUNT):
        commands = excitation(100 + i, DURATION_S)
        position, volts = play_on_weak_supply(pendulum, commands)
        arrays = {
            "time_ns": np.arange(len(commands)) * 10_000_000,
            "joint_position": (position + rng.normal(0, ENCODER_RAD, position.shape))[:, None],
            "action": commands,
            "supply_voltage": (volts + rng.normal(0, READING_V, volts.shape))[:, None],
        }
        names = {"joint_names": pendulum.file.joints, "actuator_names": pendulum.file.actuator_names}
        out.append(Episode(EpisodeMeta(id=f"p{i}", source="real", rate_hz=100.0, task="mixed", **names), arrays))
    return out


def with_supply(episodes: list[Episode], make) -> list[Episode]:
    """The episodes with another supply: what `make` returns of theirs; None for none."""
    out = []
    for e in episodes:
        arrays = {name: values for name, values in e.arrays.items() if name != "supply_voltage"}
        supply = make(e["supply_voltage"])
        out.append(Episode(e.meta, arrays if supply is None else arrays | {"supply_voltage": supply}))
    return out


def test_a_supply_that_sags_is_named_alone_from_its_reading(pendulum, sagging, judge):
    """Not what is weak at all times, nor a slow or soft servo."""
    report = judge(pendulum, sagging, only=("supply_sag", *RIVALS)).report
    assert (report.verdict, [e.name for e in report.effects]) == ("explained", ["supply_sag"])
    # All of the sag reaches this servo.
    assert report.effects[0].parameters["share"].value == pytest.approx(1.0, rel=0.05)


def test_a_sag_that_does_not_reach_the_servo_is_not_named(pendulum, sagging, judge):
    """A current loop makes up for it: the same readings of the supply beside the motion of a stiff one."""
    rng, commands = np.random.default_rng(2), np.stack([e["action"] for e in sagging])
    stiff = rollout(pendulum, commands, *at_rest(pendulum, COUNT), [()] * COUNT).readings["joint_position"]
    stiff = stiff + rng.normal(0, ENCODER_RAD, stiff.shape)
    episodes = [Episode(e.meta, dict(e.arrays) | {"joint_position": q}) for e, q in zip(sagging, stiff, strict=True)]
    report = judge(pendulum, episodes, only=("supply_sag",)).report
    assert (report.verdict, report.effects) == ("no_gap", ())


def replayed(scene, recs: Recordings, effects=()) -> np.ndarray:
    """Joint positions of a replay."""
    return replay(Replayer(scene), recs, starts(scene, recs), [effects])[0]["joint_position"]


def test_a_replay_follows_the_reading_and_the_nominal_one_does_not(pendulum, sagging, planted):
    recs, without = recordings(pendulum, sagging), recordings(pendulum, with_supply(sagging, lambda volts: None))
    whole = planted("supply_sag", share=1.0)
    assert np.array_equal(replayed(pendulum, recs), replayed(pendulum, without))
    assert np.array_equal(replayed(pendulum, without, whole), replayed(pendulum, without))

    def error(effects=()):
        return np.sqrt(np.nanmean((replayed(pendulum, recs, effects) - recs.readings["joint_position"]) ** 2))

    assert error(whole) < 0.1 * error()
    assert np.array_equal(replayed(with_effects(pendulum, whole), recs), replayed(pendulum, recs, whole))


@pytest.mark.parametrize(
    "label", [lambda volts: np.full_like(volts, 15.0), lambda volts: np.full_like(volts, volts.mean())]
)
def test_a_label_in_every_row_is_no_reading_and_named_from_it_is_nothing(pendulum, sagging, label):
    """Neither the same in all episodes, nor another in each."""
    recs = recordings(pendulum, with_supply(sagging, label))
    assert recs.supply is None
    assert "no effect follows supply_voltage of a: one value in all rows of an episode is no reading" in recs.notes
    assert "supply_sag" not in library(pendulum, recs)
    with pytest.raises(UsageError, match="supply_voltage that varies"):
        library(pendulum, recs, only=("supply_sag",))


def test_a_supply_that_some_episodes_lack_is_not_followed(pendulum, sagging):
    recs = recordings(pendulum, [*sagging[:6], *with_supply(sagging[6:], lambda volts: None)])
    assert (len(recs), recs.supply) == (8, None)
    assert "no effect follows supply_voltage: 2 of 8 episodes lack it" in recs.notes


def test_what_was_not_recorded_at_all_is_not_spoken_of(pendulum, sagging):
    recs = recordings(pendulum, with_supply(sagging, lambda volts: None))
    assert (recs.supply, [n for n in recs.notes if "supply" in n]) == (None, [])


def test_missing_rows_hold_the_last_reading_and_the_first_begins(pendulum, sagging):
    gaps, valid = sagging[0]["supply_voltage"].copy(), np.ones(len(sagging[0]), bool)
    gaps[[0, 1, 50, 51]], valid[[0, 1, 50, 51]] = np.nan, False
    arrays = dict(sagging[0].arrays) | {"supply_voltage": gaps, "supply_voltage_valid": valid}
    recs = recordings(pendulum, [Episode(sagging[0].meta, arrays), *sagging[1:]])
    volts = recs.supply[0, :, 0]
    assert np.isfinite(volts).all()
    assert set(volts[:2]) == {volts[2]}
    assert set(volts[50:52]) == {volts[49]}
    kept = recordings(pendulum, sagging).supply[0, :, 0]
    np.testing.assert_allclose(volts[valid], kept[valid], rtol=0.01)  # the median moves with what is missing


def of_arm(arm_episodes, volts: np.ndarray, names: tuple[str, ...]) -> list[Episode]:
    """Episodes of the arm, without noise, with a supply `(T, columns)` and names of their actuators."""
    return [
        Episode(e.meta.model_copy(update={"actuator_names": names}), dict(e.arrays) | {"supply_voltage": volts})
        for e in arm_episodes(count=2, rows=40)
    ]


def test_columns_come_in_the_order_of_the_scene_and_labels_among_them_are_one(arm, arm_episodes):
    """By name, as of commands; what is one value beside a reading is left as it is, and said."""
    falls = np.linspace(12, 10, 40)
    volts = np.stack([np.zeros(40), falls], axis=1)
    recs = recordings(arm, of_arm(arm_episodes, volts, ("elbow", "shoulder")))
    np.testing.assert_allclose(recs.supply[:, :, 0], np.tile(falls / 11, (2, 1)), rtol=1e-6)
    assert (recs.supply[:, :, 1] == 1).all()
    assert any("of elbow" in note for note in recs.notes)


def test_one_column_serves_all_actuators(arm, arm_episodes):
    falls = np.linspace(12, 10, 40)[:, None]
    recs = recordings(arm, of_arm(arm_episodes, falls, ()))
    np.testing.assert_allclose(recs.supply, np.tile(falls / 11, (2, 1, 2)), rtol=1e-6)


def test_another_number_of_columns_is_refused(arm, arm_episodes):
    volts = np.linspace(12, 10, 120).reshape(40, 3)
    with pytest.raises(DataError, match=r"one column, or 2: shoulder, elbow[\s\S]*3 columns"):
        recordings(arm, of_arm(arm_episodes, volts, ()))


def test_what_is_no_voltage_is_refused(pendulum, sagging):
    with pytest.raises(DataError, match="above 0 V"):
        recordings(pendulum, with_supply(sagging, lambda volts: -volts))
