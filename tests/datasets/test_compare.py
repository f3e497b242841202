from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import wasserstein_distance

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets import compare as comparing
from candata.datasets.compare import compare
from candata.datasets.distance import Pool
from candata.errors import DataError
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage


def make(path, count, seed, *, lag=0, speed=1.0, rate_hz=100.0, joints=("a", "b"), force=False, source="sim"):
    """A set of wandering joints whose positions lag `lag` rows behind their commands."""
    rng, rows = np.random.default_rng(seed), 200
    episodes = []
    for k in range(count):
        walk = 0.01 * speed * np.cumsum(rng.normal(size=(rows + lag, len(joints))), axis=0)
        arrays = {
            "time_ns": (np.arange(rows) * 1e9 / rate_hz).astype(np.int64),
            "action": walk[lag:] if lag else walk,
            "joint_position": walk[:rows],
        }
        if force:
            arrays["fingertip_force"] = np.abs(rng.normal(size=(rows, 1, 3)))
        meta = EpisodeMeta(
            id=f"e{k}", source=source, rate_hz=rate_hz, joint_names=joints, actuator_names=joints, action="previous"
        )
        episodes.append(Episode(meta, arrays))
    append(create_dataset(path), episodes, Lineage(operation="test"))
    return open_dataset(path)


@pytest.mark.parametrize("size", [5, 40, 4000])
def test_the_distance_is_wassersteins(rng, size):
    first = [rng.normal(size=size) for _ in range(3)]
    second = [rng.normal(0.5, 2.0, size=size) for _ in range(4)]
    pool = Pool.of(*([(k, size, Pool.sketch(v)) for k, v in enumerate(side)] for side in (first, second)), 3, 4)
    found = pool.distance(np.arange(7)[None] < 3)[0]
    # 32 numbers an episode and 257 edges cost a hundredth or two of the distance; few values are kept whole
    exact = wasserstein_distance(np.concatenate(first), np.concatenate(second))
    assert found == pytest.approx(exact, rel=0.03 if size > 32 else 1e-6)


def test_two_sets_of_one_world_do_not_differ(tmp_path):
    found = compare(make(tmp_path / "x", 12, 1), make(tmp_path / "y", 12, 2)).comparison
    assert len(found.rows) == 8
    assert not any(row.differs for row in found.rows)
    assert (found.unmatched, found.notes) == ((), ())


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_promised(tmp_path):
    alarms = 0
    for k in range(40):
        pair = (make(tmp_path / f"{side}{k}", 8, 1000 * k + n) for n, side in enumerate("xy"))
        alarms += any(row.differs for row in compare(*pair).comparison.rows)
    assert alarms <= 6  # at a chance of 1 in 20 each, more than 6 of 40 come once in 60 such tests


def test_a_lag_and_a_speed_stand_out_and_come_first(tmp_path):
    found = compare(make(tmp_path / "x", 10, 1), make(tmp_path / "y", 10, 2, lag=4, speed=1.5)).comparison
    assert found.rows[0].differs
    first = {(row.statistic, row.element): row for row in found.rows}
    late = first["lag behind the command", "a"]
    assert late.differs
    assert late.distance == pytest.approx(0.04, abs=0.002)  # four rows at 100 Hz, to a fifth of a row
    assert late.against.median == pytest.approx(0.04, abs=0.002)
    assert first["joint speed", "b"].differs
    assert all(row.spreads <= 2 + 1e-9 for row in found.rows)


def test_what_only_one_side_has_is_said(tmp_path):
    this = make(tmp_path / "x", 5, 1, joints=("a", "b", "c"))
    found = compare(this, make(tmp_path / "y", 5, 2, joints=("a", "z"), force=True)).comparison
    text = "\n".join(found.unmatched)
    assert {row.element for row in found.rows} == {"a"}
    assert "joint acceleration, joint speed, lag behind the command, rms of command minus position of b, c" in text
    assert "channels only in y: fingertip_force" in text
    assert any("derived" in note for note in found.notes)


def test_other_rates_are_brought_to_one_step(tmp_path):
    found = compare(make(tmp_path / "x", 4, 1), make(tmp_path / "y", 4, 2, rate_hz=25.0)).comparison
    assert found.step_s == 0.04
    assert any("rates differ: 100 Hz beside 25 Hz" in note for note in found.notes)


def test_too_few_episodes_say_nothing_of_luck(tmp_path):
    found = compare(make(tmp_path / "x", 1, 1), make(tmp_path / "y", 1, 2, lag=4)).comparison
    assert {row.differs for row in found.rows} == {None}
    assert {row.luck for row in found.rows} == {None}


def test_of_many_episodes_some_are_read_and_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(comparing, "MOST_EPISODES", 4)
    read = []
    this = make(tmp_path / "x", 9, 1)
    found = compare(this, make(tmp_path / "y", 4, 2), lambda: read.append(1)).comparison
    assert (found.this.compared, found.this.episodes, len(read)) == (4, 9, 8)
    assert found.notes == ("4 of 9 episodes of x were read, evenly by id",)


def test_nothing_in_common_is_an_error(tmp_path, episode):
    root = create_dataset(tmp_path / "y")
    base = episode("a", contact=False)
    append(root, [Episode(base.meta, {n: base[n] for n in ("time_ns", "object_pose")})], Lineage(operation="test"))
    with pytest.raises(DataError, match="nothing in common"):
        compare(make(tmp_path / "x", 2, 1), open_dataset(root))


def test_the_same_data_give_the_same_record(tmp_path):
    pair = make(tmp_path / "x", 4, 1), make(tmp_path / "y", 4, 2)
    assert compare(*pair).comparison == compare(*pair).comparison


def test_bars_hold_the_samples_that_lie_on_their_first_edge():
    pool = Pool.of([(0, 4, np.float32([0, 0, 0, 1]))], [(0, 4, np.float32([0, 2, 2, 3]))], 1, 1)
    drawn = pool.bars(np.array([True, False]))
    assert drawn.this.sum() == pytest.approx(1.0)
    assert drawn.against.sum() == pytest.approx(1.0)
    assert drawn.this[0] == pytest.approx(0.75)


def test_bars_of_many_samples_have_no_heap_at_their_end(rng):
    sides = [[(0, 32, Pool.sketch(rng.exponential(size=32))) for _ in range(60)] for _ in range(2)]
    drawn = Pool.of(
        [(k, n, v) for k, (_, n, v) in enumerate(sides[0])], [(k, n, v) for k, (_, n, v) in enumerate(sides[1])], 60, 60
    ).bars(np.arange(120) < 60)
    assert drawn.this[-1] < drawn.this[len(drawn.this) // 2]


def test_two_sets_of_one_name_are_told_apart(tmp_path):
    for side in "xy":
        (tmp_path / side).mkdir()
    found = compare(make(tmp_path / "x" / "ds", 2, 1), make(tmp_path / "y" / "ds", 2, 2, force=True)).comparison
    assert (found.this.label, found.against.label, found.this.name) == ("ds (this)", "ds (against)", "ds")
    assert found.unmatched[0] == "channels only in ds (against): fingertip_force"
