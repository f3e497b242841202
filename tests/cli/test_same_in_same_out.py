"""`diagnose` and `gap bench` say the same, bit for bit, whatever machine and settings they run under."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import pytest

from tests.cli.command import run

pytestmark = pytest.mark.hard

ROOT = Path(__file__).parents[2]
SCENE = ("--scene", "gripper_tabletop")
#: The fewest recordings that are diagnosed, short ones, of a world whose object is heavier.
RECORDED = ("--episodes", 8, "--duration-s", 0.8, "--jobs", 1)
HEAVIER = """scene: gripper_tabletop
effects:
  - {name: object_mass, parameters: {mass_scale: 1.5}}
"""
#: A scalar, one that is simulated for each joint, a vector that sensors read at the start, and a choice.
ONLY = ("--only", "object_mass,joint_damping,pose_bias,friction_cone")
BENCH = (
    *("--scene", "cube_toss", "--episodes", 8, "--duration-s", 0.5, "--kinds", "one,null"),
    *("--counts", "one=2,null=1", "--only", "sliding_friction,pose_bias", "--no-follow"),
)
#: Python reads this first: folders are listed backwards, and numbers are written as the locale writes them.
BACKWARDS = """
import contextlib, locale, os

scan, listed = os.scandir, os.listdir


class Backwards:
    def __init__(self, path):
        with scan(path) as entries:
            self.entries = iter(sorted(entries, key=lambda entry: entry.name, reverse=True))

    def __iter__(self):
        return self.entries

    def __next__(self):
        return next(self.entries)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def close(self):
        pass


os.scandir = lambda path=".": Backwards(path)
os.listdir = lambda path=".": sorted(listed(path), reverse=True)
with contextlib.suppress(locale.Error):
    locale.setlocale(locale.LC_ALL, "")
"""


class Around(NamedTuple):
    """What a command runs in: its threads or processes, variables, and whether in a folder listed backwards."""

    jobs: int = 1
    variables: Mapping[str, str] = MappingProxyType({})
    backwards: bool = False


PLAIN = Around()
ALL = {
    "two jobs": Around(jobs=2),
    "a hash seed": Around(variables={"PYTHONHASHSEED": "0"}),
    "another hash seed": Around(variables={"PYTHONHASHSEED": "1"}),
    "no UTF-8": Around(variables={"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    "decimal commas": Around(variables={"LC_ALL": "de_DE.UTF-8"}, backwards=True),
    "a dotless i": Around(variables={"LC_ALL": "tr_TR.UTF-8"}, backwards=True),
    "a time zone": Around(variables={"TZ": "Pacific/Kiritimati"}),
    "one thread of the libraries": Around(variables={"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}),
    "two threads of the libraries": Around(variables={"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}),
    "a narrow terminal": Around(variables={"COLUMNS": "40", "NO_COLOR": "1"}),
}
#: All of it at once, twice over.
TOGETHER = {
    "one way": Around(variables={**ALL["no UTF-8"].variables, **ALL["a hash seed"].variables, "OMP_NUM_THREADS": "1"}),
    "other way": Around(2, {"PYTHONHASHSEED": "1", "LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Tokyo"}, backwards=True),
}


def said(words: tuple[object, ...], around: Around, folder: Path) -> str:
    """What a command prints that runs in `folder`."""
    (folder / "python").mkdir(parents=True, exist_ok=True)
    if around.backwards:
        (folder / "python" / "sitecustomize.py").write_text(BACKWARDS)
    path = os.pathsep.join([str(folder / "python"), str(ROOT), *sys.path])
    env = {**os.environ, "PYTHONPATH": path, **around.variables}
    command = [sys.executable, "-m", "candata_cli.main", *map(str, words), "--jobs", str(around.jobs)]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """Recordings of a heavier object, and others of the same commands and of other ones."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "heavier.yaml").write_text(HEAVIER)
    world = ("--effects", folder / "heavier.yaml")
    for name, more in {"real": (*world, "--seed", 5), "same": ("--seed", 5), "other": (*world, "--seed", 6)}.items():
        assert run("generate-sim", *SCENE, *RECORDED, *more, "--out", folder / name).code == 0
    return folder


def diagnosed(recorded: Path, around: Around, folder: Path, *cache: object, name: str = "real") -> dict[str, bytes]:
    """The files of a diagnosis and what it prints; its folder has another name each time."""
    words = ("diagnose", os.path.relpath(recorded / name, folder), *SCENE, *ONLY, *(cache or ("--no-cache",)))
    printed = said((*words, "--json", "--out", f"out {folder.name}"), around, folder)
    return files(folder / f"out {folder.name}") | {"printed": printed.encode()}


@pytest.fixture(scope="module")
def plain(recorded, tmp_path_factory) -> dict[str, bytes]:
    return diagnosed(recorded, PLAIN, tmp_path_factory.mktemp("plain"))


@pytest.mark.parametrize("around", TOGETHER)
def test_a_diagnosis_is_the_same_in_other_surroundings(recorded, plain, tmp_path, around):
    assert {"report.json", "report.html", "effects.yaml", "printed"} <= set(plain)
    assert json.loads(plain["printed"])["verdict"] == "explained"
    assert diagnosed(recorded, TOGETHER[around], tmp_path) == plain


@pytest.mark.slow
@pytest.mark.parametrize("around", ALL)
def test_a_diagnosis_is_the_same_with_one_thing_changed(recorded, plain, tmp_path, around):
    assert diagnosed(recorded, ALL[around], tmp_path) == plain


def test_a_diagnosis_is_the_same_without_a_cache_with_one_and_from_one(recorded, plain, tmp_path):
    cache = ("--cache-dir", tmp_path / "cache")
    assert diagnosed(recorded, PLAIN, tmp_path / "first", *cache) == plain
    kept = files(tmp_path / "cache")
    assert len(kept) > 8
    assert diagnosed(recorded, PLAIN, tmp_path / "again", *cache) == plain
    assert files(tmp_path / "cache") == kept


@pytest.mark.slow
@pytest.mark.parametrize("other", ["same", "other"])
def test_a_diagnosis_is_the_same_beside_what_was_kept_of_other_recordings(recorded, plain, tmp_path, other):
    cache = ("--cache-dir", tmp_path / "cache")
    diagnosed(recorded, PLAIN, tmp_path / other, *cache, name=other)
    assert diagnosed(recorded, PLAIN, tmp_path / "real", *cache) == plain


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def scored(folder: Path) -> dict[str, object]:
    """What a bench found: all but CPU times and the numbers of processes, which are fields of their own."""
    results = {line["case"]: line for line in lines(folder / "results.jsonl")}
    shares = {line["case"]: line for line in lines(folder / "shares.jsonl")}
    for line in results.values():
        assert line.pop("cpu_s") > 0
        del line["process"], line["replays"]  # two workers may make one signature twice
    score = json.loads((folder / "bench.json").read_text())
    score["rows"] = [row for row in score["rows"] if row["unit"] != "s"]
    digests = {
        path.parent.parent.name: json.loads(path.read_text())["digest"]
        for path in (folder / "cases").glob("*/versions/000001.json")
    }
    return {"results": results, "shares": shares, "score": score, "recordings": digests}


@pytest.mark.slow
def test_a_bench_is_the_same_in_other_surroundings(tmp_path):
    """What is hidden is drawn from a secret: the other runs are given the first one's, and nothing else."""
    said(("gap", "bench", *BENCH, "--out", "out"), PLAIN, tmp_path / "plain")
    first = scored(tmp_path / "plain" / "out")
    assert len(first["results"]) == len(first["recordings"]) == 3
    for name, around in TOGETHER.items():
        (tmp_path / name / "out").mkdir(parents=True)
        shutil.copy(tmp_path / "plain" / "out" / "sealed.json", tmp_path / name / "out")
        said(("gap", "bench", *BENCH, "--out", "out"), around, tmp_path / name)
        assert scored(tmp_path / name / "out") == first
