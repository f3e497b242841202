"""`import` and `fetch`: what they print, what they leave, and their exit codes."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml

from candata.datasets import create_dataset, open_dataset
from candata.datasets.filtering import filter_dataset
from candata_cli import import_commands
from tests.cli.command import exit_code

POSE = ["px", "py", "pz", "qw", "qx", "qy", "qz"]


@pytest.fixture
def source(tmp_path):
    """A map with a table of `count` episodes of three rows, changed by `edit`."""

    def written(count: int = 2, edit=lambda columns: None, **changed):
        folder = tmp_path / "source"
        folder.mkdir(exist_ok=True)
        rows = 3 * count
        columns = {"episode": np.repeat(np.arange(count), 3), "t": np.tile([0.0, 0.01, 0.02], count)}
        columns |= {name: np.full(rows, float(name == "qw")) for name in POSE}
        edit(columns)
        pa.parquet.write_table(pa.table(columns), folder / "run.parquet")
        mapping = {"file": "run.parquet", "episode": "episode", "time_s": "t", "rate_hz": 100}
        path = folder / "map.yaml"
        path.write_text(yaml.safe_dump(mapping | {"channels": {"object_pose": POSE}} | changed))
        return path

    return written


@pytest.fixture
def out(tmp_path):
    return tmp_path / "made" / "ds"


def test_an_import_makes_one_version(source, out, capsys):
    assert exit_code("import", "table", source(), "--out", out) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{out}: 2 episodes added, 2 in version 1\n"
    dataset = open_dataset(out)
    assert dataset.ids == ("run-0", "run-1")
    assert dataset.name == "ds"
    (lineage,) = dataset.lineage
    assert lineage.operation == "import table"
    assert len(lineage.config_digest) == 64
    assert lineage.details == {"source": "map.yaml", "allow_gaps": False}
    assert [path.name for path in out.parent.iterdir()] == ["ds"]


def test_an_output_that_stands_is_refused(source, out, capsys):
    exit_code("import", "table", source(), "--out", out)
    capsys.readouterr()
    assert exit_code("import", "table", source(3), "--out", out) == 2
    assert capsys.readouterr().err == (
        f"the output exists already\n  where: {out}\n  do: choose another --out, or add to it with --append\n"
    )
    assert len(open_dataset(out)) == 2


def test_the_same_source_twice_adds_nothing(source, out, capsys):
    exit_code("import", "table", source(), "--out", out)
    digest = open_dataset(out).digest
    capsys.readouterr()
    assert exit_code("import", "table", source(), "--out", out, "--append") == 0
    assert capsys.readouterr().out == f"{out}: 0 episodes added, 2 in version 1\n"
    assert open_dataset(out).digest == digest
    assert exit_code("import", "table", source(3), "--out", out, "--append") == 0
    assert capsys.readouterr().out == f"{out}: 1 episodes added, 3 in version 2\n"


def test_the_lineage_names_what_was_taken(source, out, tmp_path):
    def digest(path, out):
        assert exit_code("import", "table", path, "--out", out) == 0
        return open_dataset(out).lineage[0].config_digest

    first = digest(source(), out)
    path = source()
    path.write_text("# the same\n" + path.read_text())
    assert digest(path, tmp_path / "again") == first
    assert digest(source(3), tmp_path / "other") != first


def test_what_a_version_leaves_out_is_not_counted(source, out, tmp_path, capsys):
    pytest.importorskip("duckdb")
    exit_code("import", "table", source(), "--out", out)
    filter_dataset(open_dataset(out), "id = 'run-0'", tmp_path / "some")
    capsys.readouterr()
    assert exit_code("import", "table", source(3), "--out", tmp_path / "some", "--append") == 0
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path / 'some'}: 1 episodes added, 2 in version 2\n"
    assert printed.err.startswith("1 episodes stay left out, as in the version before: run-1; to bring them back")
    assert open_dataset(tmp_path / "some").ids == ("run-0", "run-2")


def test_what_the_note_says_brings_a_left_out_episode_back(source, out, tmp_path, capsys):
    pytest.importorskip("duckdb")
    exit_code("import", "table", source(), "--out", out)
    some, new = tmp_path / "some", tmp_path / "new"
    filter_dataset(open_dataset(out), "id = 'run-0'", some)
    exit_code("import", "table", source(), "--out", some, "--append")
    command = capsys.readouterr().err.partition("candata ")[2].replace("NEW", str(new)).split()
    assert exit_code("import", "table", source(), "--out", new) == 0
    assert exit_code(*command) == 0
    assert open_dataset(some).ids == ("run-0", "run-1")


def test_a_table_without_its_map_asks_for_one(source, out, capsys):
    table = source().parent / "run.parquet"
    assert exit_code("import", "table", table, "--out", out) == 2
    told = capsys.readouterr().err
    assert told.startswith("a table is imported by a map, which says what each column is\n  expected: a map.yaml")
    assert "file: run.parquet" in told
    assert "candata import table map.yaml --out recordings" in told
    assert exit_code("import", "table", table.parent, "--out", out) == 2
    assert capsys.readouterr().err.startswith("a table is imported by a map")


def test_appending_to_nothing_makes_it(source, out):
    assert exit_code("import", "table", source(), "--out", out, "--append") == 0
    assert len(open_dataset(out)) == 2


def spoil(column, value):
    def edit(columns):
        columns[column][-1] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "changed", "problem"),
    [
        (spoil("px", np.nan), {}, "object_pose is not finite"),
        (spoil("qw", 0.5), {}, "object_pose holds a quaternion that is not unit"),
        (spoil("t", 0.005), {}, "time does not increase"),
        (lambda columns: columns.pop("px"), {}, "the table has no column px"),
        (lambda columns: columns.update({k: v[:0] for k, v in columns.items()}), {}, "the table is empty"),
        (
            lambda columns: None,
            {"channels": {"joint_position": ["px", "py"], "joint_velocity": ["pz"]}},
            "joint_velocity has the wrong count of joints",
        ),
        (lambda columns: None, {"units": {"object_pose": "inch"}}, "unknown unit 'inch'"),
        (lambda columns: None, {"channels": {"pose": POSE}}, "unknown channel 'pose'"),
        (lambda columns: None, {"file": "absent.parquet"}, "the table does not exist"),
        (lambda columns: None, {"rate_hz": -1}, "map.yaml is not valid: rate_hz: "),
    ],
)
@pytest.mark.parametrize("standing", [False, True])
def test_bad_input_is_one_message_exit_2_and_nothing_written(source, out, capsys, edit, changed, problem, standing):
    if standing:
        exit_code("import", "table", source(), "--out", out)
        before = open_dataset(out).file
        capsys.readouterr()
    path = source(40, edit, **changed)  # more than two parts: the last row is wrong
    assert exit_code("import", "table", path, "--out", out, "--append") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(problem)
    assert "Traceback" not in printed.err
    if standing:
        assert open_dataset(out).file == before
    else:
        assert not out.parent.exists() or list(out.parent.iterdir()) == []


def test_gaps_are_taken_when_asked(source, out, capsys):
    assert exit_code("import", "table", source(2, spoil("px", np.nan)), "--out", out, "--allow-gaps") == 0
    episode = open_dataset(out).episode("run-1")
    assert episode.meta.invalid_counts == {"object_pose": 1}
    assert episode.valid("object_pose").tolist() == [True, True, False]
    assert np.isnan(episode["object_pose"][2, 0])


def test_other_content_under_a_known_id_is_refused(source, out, capsys):
    exit_code("import", "table", source(), "--out", out)
    assert exit_code("import", "table", source(2, spoil("px", 1.0)), "--out", out, "--append") == 2
    assert len(open_dataset(out).lineage) == 1


def test_unknown_formats_and_sources_list_the_known(source, out, capsys):
    assert exit_code("import", "tabel", source(), "--out", out) == 2
    assert capsys.readouterr().err.startswith("unknown format 'tabel'\n  expected: one of ")
    assert exit_code("fetch", "cube-toss", "--out", out) == 2
    assert capsys.readouterr().err.endswith("did you mean 'cube_tosses'?\n")


def test_a_fetch_from_a_wrong_folder(tmp_path, out, capsys):
    assert exit_code("fetch", "cube-tosses", "--from", tmp_path, "--out", out) == 2
    assert "LICENSE.txt is missing" in capsys.readouterr().err
    assert not out.exists()


def test_a_fetch_without_network(out, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")  # the discard port: refused at once
    assert exit_code("fetch", "cube-tosses", "--cache", tmp_path / "cache", "--out", out) == 3
    assert "the download failed\n" in capsys.readouterr().err
    assert not out.exists()


def test_the_cube_tosses(shared, out, capsys):
    folder = shared / "realdata" / "cube_tosses"
    assert exit_code("fetch", "cube-tosses", "--from", folder, "--out", out) == 0
    assert capsys.readouterr().out == f"{out}: 550 episodes added, 550 in version 1\n"
    dataset = open_dataset(out)
    assert dataset.lineage[0].details["licence_text"].startswith("BSD 3-Clause License")
    assert exit_code("fetch", "cube_tosses", "--from", folder, "--out", out, "--append") == 0
    assert open_dataset(out).version == 1


def test_a_dataset_made_meanwhile_is_not_added_to(source, out, capsys, monkeypatch):
    def late(path, *_, **__):
        create_dataset(path)  # another import, after the check and before the end of ours

    monkeypatch.setattr(import_commands, "check_output", late)
    assert exit_code("import", "table", source(), "--out", out) == 2
    assert "the output exists already" in capsys.readouterr().err
    assert not (out / "versions").exists()
