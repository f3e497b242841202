"""`candata gap bench` and `candata gap score`: files, exit codes, what is printed; a stand-in for the diagnosis."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from candata.datasets import open_dataset
from candata.gap.blind import runs
from candata.gap.blind.baselines import BASELINES
from candata.gap.blind.cases import read_cases
from candata.gap.blind.draws import NOISES
from candata.gap.blind.runs import Answer
from candata.schema.bench import BenchFile
from candata.schema.report import DiagnosisData, EpisodeCount, Report
from candata_cli import console, gap_commands
from tests.cli.command import run

SMALL = ("--scene", "cube_toss", "--episodes", 2, "--duration-s", 0.4, "--jobs", 1)
FEW = ("--kinds", "one,null", "--counts", "one=2,null=1", "--only", "sliding_friction,pose_bias")


@pytest.fixture
def quiet(monkeypatch):
    """Put a diagnosis that finds nothing in the place of the real one."""

    def nothing(dataset, scene, seed, cache):
        counts = EpisodeCount(total=len(dataset), folds=0, held_out=0)
        return Answer(Report(verdict="no_gap", data=DiagnosisData(dataset=dataset.name, episodes=counts)), 3.0)

    monkeypatch.setitem(runs.run_cases.__kwdefaults__, "judge", nothing)


@pytest.fixture
def bench(quiet, tmp_path):
    done = run("gap", "bench", "--out", tmp_path / "bench", *SMALL, *FEW)
    return SimpleNamespace(folder=tmp_path / "bench", **vars(done))


def test_a_run_prints_the_table_and_the_misses_and_writes_both(bench):
    assert bench.code == 0
    assert bench.out.startswith("cube_toss: 3 of 3 cases, 2 missed\n")
    assert [line.split()[-1] for line in bench.out.splitlines()[3:5]] == ["MISSED", "MISSED"]
    told = [line for line in bench.err.splitlines() if " left" in line]
    assert [line.split(":")[0] for line in told] == ["1 of 3", "2 of 3", "3 of 3"]
    assert told[-1].endswith("; about 0 s left")
    found = BenchFile.model_validate_json((bench.folder / "bench.json").read_text())
    assert {m.truth for m in found.misses} == {"sliding_friction", "pose_bias"}
    assert (bench.folder / "bench.html").is_file()


def test_a_second_run_diagnoses_nothing_again_and_says_the_same(bench, quiet):
    again = run("gap", "bench", "--out", bench.folder, *SMALL, *FEW)
    assert again.out == bench.out
    assert "CPU s; about" not in again.err


def test_a_run_that_goes_on_counts_what_is_left(bench, quiet):
    log = bench.folder / "results.jsonl"
    log.write_text(log.read_text().split("\n")[0] + "\n")
    again = run("gap", "bench", "--out", bench.folder, *SMALL, *FEW)
    assert "making cases: 0 done" in again.err
    assert [line.split(":")[0] for line in again.err.splitlines() if " left" in line] == ["1 of 2", "2 of 2"]


def test_when_time_is_over_no_case_is_begun_and_what_is_done_is_scored(bench, quiet):
    log = bench.folder / "results.jsonl"
    log.write_text(log.read_text().split("\n")[0] + "\n")
    over = run("gap", "bench", "--out", bench.folder, *SMALL, *FEW, "--minutes", 0)
    assert over.code == 0
    assert over.out.startswith("cube_toss: 1 of 3 cases, ")
    assert "1 of 3 cases in the time given" in over.err
    assert len(log.read_text().splitlines()) == 1
    found = BenchFile.model_validate_json((bench.folder / "bench.json").read_text())
    assert (found.done, found.cases) == (1, 3)
    whole = run("gap", "bench", "--out", bench.folder, *SMALL, *FEW, "--minutes", 60)
    assert whole.out == bench.out
    assert "in the time given" not in whole.err


def test_a_run_that_has_no_time_at_all_says_so_and_scores_nothing(quiet, tmp_path):
    done = run("gap", "bench", "--out", tmp_path / "b", *SMALL, *FEW, "--minutes", 0)
    assert done.code == 0
    assert done.out.startswith("cube_toss: 0 of 3 cases")
    assert "0 of 3 cases in the time given" in done.err
    assert run("gap", "bench", "--out", tmp_path / "b", *SMALL, *FEW, "--minutes", -1).code == 2


def test_where_no_terminal_is_a_line_now_and_then_tells_the_time_left(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress("cases", 100) as advance:
        for _ in range(100):
            now[0] += 10.0
            advance(1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["cases: 3 of 100, about 16 min left", "cases: 6 of 100, about 16 min left"]
    assert lines[-2:] == ["cases: 99 of 100, about 10 s left", "cases: 100 done"]


def test_cases_can_be_scored_elsewhere(bench, quiet, tmp_path):
    labels, out = bench.folder / "sealed.json", tmp_path / "score"
    done = run("gap", "score", bench.folder / "cases", "--labels", labels, "--out", out, "--jobs", 1, "--json")
    assert done.code == 0
    assert json.loads(done.out)["done"] == 3
    assert (out / "bench.html").is_file()


def test_labels_that_were_changed_are_refused(bench, quiet, tmp_path):
    sealed = json.loads((bench.folder / "sealed.json").read_text())
    sealed["labels"] = {name: text.replace("one", "null") for name, text in sealed["labels"].items()}
    forged = tmp_path / "forged.json"
    forged.write_text(json.dumps(sealed))
    done = run("gap", "score", bench.folder / "cases", "--labels", forged, "--out", tmp_path / "s", "--jobs", 1)
    assert (done.code, done.out) == (2, "")
    assert "is not the one that was sealed" in done.err


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (("--kinds", "ones"), "did you mean 'one'?"),
        (("--counts", "one=many"), "like one=120,null=40"),
        (("--baselines", "oracel"), "did you mean 'oracle'?"),
        (("--only", "object_mas"), "did you mean 'object_mass'?"),
        (("--noise", "undeclred"), "did you mean 'undeclared'?"),
    ],
)
def test_wrong_words_are_refused_with_the_known_ones(tmp_path, wrong, text):
    done = run("gap", "bench", "--out", tmp_path / "b", *SMALL, *wrong)
    assert (done.code, done.out) == (2, "")
    assert text in done.err
    assert not (tmp_path / "b").exists()


def test_kept_cases_are_the_same_again_and_wait_to_be_diagnosed(quiet, tmp_path):
    command = ("gap", "bench", *SMALL, *FEW, "--keep")
    first = run(*command, tmp_path / "a")
    assert first.code == 0
    assert first.out == f"3 cases are kept in {tmp_path / 'a'}\n"
    assert not (tmp_path / "a" / "results.jsonl").exists()
    kept = (tmp_path / "a" / "sealed.json").read_bytes()
    digests = {path.name: open_dataset(path).digest for path in read_cases(tmp_path / "a" / "cases")}
    assert run(*command, tmp_path / "b", "--out", tmp_path / "score").code == 0
    assert (tmp_path / "b" / "sealed.json").read_bytes() == kept
    assert {path.name: open_dataset(path).digest for path in read_cases(tmp_path / "b" / "cases")} == digests
    again = run("gap", "score", tmp_path / "a", "--out", tmp_path / "again", "--jobs", 1)
    assert again.out.startswith("cube_toss: 3 of 3 cases")
    pair = run("gap", "compare", tmp_path / "score", tmp_path / "again", "--json")
    assert json.loads(pair.out)["cases"] == 3


def test_a_bench_without_a_folder_or_with_one_for_two_things_is_refused(tmp_path):
    for folders, text in (
        ((), "no folder for the cases"),
        (("--out", tmp_path / "x", "--keep", tmp_path / "x"), "are one folder"),
    ):
        done = run("gap", "bench", *SMALL, *folders)
        assert (done.code, done.out) == (2, "")
        assert text in done.err
    done = run("gap", "score", tmp_path, "--out", tmp_path / "s")
    assert "no labels for the cases" in done.err


RANDOM = ("--world", "random-small", "--jobs", 1, "--episodes", 2, "--duration-s", 1.2)


def test_a_random_small_world_makes_cases_scores_them_and_goes_on(quiet, tmp_path):
    command = ("gap", "bench", "--out", tmp_path / "b", *RANDOM, "--kinds", "null", "--counts", "null=2")
    none = run(*command, "--minutes", 0)
    assert none.code == 0
    assert none.out.startswith("2 scenes: 0 of 2 cases")
    assert "making cases: 2 done" in none.err
    whole = run(*command)
    assert "making cases: 0 done" in whole.err
    assert "small scenes, null: no_gap" in whole.out
    assert json.loads(run(*command, "--json").out)["done"] == 2
    labels, out = tmp_path / "b" / "sealed.json", tmp_path / "score"
    assert run("gap", "score", tmp_path / "b" / "cases", "--labels", labels, "--out", out, "--jobs", 1).code == 0
    refused = run("gap", "score", tmp_path / "b", "--out", out, "--fresh", 5, "--jobs", 1)
    assert (refused.code, refused.out) == (2, "")
    assert "no fresh episodes can be recorded" in refused.err
    pair = run("gap", "compare", tmp_path / "b", out)
    lines = pair.out.splitlines()
    assert lines[0].startswith("B is right in as many of 2 cases as A (p = 1), costs ")
    assert [line.split() for line in lines[4:7]] == [
        ["kind", "cases", "both", "right", "only", "A", "only", "B", "p"],
        ["null", "2", "2", "0", "0", "1"],
        ["all", "2", "2", "0", "0", "1"],
    ]
    assert any(line.split()[:7] == ["replays", "a", "case,", "median", "2", "3.0", "3.0"] for line in lines)
    assert json.loads(run("gap", "compare", tmp_path / "b", out, "--json").out)["both_right"] == 2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (("--world", "random-small", "--scene", "cube_toss"), "exclude each other"),
        (("--world", "random-big"), "random-small"),
        (("--traits", "spring"), "add --world random-small"),
        (("--world", "random-small", "--traits", "springy"), "did you mean 'spring'?"),
        (("--world", "random-small", "--kinds", "pair"), "null, one"),
        (("--world", "random-small", "--only", "backlash"), "planted cause"),
        (("--world", "random-small", "--noise", "mixed"), "whether their noise is declared"),
    ],
)
def test_what_a_random_small_world_does_not_take_is_refused(tmp_path, wrong, text):
    done = run("gap", "bench", "--out", tmp_path / "b", "--jobs", 1, *wrong)
    assert (done.code, done.out) == (2, "")
    assert text in done.err
    assert not (tmp_path / "b").exists()


def test_missing_cases_are_refused(tmp_path):
    done = run("gap", "score", tmp_path, "--labels", tmp_path / "sealed.json", "--out", tmp_path / "s")
    assert done.code == 2
    assert "no cases" in done.err


def test_the_help_lists_the_kinds_and_baselines_that_there_are():
    assert gap_commands.BASELINES == BASELINES
    assert tuple(NOISES) == gap_commands.NOISES
    text = run("gap", "bench", "--help").out
    assert all(word in " ".join(text.split()) for word in (*gap_commands.KINDS, "Examples:"))
