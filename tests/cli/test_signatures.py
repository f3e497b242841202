"""`candata gap signatures` and the same in `gap bench`: what is kept, what is said, how it goes on."""

from __future__ import annotations

import json

import pytest

from candata.errors import UsageError
from candata.gap.blind import labels, runs, signature_library
from candata.schema.bench import BenchFile
from candata.schema.report import DiagnosisData, EpisodeCount, Report
from tests.cli.command import run

HAND = ("--scene", "xhand_tabletop")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Eight short recordings of the built-in hand: the fewest that are diagnosed."""
    folder = tmp_path_factory.mktemp("short") / "real"
    done = run("generate-sim", *HAND, "--episodes", 8, "--duration-s", 0.4, "--jobs", 1, "--out", folder)
    assert done.code == 0
    return folder


def test_signatures_are_kept_and_a_second_run_finds_them(short, tmp_path):
    line = ("gap", "signatures", short, *HAND, "--only", "clock_drift", "--cache-dir", tmp_path, "--jobs", 1)
    first = run(*line)
    assert first.code == 0
    assert "simulating effects: " in first.err
    again = json.loads(run(*line, "--json").out)
    assert first.out.startswith(f"{again['signatures']} signatures kept, {again['signatures']} of them new")
    assert again["signatures"] > 0
    assert (again["new"], again["cpu_s"], again["folder"]) == (0, 0.0, str(tmp_path))


def test_they_are_kept_where_a_diagnosis_looks(short, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert run("gap", "signatures", short, *HAND, "--only", "clock_drift", "--jobs", 1).code == 0
    assert list((tmp_path / "candata").rglob("*.npz"))
    caches = []

    def noted(*_, cache, **__):
        caches.append(cache)
        raise UsageError("enough")

    monkeypatch.setattr("candata.gap.diagnose", noted)
    for more in ((), ("--cache-dir", tmp_path / "mine"), ("--no-cache",)):
        assert "enough" in run("diagnose", short, *HAND, "--out", tmp_path / "out", *more).err
    assert caches == [tmp_path / "candata", tmp_path / "mine", None]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (("gap", "signatures", "{short}", *HAND, "--only", "clock_drif"), "did you mean 'clock_drift'?"),
        (("gap", "signatures", "{short}", "--scene", "nowhere.yaml"), "nowhere.yaml"),
        (("gap", "signatures", "nowhere", *HAND), "nowhere"),
        (("diagnose", "{short}", *HAND, "--out", "out", "--no-cache", "--cache-dir", "x"), "with --no-cache"),
        (("diagnose", "{short}", *HAND, "--out", "out", "--no-cache", "--shared-signatures"), "with --no-cache"),
    ],
)
def test_what_is_wrong_is_said(short, tmp_path, monkeypatch, line, text):
    monkeypatch.chdir(tmp_path)
    done = run(*(word.format(short=short) for word in line))
    assert (done.code, done.out) == (2, "")
    assert text in done.err
    assert not (tmp_path / "out").exists()


def test_a_bench_first_keeps_what_its_cases_share_and_tells_the_cost(tmp_path, monkeypatch):
    def nothing(dataset, scene, seed, cache):
        counts = EpisodeCount(total=len(dataset), folds=0, held_out=0)
        report = Report(verdict="no_gap", data=DiagnosisData(dataset=dataset.name, episodes=counts))
        return runs.Answer(report)

    monkeypatch.setitem(runs.run_cases.__kwdefaults__, "judge", nothing)
    # The secret is fixed: some draws give two nulls that start apart and share no signatures.
    monkeypatch.setattr(labels, "new_salt", lambda: "0" * 64)
    every = signature_library.wanted
    monkeypatch.setattr(signature_library, "wanted", lambda problem, depth: every(problem, depth)[:3])
    line = (
        "gap",
        "bench",
        "--out",
        tmp_path,
        *HAND,
        "--episodes",
        8,
        "--duration-s",
        1.2,
        "--jobs",
        1,
        "--kinds",
        "null",
        "--counts",
        "null=2",
    )
    done = run(*line)
    assert done.code == 0
    assert done.err.index("simulating effects for all cases: 3 done") < done.err.index("1 of 2: case-0001")
    assert len((tmp_path / signature_library.FILLED).read_text().splitlines()) == 3
    found = BenchFile.model_validate_json((tmp_path / "bench.json").read_text())
    assert [r.n for r in found.rows if r.measure.startswith("CPU s of the signatures kept before")] == [3]
    assert [r.n for r in found.rows if r.measure.startswith("CPU s of a first case")] == [1]
    again = run(*line)
    assert "simulating effects" not in again.err
    assert again.out == done.out
