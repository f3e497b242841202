"""robomimic files of others: names, maps, rates, ragged demonstrations, damage."""

from __future__ import annotations

import builtins
import json

import numpy as np
import pytest
import yaml

from candata.errors import DataError, MissingExtraError, UnknownNameError, UsageError
from candata.formats import Reading, Writing
from candata.formats.robomimic import FORMAT
from tests.conftest import make_episode

h5py = pytest.importorskip("h5py")


def read(path, **told):
    return list(FORMAT.read(path, Reading(**told)))


def write_others(path, edit=lambda file: None):
    """Write a file as robosuite's scripts do, three demonstrations of five rows, changed by `edit`."""
    rng = np.random.default_rng(5)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = 15
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20}})
        for k in (10, 0, 2):
            demo = data.create_group(f"demo_{k}")
            demo.attrs["num_samples"] = 5
            demo.attrs["model_file"] = "<mujoco/>"
            demo["obs/robot0_joint_pos"] = rng.normal(size=(5, 7))
            demo["obs/robot0_joint_vel"] = rng.normal(size=(5, 7))
            demo["obs/object"] = np.tile([0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8], (5, 1))
            demo["obs/camera"] = np.zeros((5, 4, 4, 3), np.uint8)
            demo["actions"] = np.full((5, 4), float(k))
            demo["rewards"], demo["dones"], demo["states"] = np.zeros(5), np.zeros(5, int), np.zeros((5, 9))
        file["mask/train"] = np.array([b"demo_0", b"demo_2"])
        edit(file)
    return path


@pytest.fixture
def others(tmp_path):
    return lambda edit=lambda file: None: write_others(tmp_path / "lift.hdf5", edit)


def test_names_of_robosuite_are_known(others):
    notes = []
    episodes = read(others(), note=notes.append, source="sim")
    assert [e.meta.id for e in episodes] == ["lift-demo_0", "lift-demo_2", "lift-demo_10"]
    assert [e["action"][0, 0] for e in episodes] == [0, 2, 10]
    assert episodes[0]["joint_position"].shape == episodes[0]["joint_velocity"].shape == (5, 7)
    assert episodes[0]["time_ns"].tolist() == [0, 50_000_000, 100_000_000, 150_000_000, 200_000_000]
    assert episodes[0].meta.rate_hz == 20
    assert "left out: dones, obs/camera, obs/object, rewards, states" in notes
    assert "joint_position from obs/robot0_joint_pos" in notes[1]


def test_a_map_says_more(others, tmp_path):
    path = tmp_path / "features.yaml"
    channels = {"joint_position": "obs/robot0_joint_pos", "object_pose": "obs/object", "action": "actions[1:4]"}
    path.write_text(yaml.safe_dump({"channels": channels, "quaternion": "xyzw", "rate_hz": 10, "object": "cube"}))
    first = read(others(), mapping=path)[0]
    assert first["object_pose"][0] == pytest.approx([0.1, 0.2, 0.3, 0.8, 0.0, 0.6, 0.0])
    assert first["action"].shape == (5, 3)
    assert (first.meta.rate_hz, first.meta.object) == (10, "cube")
    path.write_text(yaml.safe_dump({"channels": {"joint_position": "obs/robot0_joint_poz"}}))
    with pytest.raises(UnknownNameError, match="did you mean 'obs/robot0_joint_pos'"):
        read(others(), mapping=path)


def cut(key, rows=3):
    """Shortens a dataset of a demonstration."""

    def edit(file):
        values = file["data/demo_2"][key][:rows]
        del file["data/demo_2"][key]
        file["data/demo_2"][key] = values

    return edit


def narrow(file):
    del file["data/demo_2/actions"]
    file["data/demo_2/actions"] = np.zeros((5, 2))


def forget_rate(file):
    del file["data"].attrs["env_args"]


def forget_demos(file):
    for name in list(file["data"]):
        del file["data"][name]


def gap(file):
    file["data/demo_2/actions"][1, 2] = np.nan


def forget_names(file):
    for name in file["data"]:
        file["data"][name].move("obs/robot0_joint_pos", "obs/q")


@pytest.mark.parametrize(
    ("edit", "error", "texts"),
    [
        (cut("obs/robot0_joint_pos"), DataError, ["differ in length", "obs/robot0_joint_pos: 3", "demo_2"]),
        (cut("actions", 4), DataError, ["differ in length", "actions: 4", "expected: 5 rows, as num_samples has"]),
        (cut("actions", 0), DataError, ["the demonstration is empty"]),
        (narrow, DataError, ["actions has other columns than in the first demonstration"]),
        (lambda file: file["data/demo_2"].pop("actions"), DataError, ["lacks actions", "demo_2"]),
        (lambda file: file.pop("data"), DataError, ["cannot be read"]),
        (forget_demos, DataError, ["holds no demonstration"]),
        (forget_rate, UsageError, ["does not say its rate", "rate_hz: 20"]),
        (forget_names, UsageError, ["--map FILE"]),
        (gap, DataError, ["action is not finite", "--allow-gaps"]),
    ],
)
def test_what_is_wrong_is_said(others, edit, error, texts):
    with pytest.raises(error) as caught:
        read(others(edit))
    assert all(text in str(caught.value) for text in texts)


def test_a_dataset_larger_than_its_file_is_refused(others):
    def edit(file):
        del file["data/demo_2"]["actions"]
        demo = file["data/demo_2"]
        del demo.attrs["num_samples"]
        demo.create_dataset("actions", shape=(5, 10**9), chunks=(1, 1000), dtype="f8")

    with pytest.raises(DataError, match="claims more than the file can hold"):
        read(others(edit))


@pytest.mark.parametrize("how", ["link", "demo", "virtual", "external"])
def test_values_of_other_files_are_refused(others, tmp_path, how):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.ones((5, 7))
        file["demo/obs/robot0_joint_pos"] = np.ones((5, 7))
    (tmp_path / "raw").write_bytes(bytes(5 * 7 * 8))

    def edit(file):
        name = "data/demo_2/obs/robot0_joint_pos"
        del file["data/demo_2" if how == "demo" else name]
        if how == "link":
            file[name] = h5py.ExternalLink("../secret.h5", "/x")
        elif how == "demo":
            file["data/demo_2"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/demo")
        elif how == "virtual":
            layout = h5py.VirtualLayout((5, 7), "f8")
            layout[:] = h5py.VirtualSource(tmp_path / "secret.h5", "x", (5, 7))
            file.create_virtual_dataset(name, layout)
        else:
            file.create_dataset(name, (5, 7), "f8", external=[(str(tmp_path / "raw"), 0, h5py.h5f.UNLIMITED)])

    (tmp_path / "in").mkdir()
    path = write_others(tmp_path / "in" / "lift.hdf5", edit)
    with pytest.raises(DataError, match="the file takes values from other files"):
        read(path)


def test_a_demonstration_that_leads_nowhere_is_refused(others):
    def edit(file):
        del file["data/demo_0"]
        file["data/demo_0"] = h5py.SoftLink("/nothing")

    with pytest.raises(DataError, match="the HDF5 file cannot be read"):
        read(others(edit))


def test_a_picture_is_no_channel(others):
    def edit(file):
        del file["data/demo_0/obs/robot0_joint_pos"]
        file["data/demo_0/obs/robot0_joint_pos"] = np.zeros((5, 100, 101), np.uint8)

    with pytest.raises(UsageError, match="too wide for a channel"):
        read(others(edit))


def test_no_file_no_hdf5_and_two_files(tmp_path, others):
    with pytest.raises(DataError, match="no such file"):
        read(tmp_path / "none.hdf5")
    (tmp_path / "text.hdf5").write_text("no hdf5")
    with pytest.raises(DataError, match="cannot be read"):
        read(tmp_path / "text.hdf5")
    others()
    with pytest.raises(DataError, match=r"lift\.hdf5, text\.hdf5"):
        read(tmp_path)


def test_an_export_has_what_robomimic_reads(tmp_path):
    notes = []
    episodes = [make_episode("a"), make_episode("b", seed=1, source="real", rows=7)]
    FORMAT.write(episodes, tmp_path, Writing("set", "d" * 64, note=notes.append))
    with h5py.File(tmp_path / "dataset.hdf5") as file:
        assert file["data"].attrs["total"] == 27
        assert json.loads(file["data"].attrs["env_args"])["env_kwargs"] == {"control_freq": 80.0}
        demo = file["data/demo_1"]
        assert demo.attrs["num_samples"] == 7
        assert np.array_equal(demo["obs/joint_position"], episodes[1]["joint_position"])
        assert demo["dones"][:].tolist() == [0] * 6 + [1]
        assert file["mask/sim"][:].tolist() == [b"demo_0"]
        assert file["mask/real"][:].tolist() == [b"demo_1"]
    assert "the episodes have no action, and so the file has no `actions`" in notes
    assert "left out: states, model_file and next_obs; train with hdf5_load_next_obs: false" in notes


def test_without_h5py_the_extra_is_named(tmp_path, others, monkeypatch):
    path = others()
    real = builtins.__import__

    def without(name, *rest, **more):
        if name == "h5py":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"candata\[formats\]"):
        read(path)
    with pytest.raises(MissingExtraError, match=r"candata\[formats\]"):
        FORMAT.write([make_episode("a")], tmp_path, Writing("set", "d" * 64))


@pytest.mark.parametrize(
    ("data", "found"), [(b"", "no bytes"), (b"PAR1", "a file of another kind, which begins b'PAR1'")]
)
def test_a_file_of_another_kind_says_what_it_is(tmp_path, data, found):
    (tmp_path / "d.hdf5").write_bytes(data)
    with pytest.raises(DataError, match="the HDF5 file cannot be read") as caught:
        read(tmp_path / "d.hdf5")
    assert caught.value.found == found
