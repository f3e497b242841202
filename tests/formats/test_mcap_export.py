"""Episodes as MCAP for Foxglove: valid, readable by others, and restored bit for bit."""

from __future__ import annotations

import json

import numpy as np
import pytest

from candata.datasets import content_hash
from candata.errors import DataError
from candata.formats import Writing
from candata.formats._mcap_messages import message
from candata.formats._mcap_scan import Scan
from candata.plugins import load
from candata.schema.episode import Episode, EpisodeMeta
from tests.formats.made_bags import read

FORMAT = load("candata.formats", "FORMAT", "mcap")
CLOUD = np.linspace(0, 1, 30, dtype=np.float32).reshape(10, 3)


def whole_episode(rng, rows: int = 12, name: str = "a/../b") -> Episode:
    """An episode with every channel, gaps, and numbers that JSON has no word for."""
    quaternion = rng.normal(size=(rows, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    pose = np.c_[rng.normal(size=(rows, 3)), quaternion].astype(np.float32)
    valid = np.arange(rows) != 4
    pose[4] = [np.nan, np.inf, -np.inf, -0.0, 0, 0, 0]
    pose[4, 3:4] = np.array([0xFFC00001], np.uint32).view(np.float32)  # a NaN unlike numpy's own
    arrays = {
        "time_ns": -5_000_000 + np.arange(rows) * 12_500_000,
        "object_pose": pose,
        "object_pose_valid": valid,
        "object_velocity": rng.normal(size=(rows, 6)),
        "joint_position": rng.normal(size=(rows, 2)),
        "joint_velocity": rng.normal(size=(rows, 2)),
        "joint_effort": rng.normal(size=(rows, 2)),
        "action": rng.normal(size=(rows, 3)),
        "hand_pose": np.c_[rng.normal(size=(rows, 3)), quaternion],
        "fingertip_force": rng.normal(size=(rows, 2, 3)) * (np.arange(rows) > 1)[:, None, None],
        "fingertip_contact": rng.random((rows, 2)) > 0.5,
        "contact": rng.random(rows) > 0.5,
        "taxels": rng.integers(-300, 300, (rows, 2, 5, 3)).astype(np.int16),
    }
    fields = {"source": "sim", "rate_hz": 80.0, "joint_names": ("j", "k"), "actuator_names": ("x", "y", "z")}
    fields |= {"fingertip_names": ("f", "g"), "newton_per_count": 0.01, "point_cloud": "c" * 64, "seed": 2**70}
    return Episode(EpisodeMeta.model_validate({"id": name, **fields, "invalid_counts": {"object_pose": 1}}), arrays)


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "out"
    made.mkdir()
    return made


def write(folder, *episodes, note=lambda line: None):
    FORMAT.write(iter(episodes), folder, Writing("ds", "d" * 64, note=note, cloud=lambda sha: CLOUD))


def test_an_episode_is_restored_bit_for_bit_with_its_cloud(folder, rng):
    episodes = [whole_episode(rng), whole_episode(rng, 6, "..")]
    write(folder, *episodes)
    clouds: list[np.ndarray] = []
    again = read(folder, cloud=clouds.append)
    assert [content_hash(one) for one in again] == [content_hash(one) for one in episodes]
    assert [one.meta for one in again] == [one.meta for one in episodes]
    assert (again[0]["object_pose"].view(np.uint32) == episodes[0]["object_pose"].view(np.uint32)).all()
    assert len(clouds) == 2
    assert (clouds[0] == CLOUD).all()


def test_an_episode_of_few_channels_is_restored_too(folder, episode):
    made = episode("run", contact=False)
    write(folder, made)
    assert content_hash(read(folder)[0]) == content_hash(made)


def test_ids_never_leave_the_folder(folder, rng):
    names = ["..", "/etc/x", "a" * 500, "a:b*c?", "ü"]
    write(folder, *(whole_episode(rng, 6, name) for name in names))
    files = sorted(path.name for path in folder.iterdir())
    assert len(files) == 5
    assert all(name[:6] == f"{k:06d}" and name.isascii() and len(name) < 120 for k, name in enumerate(files))
    assert [one.meta.id for one in read(folder)] == names


def test_the_mcap_library_s_strict_reader_decodes_every_message(folder, rng):
    from mcap.reader import make_reader
    from mcap.stream_reader import StreamReader

    write(folder, whole_episode(rng))
    (path,) = folder.iterdir()
    with path.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 0
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, item in reader.iter_messages():
            if channel.message_encoding == "json":
                value = json.loads(item.data)
                assert set(json.loads(schema.data)["properties"]) == set(value)
            else:
                value = message(schema.name).FromString(item.data)
                assert value.ByteSize() == len(item.data)
            found.setdefault(channel.topic, []).append(value)
    counts = {topic: len(values) for topic, values in found.items()}
    assert counts == {
        "/tf": 12,
        "/joint_states": 12,
        "/joint_targets": 12,
        "/fingertip_forces": 12,
        "/candata/taxels": 12,
        "/object/points": 1,
        "/candata/row": 12,
    }
    assert [item.child_frame_id for item in found["/tf"][4].transforms] == ["hand"]
    assert len(found["/object/points"][0].data) == CLOUD.nbytes


def test_arrows_point_along_the_force(folder, rng):
    episode = whole_episode(rng)
    write(folder, episode)
    from mcap.reader import make_reader
    from scipy.spatial.transform import Rotation

    (path,) = folder.iterdir()
    with path.open("rb") as file:
        items = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/fingertip_forces"])]
    for force, data in zip(episode["fingertip_force"], items, strict=True):
        for newton, entity in zip(force, message("foxglove.SceneUpdate").FromString(data).entities, strict=True):
            assert len(entity.arrows) == int(np.linalg.norm(newton) > 0)
            for arrow in entity.arrows:
                turn = arrow.pose.orientation
                along = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([1.0, 0, 0])
                length = arrow.shaft_length + arrow.head_length
                assert along * length == pytest.approx(0.02 * newton, abs=1e-7)  # float32 forces


def test_others_topics_of_an_export_read_as_any_recording_s(folder, rng, episode):
    made = episode("run", rows=30)
    write(folder, made)
    channels = {
        "object_pose": {"topic": "/tf", "child": "object"},
        "joint_position": {"topic": "/joint_states"},
        "fingertip_force": {"topic": "/candata/row", "fields": ["fingertip_force"], "clock": "log"},
    }
    (again,) = read(folder, {"rate_hz": 80, "channels": channels})
    assert (again["joint_position"] == made["joint_position"]).all()
    assert (again["fingertip_force"] == made["fingertip_force"]).all()
    assert again["object_pose"] == pytest.approx(made["object_pose"], abs=1e-6)  # quaternions are made unit again


def rewrite(path, change):
    """Write a file again, each message as `change(channel, message)` gives it and each metadata record too."""
    from mcap.records import Channel, Message, Metadata, Schema
    from mcap.writer import Writer

    items = list(Scan(path))
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for item in items:
            if isinstance(item, Metadata):
                writer.add_metadata(item.name, {key: change(item.name, text) for key, text in item.metadata.items()})
        schemas, channels = {}, {}
        for item in items:
            if isinstance(item, Schema):
                schemas[item.id] = writer.register_schema(item.name, item.encoding, item.data)
            elif isinstance(item, Channel):
                schema = schemas[item.schema_id]
                channels[item.id] = item.topic, writer.register_channel(item.topic, item.message_encoding, schema)
            elif isinstance(item, Message):
                topic, number = channels[item.channel_id]
                writer.add_message(number, item.log_time, change(topic, item.data), item.log_time, item.sequence)
        writer.finish()


def test_a_rewritten_export_is_still_one(folder, episode):
    made = episode("run")
    write(folder, made)
    (path,) = folder.iterdir()
    rewrite(path, lambda where, said: said)
    assert content_hash(read(folder)[0]) == content_hash(made)


@pytest.mark.parametrize(
    "change",
    [
        lambda where, said: said.replace(b"false", b"true") if where == "/candata/row" else said,
        lambda where, said: said.replace("80.0", "81.0") if where == "candata.episode" else said,
        lambda where, said: said.replace("contact", "kontakt") if where == "candata.episode" else said,
        lambda where, said: said[:-1] if where == "/candata/row" else said,
        lambda where, said: "2" if said == "1" else said,
    ],
)
def test_a_changed_export_is_refused(folder, episode, change):
    write(folder, episode("run"))
    (path,) = folder.iterdir()
    rewrite(path, change)
    with pytest.raises(DataError, match="cannot be restored"):
        read(folder)


@pytest.mark.parametrize("lost", [40, 100, 2000])
def test_a_cut_export_is_refused(folder, episode, lost):
    write(folder, episode("run"))
    (path,) = folder.iterdir()
    path.write_bytes(path.read_bytes()[:-lost])
    for allow_gaps in (False, True):
        with pytest.raises(DataError, match="cannot be restored"):
            read(folder, allow_gaps=allow_gaps)


def test_what_the_file_cannot_place_is_said(folder, episode):
    notes: list[str] = []
    write(folder, episode("run"), note=notes.append)
    assert len(notes) == 1
    assert "fingertip/NAME" in notes[0]
