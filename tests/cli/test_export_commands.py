"""`export`, and `import` of what it wrote: text, exit codes, what stays behind, and equal episodes."""

from __future__ import annotations

import json
import resource

import numpy as np
import pytest

from candata.datasets import append, create_dataset, get_cloud, open_dataset, put_cloud
from candata.schema.manifest import Lineage
from tests.cli.command import exit_code
from tests.conftest import make_episode

pytest.importorskip("h5py")


@pytest.fixture
def dataset(tmp_path):
    root = create_dataset(tmp_path / "ds", name="ds")
    cloud = put_cloud(root, np.random.default_rng(0).normal(size=(64, 3)))
    episodes = [make_episode(f"é{k}", seed=k, task="pick", point_cloud=cloud) for k in range(3)]
    append(root, episodes, Lineage(operation="made"))
    return root


@pytest.mark.parametrize("way", [["lerobot"], ["lerobot", "--v21"], ["robomimic"], ["diffusion_policy"]])
def test_episodes_and_digest_survive_an_export_and_an_import(way, dataset, tmp_path, capsys):
    out, back = tmp_path / "out", tmp_path / "back"
    assert exit_code("export", way[0], dataset, "--out", out, *way[1:]) == 0
    one = open_dataset(dataset)
    assert capsys.readouterr().out == f"{out}: 3 episodes of ds@{one.digest[:12]}\n"
    assert exit_code("import", way[0], out, "--out", back) == 0
    assert capsys.readouterr().out == f"{back}: 3 episodes added, 3 in version 1\n"
    other = open_dataset(back)
    assert (other.ids, other.digest) == (one.ids, one.digest)
    assert other.lineage[0].operation == f"import {way[0]}"
    cloud = one.episode(one.ids[0]).meta.point_cloud
    assert np.array_equal(get_cloud(back, cloud), get_cloud(dataset, cloud))
    assert exit_code("import", way[0], out, "--out", back, "--append") == 0
    assert capsys.readouterr().out == f"{back}: 0 episodes added, 3 in version 1\n"


def test_a_cloud_that_was_changed_is_refused(dataset, tmp_path, capsys):
    exit_code("export", "lerobot", dataset, "--out", tmp_path / "out")
    path = tmp_path / "out" / "meta" / "candata.json"
    sidecar = json.loads(path.read_text())
    (name,) = sidecar["clouds"]
    for code, words in (
        ("AAAAAAAAAAAAAAAA", f"a cloud that is not {name[:12]}"),
        ("AAAA", "multiple of element size"),
        ("*", ""),
    ):
        path.write_text(json.dumps(sidecar | {"clouds": {name: code}}))
        capsys.readouterr()
        assert exit_code("import", "lerobot", tmp_path / "out", "--out", tmp_path / "back") == 2
        printed = capsys.readouterr().err
        assert printed.startswith("the data are not what was exported")
        assert words in printed
        assert not (tmp_path / "back").exists()


def test_the_sidecar_says_whose_data_it_is(dataset, tmp_path):
    exit_code("export", "lerobot", dataset, "--out", tmp_path / "out")
    sidecar = json.loads((tmp_path / "out" / "meta" / "candata.json").read_text())
    assert sidecar["digest"] == open_dataset(dataset).digest
    assert sidecar["lineage"][0]["operation"] == "made"
    units = {one["key"]: (one["unit"], one["frame"]) for one in sidecar["columns"]}
    assert units["observation.fingertip_force"] == ("N", "fingertip")


def test_wrong_arguments(dataset, tmp_path, capsys):
    out = tmp_path / "out"
    assert exit_code("export", "lerobott", dataset, "--out", out) == 2
    assert "did you mean 'lerobot'" in capsys.readouterr().err
    assert exit_code("export", "robomimic", dataset, "--out", out, "--v21") == 2
    assert "`export robomimic` takes no --v21" in capsys.readouterr().err
    assert exit_code("export", "lerobot", tmp_path / "none", "--out", out) == 2
    out.mkdir()
    assert exit_code("export", "lerobot", dataset, "--out", out) == 2
    assert "the output exists already" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ds", "out"]


def test_a_refused_export_leaves_nothing(dataset, tmp_path, capsys):
    append(dataset, [make_episode("fast", rate_hz=500.0)], Lineage(operation="made"))
    for name in ("lerobot", "robomimic", "diffusion_policy"):
        assert exit_code("export", name, dataset, "--out", tmp_path / "out") == 2
        assert "the episodes differ in rate_hz" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ds"]


def test_a_damaged_export_imports_nothing(dataset, tmp_path, capsys):
    exit_code("export", "lerobot", dataset, "--out", tmp_path / "out")
    path = tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet"
    path.write_bytes(path.read_bytes()[:-40])
    before = path.read_bytes()
    capsys.readouterr()
    assert exit_code("import", "lerobot", tmp_path / "out", "--out", tmp_path / "back") == 2
    error = capsys.readouterr().err
    assert "file-000.parquet cannot be read" in error
    assert "Traceback" not in error
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ds", "out"]
    assert path.read_bytes() == before


def test_a_registered_name_exports_its_clouds_too(dataset, tmp_path, monkeypatch):
    monkeypatch.setenv("CANDATA_REGISTRY", str(tmp_path / "registry.json"))
    assert exit_code("registry", "add", "named", dataset) == 0
    assert exit_code("export", "lerobot", "named", "--out", tmp_path / "out") == 0
    assert json.loads((tmp_path / "out" / "meta" / "candata.json").read_text())["clouds"]


@pytest.mark.parametrize("room", [0, 4096, 30_000])
@pytest.mark.parametrize("format_name", ["lerobot", "robomimic", "diffusion_policy", "mcap"])
def test_a_disk_that_is_full_is_one_error_and_leaves_nothing(format_name, room, dataset, tmp_path, capsys):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        code = exit_code("export", format_name, dataset, "--out", tmp_path / "full" / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    large = (tmp_path / "full" / "out").exists()
    assert code == (0 if large else 3)
    assert large or "File too large" in capsys.readouterr().err
    assert list((tmp_path / "full").iterdir()) == ([tmp_path / "full" / "out"] if large else [])
    assert room or not large
