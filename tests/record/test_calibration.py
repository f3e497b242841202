"""A calibration is the mean of a resting hand; a moving or touched hand is refused by name."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from candata.errors import SetupError
from candata.record.calibration import CalibrationLimits, calibrate, from_metadata, to_metadata
from candata.record.devices._contract import States

NAMES = {"joint_names": ("a", "b"), "fingertip_names": ("t", "u", "v"), "newton_per_count": 0.1, "rate_hz": 80.0}


@pytest.fixture
def rest(rng) -> States:
    """Three seconds of a hand at rest: a bias of (1, -2, 3) counts and a count of noise."""
    force = np.array([1, -2, 3]) + rng.integers(-1, 2, (240, 3, 3))
    taxels = np.ones((240, 3, 4, 3)) * np.arange(4)[:, None]
    return States(
        joint_position=0.5 + 0.001 * rng.uniform(-1, 1, (240, 2)),
        motor_current=np.zeros((240, 2)),
        motor_temperature=np.zeros((240, 2)),
        force_counts=force.astype(np.int16),
        taxel_counts=taxels.astype(np.int16),
    )


def test_the_bias_is_the_mean(rest):
    found = calibrate(rest, 3.0, **NAMES)
    # 240 draws of -1, 0, 1 have a mean within 5 standard errors, 5 sqrt(2/3/240) = 0.26 counts.
    np.testing.assert_allclose(found.force_bias_counts, np.tile([1, -2, 3], (3, 1)), atol=0.27)
    np.testing.assert_array_equal(found.taxel_bias_counts, rest.taxel_counts[0])
    assert found.rows == 240
    assert (found.force_spread_counts == 2).all()
    assert (found.joint_range_rad < 0.0021).all()


def test_a_moving_joint_is_named(rest):
    rest.joint_position[100:, 1] += 0.05
    with pytest.raises(SetupError, match=r"moved during calibration[^$]*found: b 0\.05. rad\n"):
        calibrate(rest, 3.0, **NAMES)


def test_a_joint_without_a_number_counts_as_moving(rest):
    rest.joint_position[7, 0] = np.nan
    with pytest.raises(SetupError, match="a nan rad"):
        calibrate(rest, 3.0, **NAMES)


def test_a_touch_within_the_window_is_named(rest):
    rest.force_counts[50:60, 2, 2] += 10
    with pytest.raises(SetupError, match=r"found: v changed by 1\.[0-9]+ N"):
        calibrate(rest, 3.0, **NAMES)


def test_a_steady_touch_is_named(rest):
    rest.force_counts[:, 0, 2] += 20
    with pytest.raises(SetupError, match=r"found: t under 2\.[0-9]+ N"):
        calibrate(rest, 3.0, **NAMES)


def test_the_limits_are_settings(rest):
    rest.force_counts[:, 0, 2] += 20
    assert calibrate(rest, 3.0, **NAMES, limits=CalibrationLimits(force_level_N=5.0)).rows == 240


def test_too_few_states_are_refused(rest):
    few = States(*(value[:100] for value in vars(rest).values()))
    with pytest.raises(SetupError, match="too few states"):
        calibrate(few, 3.0, **NAMES)


def test_it_passes_through_json(rest):
    found = calibrate(rest, 3.0, **NAMES)
    read = from_metadata(json.loads(json.dumps(to_metadata(found))))
    for field in dataclasses.fields(found):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(found, field.name))


def test_without_taxels_there_is_no_bias_of_taxels(rest):
    bare = dataclasses.replace(rest, taxel_counts=np.zeros((240, 3, 0, 3), np.int16))
    found = calibrate(bare, 3.0, **NAMES)
    assert found.taxel_bias_counts is None
    assert from_metadata(to_metadata(found)).taxel_bias_counts is None
