"""Rules for logs of real servos: what an encoder, a supply and a force limit do, and what is no defect."""

from __future__ import annotations

import numpy as np
import pytest

from candata.checks.defects import as_stored, with_arrays, with_defect
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ = 100.0
#: Step of an encoder of 4096 steps a turn [rad].
STEP = 2 * np.pi / 4096


def episode(name, joint, **arrays):
    """An episode of one joint `(T,)` that is commanded where it goes."""
    rows = len(joint)
    meta = EpisodeMeta(id=name, source="real", rate_hz=RATE_HZ, joint_names=("a",), actuator_names=("a",))
    time_ns = (np.arange(rows) * 1e9 / RATE_HZ).astype(np.int64)
    column = np.asarray(joint)[:, None]
    return Episode(meta, {"time_ns": time_ns, "joint_position": column, "action": column, **arrays})


def encoder(signal):
    """What an encoder reads."""
    return np.rint(signal / STEP) * STEP


def time_s(duration_s=4.0):
    return np.arange(round(duration_s * RATE_HZ)) / RATE_HZ


def found(judged, episodes, *rules):
    return judged(map(as_stored, episodes), rules=list(rules))


def test_two_spikes_in_a_turning_joint_are_found_where_they_are(judged):
    reading = encoder(np.sin(2 * time_s()))
    reading[[60, 250]] -= np.pi
    (finding,) = found(judged, [episode("e", reading)], "encoder_spikes")
    assert finding.evidence["spikes"] == 2
    assert finding.evidence["largest"] == pytest.approx(np.pi, abs=0.02)
    assert [start for start, _ in finding.ranges] == pytest.approx([0.6, 2.5])


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_quick_motion_that_stops_and_one_that_turns_back_are_no_spikes(judged, rows):
    step = np.clip((time_s() - 2) * RATE_HZ / rows, 0, 1)
    hit = 0.6 - np.abs(time_s() - 2)
    assert not found(judged, [episode("step", encoder(step)), episode("hit", encoder(hit))], "encoder_spikes")


@pytest.mark.parametrize("sd", [0.0, 0.002], ids=["encoder", "noise"])
def test_a_repeated_reading_within_a_motion_is_found(judged, rng, sd):
    reading = encoder(np.sin(2 * time_s())) if sd == 0 else np.sin(2 * time_s()) + rng.normal(0, sd, len(time_s()))
    reading[155:163] = reading[155]  # 3.1 half periods: it moves fast there
    (finding,) = found(judged, [episode("e", reading)], "stuck_readings")
    assert finding.evidence["rows"] == 7
    assert finding.ranges == ((1.56, 1.62),)


def stick_slip():
    """A joint that dry friction holds where it turns back, and until it breaks away from rest."""
    swing = np.sin(3 * time_s())
    turned = np.clip(swing, -0.9, 0.9)
    return np.where(time_s() < 0.3, turned[30], turned)


@pytest.mark.parametrize(
    "reading",
    [
        stick_slip(),
        0.1 * time_s() * STEP * RATE_HZ,  # a tenth of a step a row
        np.repeat(np.sin(2 * time_s())[::4], 4),  # a sensor of a quarter of the rate
        np.where(time_s() < 2, 0.0, 0.5),
    ],
    ids=["stick-slip", "slow", "slow sensor", "step from rest"],
)
def test_friction_rounding_and_slow_sensors_are_no_stuck_readings(judged, reading):
    assert not found(judged, [episode("e", encoder(reading))], "stuck_readings")


def pressed(limits_n, gram=9.80665e-3):
    """Contacts one a limit: the force rises by 20 gram-force a row to where something stops it, and stands there."""
    for number, limit in enumerate(limits_n):
        ramp = np.minimum(np.maximum(np.arange(120) - 20, 0) * 20 * gram, limit)
        force = np.rint(ramp / gram) * gram
        force[100:] = 0
        xyz = np.stack([0 * force, 0 * force, -force], axis=1)[:, None]
        yield episode(f"e{number}", np.linspace(0, 1, 120), fingertip_force=xyz)


def test_a_force_limit_that_a_controller_holds_is_no_saturation_and_a_full_scale_is(judged):
    held = [10.0, 10.1, 10.1, 9.9, 10.2, 9.8]
    assert not found(judged, pressed(held), "saturation")
    limited = found(judged, pressed([10.0] * 4), "saturation")
    assert [f.level for f in limited] == ["error"] * 4
    # A limit in some contacts, the sensor's end in most.
    assert [f.episode for f in found(judged, pressed([5.0, 10.0, 10.0, 10.0]), "saturation")] == ["e1", "e2", "e3"]


def contacts(rng, count=12, rows=400):
    """Motions between the same two rests, read in whole counts: most rows are equal to some of other motions."""
    for number in range(count):
        way = np.clip((np.arange(rows) - 50) / rng.uniform(40, 80), 0, 1)
        # Between two counts at rest, and a count of chatter.
        yield episode(f"e{number}", np.rint(1000 - 300 * way + rng.choice(2, rows)) / 1000)


def test_rests_in_whole_counts_are_no_duplicates_but_a_cut_of_a_motion_is(judged, rng):
    episodes = [as_stored(e) for e in contacts(rng)]
    assert not judged(episodes, rules=["duplicates"])
    source = episodes[4]
    cut = {name: array[10:] for name, array in source.arrays.items()}
    copy = with_arrays(as_stored(episode("copy", np.zeros(len(cut["time_ns"])))), cut)
    assert [(f.episode, f.evidence["same_as"]) for f in judged([*episodes, copy], rules=["duplicates"])] == [
        ("copy", "e4")
    ]


def test_two_recordings_of_rest_are_no_duplicates(judged):
    assert not found(judged, [episode(name, np.zeros(100)) for name in ("a", "b")], "duplicates")


def test_a_supply_that_sags_is_found_and_a_noisy_one_is_not(judged, rng):
    joint = encoder(np.sin(2 * time_s()))
    steady = 7.4 + rng.normal(0, 0.1, (len(joint), 1))
    sagging = steady - 1.5 * (np.abs(np.cos(2 * time_s())) > 0.9)[:, None]
    episodes = [episode("steady", joint, supply_voltage=steady), episode("sags", joint, supply_voltage=sagging)]
    (finding,) = found(judged, episodes, "supply_sag")
    assert (finding.episode, finding.evidence["actuator"]) == ("sags", "a")
    assert finding.evidence["usual_V"] == pytest.approx(7.4, abs=0.1)


def test_a_servo_that_is_off_for_a_while_is_found_where_it_is(judged):
    joint = encoder(np.sin(2 * time_s()))
    on = ((time_s() < 1.0) | (time_s() > 2.0))[:, None]
    episodes = [episode("on", joint, torque_on=np.ones_like(on)), episode("off", joint, torque_on=on)]
    (finding,) = found(judged, episodes, "torque_off")
    assert (finding.episode, finding.ranges) == ("off", ((1.0, 2.0),))


@pytest.mark.parametrize(("name", "rule"), [("encoder_spiked", "encoder_spikes"), ("joint_stuck", "stuck_readings")])
def test_the_injected_defects_are_found_in_a_real_log(shared, judged, rng, name, rule):
    from candata.fetch.so101_motions import TABLE

    motions = TABLE.from_folder(shared / "realdata" / "so101_motions").episodes
    sound = [as_stored(e) for e in motions if e.meta.id in ("end_effector", "random_waypoints", "triangle_wave")]
    assert not judged(sound, rules=[rule])
    assert {f.episode for f in judged([with_defect(raw, name, rng) for raw in sound], rules=[rule])} == {
        raw.id for raw in sound
    }
