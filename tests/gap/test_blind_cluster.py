"""A run on Ray gives what a run here gives, outlives its workers, and says what is wrong with a cluster."""

from __future__ import annotations

import os
import signal
import socket
import sys
from pathlib import Path

import pytest

from candata.errors import MissingExtraError, SetupError, UsageError
from candata.gap.blind.cases import CASES, make_cases, read_cases
from candata.gap.blind.labels import seal_labels
from candata.gap.blind.runs import RESULTS, Place, finished, run_cases
from candata.schema.bench import CaseResult
from candata.simulate import cluster
from candata.simulate.cluster import on_ray

SMALL = {"seed": 1, "episodes": 2, "duration_s": 0.4}
SCENE = "cube_toss"
#: What no two runs share.
OWN = {"cpu_s", "process", "cold", "replays"}


@pytest.fixture(scope="module")
def crew(tmp_path_factory):
    """Two workers of a cluster of this machine."""
    pytest.importorskip("ray")
    with on_ray("local", tmp_path_factory.mktemp("shared"), 2) as found:
        yield found


def told(results):
    return [r.model_dump(exclude=OWN) for r in results]


def test_cases_made_and_diagnosed_on_ray_are_those_made_and_diagnosed_here(crew, cube, tmp_path):
    sealed = seal_labels(tmp_path / "ray", cube, {"one": 2, "null": 1}, **SMALL)
    made = [Path(p) for p in make_cases(tmp_path / "ray", SCENE, sealed, crew=crew, **SMALL)]
    again = make_cases(tmp_path / "here", SCENE, sealed, **SMALL)
    places = [Place(p, SCENE, c.sealed) for p, c in read_cases(tmp_path / "ray" / CASES).items()]
    assert [p.name for p in made] == [p.folder.name for p in places] == [p.name for p in again]
    theirs, ours = (run_cases(tmp_path / name, places, **how) for name, how in (("r", {"crew": crew}), ("h", {})))
    assert told(theirs) == told(ours)
    assert {r.process for r in theirs}.isdisjoint({os.getpid()})
    assert all(r.report for r in theirs)


def test_a_run_that_stopped_goes_on_with_what_is_missing(crew, cube, tmp_path):
    sealed = seal_labels(tmp_path, cube, {"null": 3}, **SMALL)
    make_cases(tmp_path, SCENE, sealed, **SMALL)
    places = [Place(p, SCENE, c.sealed) for p, c in read_cases(tmp_path / CASES).items()]

    def stop(result):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cases(tmp_path, places, crew=crew, told=stop)
    heard: list[CaseResult] = []
    run_cases(tmp_path, places, crew=crew, told=heard.append)
    assert len(heard) == 2
    assert len(finished(tmp_path / RESULTS, CaseResult)) == 3


def test_a_task_whose_worker_died_is_begun_anew(crew, tmp_path):
    def dies_once(name):
        mark = Path(name)
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return name

    marks = [(str(tmp_path / "a"),), (str(tmp_path / "b"),)]
    assert sorted(crew(dies_once, marks)) == sorted(name for (name,) in marks)


def test_what_a_task_finds_wrong_is_said_as_it_is_here(crew):
    def wrong():
        raise UsageError("no such scene", fix="name another")

    with pytest.raises(UsageError, match="no such scene") as caught:
        list(crew(wrong, [()]))
    assert "do: name another" in str(caught.value)


def test_a_machine_that_does_not_see_the_folder_or_holds_another_candata_is_refused(tmp_path):
    with pytest.raises(SetupError, match="machine n7 of the Ray cluster does not see"):
        cluster._check_machine((False, cluster.__version__), "machine n7", tmp_path)
    with pytest.raises(SetupError, match="holds another candata"):
        cluster._check_machine((True, "0.0.0"), "machine n7", tmp_path)


def test_without_ray_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"candata\[cluster\]"), on_ray("auto", tmp_path / "out"):
        pass
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_an_address_where_nothing_listens_is_refused_at_once(form):
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(SetupError, match="cannot be joined"):
        cluster._knock(form.format(port))


def test_what_listens_but_is_no_cluster_is_given_up(monkeypatch):
    monkeypatch.setattr(cluster, "JOIN_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as mute, pytest.raises(SetupError, match="cannot be joined"):
        cluster._knock(f"127.0.0.1:{mute.getsockname()[1]}")
