"""Regimes: where a planted excess lies is named, and none is where it lies everywhere."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.run.streams import Streams
from candata.gap.verdict.regime import motion, regimes, splits, with_regimes, within_and_beside
from candata.schema.report import Symptom

E, BLOCKS, ROWS = 12, 60, 5


def sines(noise: float = 0.001) -> np.ndarray:
    """Two joints `(E, T, 2)` that swing: a second up, half a second of rest, a second down."""
    rng = np.random.default_rng(0)
    t = np.arange(BLOCKS * ROWS) / 100 + rng.uniform(0, 0.3, (E, 1))
    swing = np.interp(t, [0.0, 0.3, 1.3, 1.8, 2.8, 9.0], [0, 0, 1, 1, 0, 0])
    return np.stack([swing, -swing], axis=-1) + noise * rng.standard_normal((E, t.shape[1], 2))


def test_each_block_moves_turns_or_stands(rng):
    found = motion(sines(), BLOCKS, ROWS)
    first = {name: flags[0, :, 0] for name, flags in found.items()}
    rows = {name: np.flatnonzero(flags) * ROWS / 100 for name, flags in first.items()}
    shift = np.random.default_rng(0).uniform(0, 0.3, (E, 1))[0, 0]
    assert rows["moving +"].min() + shift == pytest.approx(0.3, abs=0.15)
    assert rows["moving -"].max() + shift == pytest.approx(2.8, abs=0.15)
    # Set out downwards after half a second of rest: a reversal all the same, though the first start is none.
    assert rows["reversal"].min() + shift > 1.5
    assert rows["reversal"].max() + shift < 2.1
    each = np.stack([first[name] for name in ("moving +", "moving -", "reversal", "still")])
    assert (each[:, 1:-1].sum(0) == 1).all()
    assert (first["moving"] == (first["moving +"] | first["moving -"])).all()
    # The other joint does the opposite.
    assert (found["moving +"][..., 1] & found["moving +"][..., 0]).sum() == 0


def test_noise_alone_does_not_move():
    rng = np.random.default_rng(1)
    found = motion(0.002 * rng.standard_normal((E, BLOCKS * ROWS, 1)), BLOCKS, ROWS)
    # Four standard deviations of 700 blocks: one in a hundred such sets has one that passes.
    assert found["moving"].sum() + found["reversal"].sum() <= 3


def test_what_was_not_seen_is_in_no_regime():
    joint = sines()
    joint[:, 50:100] = np.nan
    found = motion(joint, BLOCKS, ROWS)
    assert not any(flags[:, 11:19].any() for name, flags in found.items() if name != "reversal")
    assert not found["reversal"][:, 11:19].any()


def test_blocks_are_compared_within_their_stratum():
    flags = np.tile(np.array([[1, 1, 1, 0, 0, 0, 0, 1]], bool), 2)
    strata = np.tile(np.array([[[1, 1, 1, 1, 0, 0, 0, 0]], [[0, 0, 0, 0, 1, 1, 1, 1]]], bool), 2)
    # The second stratum lies five higher, the regime one, whatever the mix of the two.
    excess = 5.0 * strata[1] + 1.0 * flags
    inside, outside = within_and_beside(excess, flags, strata)
    assert inside - outside == pytest.approx([1.0])
    assert np.isnan(within_and_beside(np.full((1, 16), np.nan), flags, strata)).all()
    assert np.isnan(within_and_beside(excess, np.ones((1, 16), bool), strata)).all()


@pytest.fixture
def world(arm, one_phase, white_score, plain_recordings):
    """The function that makes a problem of the arm: white residuals, changed by a function of the regimes."""

    def make(change, seed: int = 0):
        rng = np.random.default_rng(seed)
        plan = one_phase(E, BLOCKS, 2, ("free", "onset"))
        plan = SimpleNamespace(**vars(plan) | {"columns": tuple(("joint_position", j, "rad") for j in arm.file.joints)})
        recs = plain_recordings(joint_position=sines())
        known = regimes(arm, recs, plan)
        z = change(rng.standard_normal((E, BLOCKS, 2)), known).reshape(E, -1).astype(np.float32)
        level = white_score(rng, E, BLOCKS * 2, columns=2)
        return SimpleNamespace(
            replayer=SimpleNamespace(scene=arm), recs=recs, plan=plan, score=level, nominal=z, stream=Streams(seed).of
        )

    return make


def named(problem, p: float = 0.001) -> list[str | None]:
    """The regimes of a symptom of each joint."""
    some = [Symptom(channel="joint_position", element=j, phase="free", ratio=3.0, p=p) for j in ("shoulder", "elbow")]
    return [s.regime for s in with_regimes(some, problem)]


@pytest.mark.parametrize("regime", ["moving", "moving +", "moving -", "reversal", "still"])
def test_the_regime_of_a_planted_excess_is_named(world, regime):
    problem = world(lambda z, known: z * np.where(known.motion[regime] & (np.arange(2) == 0), 5.0, 1.0))
    assert named(problem) == [regime, None]


def test_a_symptom_that_is_not_sure_has_no_regime(world):
    problem = world(lambda z, known: z * np.where(known.motion["moving"], 5.0, 1.0))
    assert named(problem, p=0.2) == [None, None]
    assert named(problem) == ["moving", "moving"]


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_an_excess_that_lies_everywhere_has_no_regime(world, shift):
    found = [named(world(lambda z, known: z + shift, seed)) for seed in range(60)]
    # Family-wise 5 %: of 60 sets three are meant, eight come up once in a hundred.
    assert sum(any(f) for f in found) <= 8


def test_of_a_joint_without_a_fingertip_it_is_known_where_its_motor_pulls(arm, plain_recordings, one_phase):
    rng = np.random.default_rng(2)
    joint = 0.002 * rng.standard_normal((2, 40, 2))
    commands = np.zeros((2, 40, 2))
    commands[:, 20:, 0] = 0.1
    known = regimes(arm, plain_recordings(commands=commands, joint_position=joint), one_phase(2, 8, 2))
    flags = {j: splits(arm, known, "joint_position", j).get("pulling") for j in arm.file.joints}
    assert flags["shoulder"][0].tolist() == [[False] * 4 + [True] * 4] * 2
    assert flags["elbow"] is None, "noise is no load"
    # A regime is compared among blocks of the same motion.
    assert flags["shoulder"][1].shape == (4, 2, 8)


def test_fingers_are_loaded_by_what_they_carry(hand, plain_recordings, one_phase):
    force = np.zeros((1, 40, 5, 3))
    tip = hand.file.fingertips.index(next(t for t in hand.file.fingertips if t.startswith("index")))
    force[:, 20:, tip, 2] = 2.0
    recs = plain_recordings(joint_position=np.zeros((1, 40, 15)), fingertip_force=force)
    known = regimes(hand, recs, one_phase(1, 8, 1))
    loaded = {j: splits(hand, known, "joint_position", j).get("loaded") for j in hand.file.joints}
    assert {j for j, flags in loaded.items() if flags is not None} == {
        j for j in hand.file.joints if j.startswith(("index", "wrist"))
    }
    assert loaded["index1"][0].tolist() == [[False] * 4 + [True] * 4]
    assert set(splits(hand, known, "fingertip_force", f"{hand.file.fingertips[tip]} z")) == {"loaded", "free"}
    assert set(splits(hand, known, "object_pose", "position z")) == {"loaded", "free"}
