"""Factors of all fingertips: a unit, a sensor's gain, or not to be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.mismatch.fingertip_exchange import exchange_findings
from candata.gap.mismatch.force_units import scale_findings
from candata.gap.mismatch.sensors import tare

#: A fingertip is free in the first rows, then pressed with a changing force [N].
ROWS, FREE = 60, 20


@pytest.fixture
def pressed() -> np.ndarray:
    """Forces `(E, T, F, 3)` of the scene on five fingertips."""
    press = np.zeros((4, ROWS, 5, 3))
    press[:, FREE:, :, 2] = 3 + np.sin(np.linspace(0, 9, ROWS - FREE))[None, :, None]
    return press


@pytest.fixture
def told(hand, pressed, plain_recordings):
    """The function that returns what is found where forces are `times` the scene's, with noise of a spread [N]."""

    def found(times, noise: float, declared: bool = True):
        rng = np.random.default_rng(5)
        force = times * pressed + noise * rng.standard_normal(pressed.shape)
        scene = hand if declared else replace(hand, file=hand.file.model_copy(update={"noise": None}))
        return [(f.definite, f.found) for f in scale_findings(scene, plain_recordings(fingertip_force=force), pressed)]

    return found


#: Near the spread that `xhand_tabletop` declares [N].
SPREAD = 0.025
KGF = 1 / 9.80665


@pytest.mark.parametrize(
    ("times", "noise", "definite", "words"),
    [
        (KGF, KGF, True, "(kgf: 0.102)"),
        # With a gain of 0.7 on top.
        (0.7 * KGF, KGF, True, "(kgf: 0.102)"),
        # Noise in newtons: a sensor that feels a tenth.
        (KGF, 1.0, False, "`tactile_gain` explains it as well"),
        (0.2, 0.2, False, "`tactile_gain` explains it as well"),
        (0.06, 1.0, False, "`tactile_gain` goes from 0.1 to 6"),
        # A contact of the scene alone makes forces small, and their noise stays what it is.
        (0.0243, 0.3, False, "`tactile_gain` goes from 0.1 to 6"),
        (10.0, 10.0, False, "`tactile_gain` goes from 0.1 to 6"),
        (1e3, 1e3, True, "(mN: 1000)"),
        (1e3, 1.0, True, "(mN: 1000)"),
        (102.0, 102.0, True, "(gf: 102)"),
        (5e4, 5e4, True, "(no known unit)"),
    ],
)
def test_a_factor_is_a_unit_where_noise_has_it_too(told, times, noise, definite, words):
    ((sure, text),) = told(times, noise * SPREAD)
    assert sure == definite
    assert words in text


@pytest.mark.parametrize(("times", "definite"), [(KGF, True), (1.1 * KGF, True), (0.75 * KGF, False)])
def test_without_declared_noise_only_the_factor_itself_is_sure(told, times, definite):
    ((sure, _),) = told(times, times * SPREAD, declared=False)
    assert sure == definite


@pytest.mark.parametrize("times", [0.5, 0.7, 1.0, 2.0, 5.0, 0.2])
def test_a_gain_that_can_be_is_silent(told, times):
    assert told(times, SPREAD) == []


def test_fingertips_with_factors_of_their_own_are_no_unit(told):
    assert told(np.array([KGF, 1, 1, 1, 1])[:, None], SPREAD) == []
    assert told(np.array([KGF, KGF, 0, 0, 0])[:, None], 0.1 * SPREAD) == []
    assert told(np.array([KGF, KGF, KGF, 1, 1])[:, None], KGF * SPREAD) == []


@pytest.mark.parametrize(("times", "unit"), [(1e3, "mN: 1000"), (102.0, "gf: 102"), (KGF, "kgf: 0.102")])
@pytest.mark.parametrize("declared", [True, False])
def test_one_fingertip_in_another_unit_is_named(told, hand, times, unit, declared):
    factors = np.array([1, 1.2, times, 0.8, 1])[:, None]
    ((sure, text),) = told(factors, factors * SPREAD, declared)
    assert sure
    assert text.startswith(hand.file.fingertips[2])
    assert unit in text
    # Without noise, a tenth may be a gain: only what no gain reaches is a unit.
    assert bool(told(factors, 0.0, declared)) == (times > 6)


def test_one_fingertip_of_another_gain_is_no_unit(told):
    for times in (0.15, 0.3, 3.0, 6.0):
        assert told(np.array([1, times, 1, 1, 1])[:, None], SPREAD) == []
        assert told(np.array([1, times, 1, 1, 1])[:, None], 0.0) == []


def test_a_finger_of_a_weak_motor_does_not_hide_a_unit(told):
    factors = KGF * np.array([1, 0.5, 1.2, 1.1, 1])[:, None]
    assert [sure for sure, _ in told(factors, KGF * SPREAD)] == [True]


def test_two_fingertips_that_feel_alike_are_not_called_exchanged(hand, pressed, plain_recordings):
    two = replace(hand, file=hand.file.model_copy(update={"fingertips": hand.file.fingertips[:2]}))
    alike, rng = pressed[:, :, :2], np.random.default_rng(4)
    for own in (alike, alike * np.array([1, 0.5])[:, None]):
        real = own[:, :, ::-1] + SPREAD * rng.standard_normal(own.shape)
        assert exchange_findings(two, plain_recordings(fingertip_force=real), own) == []
    apart = alike.copy()
    apart[:, FREE : 2 * FREE, 0] = apart[:, 2 * FREE :, 1] = 0
    (one,) = exchange_findings(two, plain_recordings(fingertip_force=apart[:, :, ::-1]), apart)
    assert one.elements == two.file.fingertips


def test_an_exchange_that_some_episodes_speak_against_is_sure_only_where_forces_then_agree(
    hand, pressed, plain_recordings
):
    two = replace(hand, file=hand.file.model_copy(update={"fingertips": hand.file.fingertips[:2]}))
    own = np.tile(pressed[:, :, :2], (2, 1, 1, 1))
    own[:, FREE : 2 * FREE, 0] = own[:, 2 * FREE :, 1] = 0
    real = own.copy()
    real[::2] = own[::2, :, ::-1]
    (one,) = exchange_findings(two, plain_recordings(fingertip_force=real), own)
    assert one.definite
    # A pull to the side in every touch, as no exchange explains it: 45 deg.
    real += np.where(real[..., 2:] != 0, np.abs(real[..., 2:]) * np.array([1.0, 0, 0]), 0)
    (one,) = exchange_findings(two, plain_recordings(fingertip_force=real), own)
    assert not one.definite
    assert "may be" in one.problem


def test_fingertips_in_turned_frames_are_not_called_exchanged(hand, pressed, plain_recordings):
    two = replace(hand, file=hand.file.model_copy(update={"fingertips": hand.file.fingertips[:2]}))
    # One feels along z, the other along x, and a little later; both frames are turned so that it looks exchanged.
    own = pressed[:, :, :2].copy()
    own[:, 5:, 1] = own[:, :-5, 1][..., [2, 0, 1]]
    real = np.stack([own[:, :, 0][..., [2, 0, 1]], own[:, :, 1][..., [1, 2, 0]]], axis=2)
    assert exchange_findings(two, plain_recordings(fingertip_force=real), own) == []
    assert exchange_findings(two, plain_recordings(fingertip_force=own[:, :, ::-1]), own) != []


def test_what_presses_from_the_first_row_is_no_tare():
    """A replay touches from its second row on what the recorded fingertip presses from the first."""
    recorded = np.full((3, 20, 1, 3), [0.0, 0.0, -1.2])
    nominal = recorded.copy()
    nominal[:, 0] = 0.0
    assert tare(recorded, nominal).tolist() == [[0.0, 0.0, 0.0]]
    nominal[:, :5] = 0.0
    recorded[:, :5] = [0.1, 0.0, 0.0]
    assert tare(recorded, nominal).tolist() == [[0.1, 0.0, 0.0]]
