"""End to end on a joint with a real servo: what a `position` actuator lacks is named, and ties are told."""

from __future__ import annotations

import numpy as np
import pytest

from candata.schema.episode import Episode, EpisodeMeta
from candata.simulate import at_rest, rollout
from tests.effects.pendulum import excitation, write_pendulum

COUNT, DURATION_S = 8, 1.5
#: Noise of an encoder of 4096 steps a turn, 1 sd [rad].
ENCODER_RAD = 0.5e-3


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return write_pendulum(tmp_path_factory.mktemp("pendulum"))


def recorded(scene, effects=(), noise_rad: float = ENCODER_RAD, seed: int = 1) -> list[Episode]:
    """Episodes of slow, fast and saturating motion in a world with effects."""
    commands = np.stack([excitation(100 * seed + i, DURATION_S) for i in range(COUNT)])
    read = rollout(scene, commands, *at_rest(scene, COUNT), [effects] * COUNT).readings["joint_position"]
    read = read + np.random.default_rng(seed).normal(0, noise_rad, read.shape)
    names = {"joint_names": scene.file.joints, "actuator_names": scene.file.actuator_names}
    return [
        Episode(
            EpisodeMeta(id=f"p{i}", source="real", rate_hz=100.0, task="mixed", **names),
            {"time_ns": np.arange(read.shape[1]) * 10_000_000, "joint_position": read[i], "action": commands[i]},
        )
        for i in range(COUNT)
    ]


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("drive_voltage", {"voltage_scale": 0.5}),
        ("back_emf", {"emf_Nms_rad": 0.12}),
        ("speed_limit", {"speed_rad_s": 1.5}),
        ("stribeck", {"breakaway_Nm": 0.05}),
        ("load_friction", {"torque_share": 0.4}),
    ],
)
def test_what_a_position_servo_lacks_is_named_alone(pendulum, planted, judge, name, parameters):
    report = judge(pendulum, recorded(pendulum, planted(name, **parameters))).report
    assert (report.verdict, [e.name for e in report.effects]) == ("explained", [name])
    ((parameter, value),) = parameters.items()
    # Twelve seconds at half a milliradian: intervals are 1 to 5 % wide, and hold most of the time.
    assert report.effects[0].parameters[parameter].value == pytest.approx(value, rel=0.05)


def test_a_servo_that_is_as_modelled_has_no_gap(pendulum, judge):
    report = judge(pendulum, recorded(pendulum)).report
    assert (report.verdict, report.effects) == ("no_gap", ())


def test_two_effects_that_make_one_world_are_one_class(pendulum, planted, judge):
    """At its nominal supply, a motor of the usual no-load speed is one whose torque falls by the limit over 6 rad/s."""
    noisy = recorded(pendulum, planted("drive_voltage", voltage_scale=1.0), noise_rad=10e-3)
    report = judge(pendulum, noisy).report
    assert (report.verdict, report.effects) == ("ambiguous", ())
    assert set(report.ambiguous_class) == {"back_emf", "drive_voltage"}
