"""The command file: what is written comes back, another rate is put on the beat, a bad file is one clear error."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candata.errors import DataError, UsageError
from candata.policies import Motion, command_limits, motion_plan, read_motions, write_motions
from candata.scenes import load_scene

ARM = """<mujoco><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 0 1" limited="true" range="-57 57"/><geom size=".1"/>
    <body name="lower" pos=".3 0 0"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1"/></body></body>
  </worldbody><actuator>
    <position name="shoulder" joint="shoulder" kp="30" ctrllimited="true" ctrlrange="-2 2"/>
    <motor name="rail" joint="rail" ctrllimited="true" ctrlrange="-5 5"/>
  </actuator></mujoco>"""
ROLES = "model: arm.xml\nrate_hz: 100\njoints: [shoulder, rail]\nactuators: [shoulder, rail]\n"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A position servo on a limited hinge, a motor on a rail; 100 Hz."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(ARM)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


def waves(rows: int = 50, size: float = 0.5) -> np.ndarray:
    t = np.arange(rows) / 100
    return np.stack([size * np.sin(6 * t), 4 * size * np.cos(6 * t)], axis=1)


def save(path, **columns):
    """Write a table as somebody else would: plain columns, no metadata."""
    pq.write_table(pa.table(columns), path)
    return path


@pytest.fixture
def columns():
    """Columns of a good file at the scene's rate."""
    values = waves()
    return {"time_s": np.arange(50) / 100, "shoulder": values[:, 0], "rail": values[:, 1]}


def test_what_is_written_comes_back(scene, tmp_path):
    motions = [Motion("slow", waves(), np.zeros(3)), Motion("far", waves(30, 0.9), np.array([0.2, 0, 0]))]
    found = read_motions(write_motions(tmp_path / "motion.parquet", scene, motions), scene)
    assert found.scene_digest == scene.digest
    for before, after in zip(motions, found.motions, strict=True):
        assert after.name == before.name
        assert np.array_equal(after.commands, before.commands)
        assert np.array_equal(after.object_shift_m, before.object_shift_m)


def test_columns_say_their_unit(scene, tmp_path):
    path = write_motions(tmp_path / "motion.parquet", scene, [Motion("slow", waves(), np.zeros(3))])
    units = {f.name: (f.metadata or {}).get(b"unit") for f in pq.read_schema(path)}
    assert units == {"time_s": b"s", "shoulder": b"rad", "rail": b"N"}


def test_a_plain_table_in_any_order_of_columns_is_played(scene, tmp_path, columns):
    path = save(
        tmp_path / "wave.parquet",
        rail=columns["rail"],
        note=["x"] * 50,
        **{k: columns[k] for k in ("shoulder", "time_s")},
    )
    (motion,) = read_motions(path, scene).motions
    assert motion.name == "wave"
    assert np.array_equal(motion.commands, waves())


def test_the_digest_is_of_the_commands_not_of_the_bytes(scene, tmp_path, columns):
    first = read_motions(save(tmp_path / "a.parquet", **columns), scene).digest
    (tmp_path / "b").mkdir()
    again = tmp_path / "b" / "a.parquet"
    pq.write_table(pa.table(columns), again, compression="gzip")
    assert read_motions(again, scene).digest == first
    columns["rail"][3] += 1e-3
    assert read_motions(save(again, **columns), scene).digest != first


def test_a_file_of_half_the_rate_holds_each_command_twice(scene, tmp_path, columns):
    half = {k: v[::2] for k, v in columns.items()}
    (motion,) = read_motions(save(tmp_path / "half.parquet", **half), scene).motions
    held = np.repeat(waves()[::2], 2, axis=0)[:-1]
    assert np.array_equal(motion.commands, held)


def test_a_motion_is_played_as_it_is_from_its_first_command(scene, rng):
    plan = motion_plan(scene, Motion("slow", waves(), np.zeros(3)), rng)
    assert np.array_equal(plan.commands, waves())
    # The rail has a motor: its command is a force, not a place.
    assert np.array_equal(plan.qpos, [waves()[0, 0], 0.0])


def test_a_servo_is_kept_within_its_joint_and_a_motor_is_not(scene):
    limits = command_limits(scene)
    assert limits[0] == pytest.approx(np.deg2rad([-57, 57]))
    assert limits[1] == pytest.approx([-5, 5])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"rail": None}, "the table has no column rail"),
        ({"time_s": None}, "the table has no column time_s"),
        ({"shoulder": (4, np.nan)}, "a command is no number"),
        ({"time_s": (4, np.inf)}, "a time is no number"),
        ({"time_s": (4, 0.0)}, "time does not rise"),
        ({"shoulder": (4, 1.2)}, "motion 'bad' goes beyond a limit"),
        ({"rail": (4, -5.1)}, "motion 'bad' goes beyond a limit"),
    ],
)
def test_a_bad_file_is_one_clear_error(scene, tmp_path, columns, change, text):
    for name, what in change.items():
        if what is None:
            del columns[name]
        else:
            columns[name][what[0]] = what[1]
    with pytest.raises(DataError) as caught:
        read_motions(save(tmp_path / "bad.parquet", **columns), scene)
    assert str(caught.value).startswith(text)
    assert "bad.parquet" in str(caught.value)


def test_a_gap_is_refused_not_filled(scene, tmp_path, columns):
    cut = {k: np.delete(v, slice(10, 20)) for k, v in columns.items()}
    with pytest.raises(DataError, match="a motion has a gap"):
        read_motions(save(tmp_path / "cut.parquet", **cut), scene)


def test_another_unit_is_refused(scene, tmp_path, columns):
    fields = [pa.field(n, pa.float64(), metadata={"unit": "deg"} if n == "shoulder" else None) for n in columns]
    pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), tmp_path / "deg.parquet")
    with pytest.raises(DataError, match="commands of shoulder are in another unit"):
        read_motions(tmp_path / "deg.parquet", scene)


def test_text_one_row_and_no_file_are_refused(scene, tmp_path, columns):
    with pytest.raises(DataError, match="does not hold numbers"):
        read_motions(save(tmp_path / "text.parquet", **{**columns, "rail": ["x"] * 50}), scene)
    with pytest.raises(DataError, match="a motion is too short"):
        read_motions(save(tmp_path / "one.parquet", **{k: v[:1] for k, v in columns.items()}), scene)
    with pytest.raises(DataError, match="the policy file does not exist"):
        read_motions(tmp_path / "none.parquet", scene)
    (tmp_path / "junk.parquet").write_text("junk")
    with pytest.raises(DataError, match="the table cannot be read"):
        read_motions(tmp_path / "junk.parquet", scene)
    with pytest.raises(UsageError, match="a policy file is a Parquet table"):
        read_motions(tmp_path / "motion.csv", scene)


def test_a_scene_without_actuators_plays_no_file(tmp_path, columns):
    with pytest.raises(UsageError, match="has no actuators"):
        read_motions(save(tmp_path / "a.parquet", **columns), load_scene("cube_toss"))
