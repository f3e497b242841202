"""Filling a library: what a diagnosis would keep, bit for bit, by whatever crew; a diagnosis after it makes nothing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import DataError
from candata.gap import diagnose
from candata.gap.blind.runs import Place
from candata.gap.blind.signature_library import MANY, keep_signature, planned, shared_by, shared_tasks, source
from candata.gap.fit import signatures
from candata.gap.fit.candidates import candidates
from candata.gap.preparation import posed
from candata.gap.replay.replayer import Replayer
from candata.gap.screening.episodes import brief
from candata.gap.screening.signature_screen import respond
from candata.schema.manifest import Lineage
from candata.simulate.cluster import on_ray
from candata.simulate.crew import alone, local

ONLY = ("joint_damping", "servo_gain", "actuation_delay")


def recorded(folder: Path, episodes) -> Path:
    create_dataset(folder, folder.name)
    append(folder, episodes, Lineage(operation="test"))
    return folder


@pytest.fixture(scope="module")
def damped(tmp_path_factory, arm_episodes, planted):
    """A dataset of an arm with damped joints, so many short episodes that a few are looked at first."""
    episodes = arm_episodes(planted("joint_damping", damping_Nms_rad=0.3), count=12, rows=80)
    return recorded(tmp_path_factory.mktemp("damped") / "real", episodes)


def kept(cache: Path) -> dict[str, dict[str, np.ndarray]]:
    """Return the arrays of every file of a cache, by its place in it."""
    return {str(f.relative_to(cache)): dict(np.load(f)) for f in sorted(cache.rglob("*.npz"))}


def same(one, other) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k], equal_nan=True) for k in one)


def of(damped, arm, cache):
    return source(damped, arm.name, cache)._replace(only=ONLY)


@pytest.fixture(scope="module")
def filled(damped, arm, tmp_path_factory):
    """The cache after a filling in this process."""
    cache = tmp_path_factory.mktemp("filled")
    plan = planned(of(damped, arm, cache))
    assert len(plan.tasks) == plan.total
    list(alone(keep_signature, plan.tasks))
    return cache


@pytest.fixture
def simulated(monkeypatch):
    """Which effect sets are recorded in a simulated world from now on."""
    heard = []
    record = signatures._recorded

    def heard_of(replayer, recs, begin, plan, world):
        heard.append(world)
        return record(replayer, recs, begin, plan, world)

    monkeypatch.setattr(signatures, "_recorded", heard_of)
    return heard


def test_what_a_diagnosis_keeps_a_filling_has_kept_bit_for_bit_and_a_diagnosis_after_it_simulates_none(
    damped, arm, filled, simulated, tmp_path
):
    data = open_dataset(damped)
    planned(of(damped, arm, tmp_path))  # a library that is begun is shared
    cold = diagnose(data, arm, cache=tmp_path, only=ONLY, shared_signatures=True)
    asked = len(simulated)
    ours, theirs = kept(tmp_path), kept(filled)
    assert asked > 20
    assert set(ours) <= set(theirs)
    assert all(same(ours[name], theirs[name]) for name in ours)
    warm = diagnose(data, arm, cache=filled, only=ONLY, shared_signatures=True)
    assert len(simulated) == asked
    assert warm.report == cold.report
    assert any("signatures" in note for note in warm.report.data.notes), "the report says what it was drawn from"


def test_a_diagnosis_of_its_own_says_the_same_with_no_cache_a_cold_a_warm_and_a_filled_one(
    damped, arm, filled, simulated, tmp_path
):
    data = open_dataset(damped)
    fresh = diagnose(data, arm, only=ONLY)
    cold = diagnose(data, arm, cache=tmp_path, only=ONLY)
    made = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.npz")}
    warm = diagnose(data, arm, cache=tmp_path, only=ONLY)
    assert simulated == []
    assert warm.report == cold.report == fresh.report
    assert fresh.replays == cold.replays > warm.replays > 1, "what was kept is not simulated again"
    assert fresh.report.effects[0].name == "joint_damping"
    assert len(made) > 20
    assert made == {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.npz")}
    others = shutil.copytree(filled, tmp_path / "filled")
    assert diagnose(data, arm, cache=others, only=ONLY).report == fresh.report, "nobody asked for what is shared"


def test_the_least_filling_is_the_first_look(damped, arm, simulated, tmp_path):
    plan = planned(of(damped, arm, tmp_path), "first")
    list(alone(keep_signature, plan.tasks))
    problem = posed(open_dataset(damped), Replayer(arm), 0, tmp_path, ONLY, share=None).problem
    part, index = brief(problem)
    some = [c for c in candidates(arm, list(problem.recs.readings)) if c.name in ONLY]
    done = len(simulated)
    respond(part, part.nominal, some)
    assert len(index) < len(problem.recs)
    assert len(simulated) == done
    respond(problem, problem.nominal, some)
    assert len(simulated) > done


def test_a_filling_that_was_stopped_goes_on(damped, arm, filled, simulated, tmp_path):
    plan = planned(of(damped, arm, tmp_path))
    list(islice(alone(keep_signature, plan.tasks), 5))
    rest = planned(of(damped, arm, tmp_path))
    assert (rest.total, len(rest.tasks)) == (plan.total, plan.total - 5)
    list(alone(keep_signature, rest.tasks))
    assert planned(of(damped, arm, tmp_path)).tasks == []
    assert len({str(w) for w in simulated}) <= plan.total + 1
    ours, theirs = kept(tmp_path), kept(filled)
    assert set(ours) == set(theirs)
    assert all(same(ours[name], theirs[name]) for name in ours)


def test_two_processes_keep_what_one_keeps(damped, arm, filled, tmp_path):
    tasks = planned(of(damped, arm, tmp_path)).tasks[-6:]
    before = len(kept(tmp_path))
    done = list(local(2)(keep_signature, tasks))
    assert all(one.cpu_s >= 0 for one in done)
    ours, theirs = kept(tmp_path), kept(filled)
    assert len(ours) == before + len(tasks)
    assert all(same(ours[name], theirs[name]) for name in ours)


def test_ray_keeps_what_one_process_keeps(damped, arm, filled, tmp_path):
    pytest.importorskip("ray")
    with on_ray("local", tmp_path, 2) as crew:
        list(crew(keep_signature, planned(of(damped, arm, tmp_path)).tasks))
    ours, theirs = kept(tmp_path), kept(filled)
    assert set(ours) == set(theirs)
    assert all(same(ours[name], theirs[name]) for name in ours)


def test_what_is_filled_for_other_recordings_is_what_they_ask_for(damped, arm, tmp_path):
    """A sensor at fault read the start of the recording itself, and another start in the others."""
    some = source(damped, arm.name, tmp_path)._replace(only=("joint_offset",))
    plans = [planned(some._replace(shared=shared), "first") for shared in (True, False)]
    assert [len(plan.tasks) for plan in plans] == [plan.total for plan in plans]
    list(alone(keep_signature, plans[0].tasks))
    assert planned(some._replace(shared=True), "first").tasks == []
    assert len(planned(some, "first").tasks) == plans[1].total > 0


def test_nothing_is_kept_for_tosses(cube, played, tmp_path):
    data = recorded(tmp_path / "real", played(cube, duration_s=0.7))
    assert planned(source(data, cube.name, tmp_path / "cache")) == (0, [])
    assert shared_by([Place(data, cube.name, "a"), Place(data, cube.name, "b")], tmp_path, 0) is None


def test_too_few_episodes_are_refused(arm, arm_episodes, tmp_path):
    data = recorded(tmp_path / "real", arm_episodes(count=3, rows=80))
    with pytest.raises(DataError, match="nothing to diagnose") as caught:
        planned(source(data, arm.name, tmp_path / "cache"))
    assert "found: 3 episodes" in str(caught.value)


@pytest.fixture
def cases(arm, arm_episodes, tmp_path):
    """The function that makes a place of recordings that begin elsewhere, or of other commands."""

    def make(name: str, off_rad: float = 0.0, seed: int = 1) -> Place:
        made = arm_episodes(count=8, rows=80, seed=seed)
        moved = [replace(e, arrays=e.arrays | {"joint_position": e.arrays["joint_position"] + off_rad}) for e in made]
        return Place(recorded(tmp_path / name, moved), arm.name, name)

    return make


def test_cases_are_filled_from_recordings_that_begin_where_most_do(cases, tmp_path):
    places = [cases("a", off_rad=0.3), cases("b"), cases("c"), cases("d", off_rad=0.02)]
    found = shared_by(places, tmp_path, 7)
    assert found is not None
    assert Path(found.dataset).name == "b"
    assert found.seed == 7


def test_cases_of_other_commands_are_not_filled_for(cases, tmp_path):
    places = [cases(name, seed=i) for i, name in enumerate("abcd", start=1)]
    assert shared_by(places, tmp_path, 0) is None
    assert shared_by(places[:1], tmp_path, 0) is None
    assert shared_tasks(places, tmp_path / "cache", 0) == []


def test_a_case_that_cannot_be_read_is_no_harm(cases, arm, tmp_path):
    broken = Place(tmp_path / "nowhere", arm.name, "x")
    found = shared_by([broken, cases("a"), cases("b")], tmp_path, 0)
    assert found is not None
    assert shared_by([broken, broken], tmp_path, 0) is None


def test_more_cases_are_worth_more_signatures(cases, tmp_path):
    one = cases("a")
    few, many = (shared_tasks([one] * n, tmp_path / "cache", 0) for n in (2, MANY))
    assert 0 < len(few) < len(many)
