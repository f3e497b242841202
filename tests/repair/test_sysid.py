"""What is exported for mujoco.sysid: its own formats, and numbers that its rollouts confirm."""

from __future__ import annotations

import importlib.util
import json

import mujoco
import numpy as np
import pytest
import yaml

from candata.datasets import append, create_dataset, open_dataset
from candata.effects import effect, flatten, setting
from candata.errors import DataError, UsageError
from candata.repair import export_sysid
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.schema.manifest import Lineage
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.world import build_worlds
from tests.repair.rig import EDITS, drawn

TRUE = (
    EffectSetting(name="servo_gain", parameters={"kp_scale": 0.7}),
    EffectSetting(name="object_mass", parameters={"mass_scale": 1.5}),
    EffectSetting(name="friction_cone", parameters={"cone": "pyramidal"}),
)
DELAY = EffectSetting(name="actuation_delay", parameters={"delay_s": 0.02})


def dataset(scene, folder, effects=TRUE, count: int = 3):
    """Recordings of free motions in a world with effects."""
    jobs = [EpisodeJob(f"e{i}", i, "free_sweep", 3, tuple(effects), hidden=True) for i in range(count)]
    create_dataset(folder)
    append(folder, make_episodes(scene, jobs, duration_s=1.0), Lineage(operation="test"))
    return open_dataset(folder)


@pytest.fixture(scope="module")
def exported(gripper, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sysid")
    return export_sysid(gripper, (*TRUE, DELAY), dataset(gripper, folder / "real"), folder / "out"), folder / "out"


@pytest.fixture(scope="module")
def neck_dataset(neck, tmp_path_factory):
    return dataset(neck, tmp_path_factory.mktemp("neck") / "real", effects=(), count=1)


def written(places, spec, value: float) -> None:
    """What the exported program does with one component of a parameter."""
    for place in places:
        owner = spec.option if place["kind"] == "option" else getattr(spec, place["kind"])(place["name"])
        number = place["offset"] + place["slope"] * value
        if place["index"] is None:
            setattr(owner, place["attribute"], number)
        else:
            getattr(owner, place["attribute"])[place["index"]] = number


def test_parameters_start_at_the_diagnosis_within_bounds(exported):
    found, out = exported
    states = yaml.safe_load((out / "parameters.yaml").read_text())
    assert sorted(states) == ["object_mass.mass_scale", "servo_gain.kp_scale"]
    mass = states["object_mass.mass_scale"]
    assert (mass["nominal"], mass["value"], mass["min_value"], mass["max_value"]) == ([1.0], [1.5], [0.2], [5.0])
    assert [h.name for h in found.fixed] == ["friction_cone"]
    assert [(entry.name, "custom_rollout" in entry.apply) for entry in found.left] == [("actuation_delay", True)]


#: Effects whose parameters move numbers of the model along straight lines.
BENT = ("joint_offset", "joint_spring", "friction_cone", "gravity_tilt", "integrator", "time_step")
STRAIGHT = [n for n in EDITS if n not in BENT]


@pytest.mark.parametrize("name", STRAIGHT)
def test_a_parameter_moves_the_model_as_the_effect_does(gripper, neck, neck_dataset, exported, tmp_path, name):
    scene, real = neck, neck_dataset
    if effect(name).possible(gripper):
        scene, real = gripper, open_dataset(exported[1].parent / "real")
    start = drawn(name, scene)
    found = export_sysid(scene, [start], real, tmp_path / "out")
    targets = json.loads((tmp_path / "out/targets.json").read_text())
    other = drawn(name, scene, seed=7)
    x = flatten(other, scene)
    assert not np.allclose(x, flatten(start, scene))
    spec = mujoco.MjSpec.from_file(str(tmp_path / "out" / found.model))
    components = [part for parameter in found.parameters for part in targets[parameter.name]]
    for value, places in zip(x, components, strict=True):
        written(places, spec, float(value))
    model, target = spec.compile(), build_worlds(scene, [[setting(name, x, scene)]]).models[0]
    fields = (
        "geom_friction geom_solref geom_solimp geom_size geom_pos pair_friction pair_solref dof_damping dof_armature"
    )
    for (
        field
    ) in f"{fields} dof_frictionloss actuator_gainprm actuator_biasprm body_mass body_inertia body_ipos".split():
        one, two = getattr(model, field), getattr(target, field)
        # MuJoCo saves models with six digits.
        assert np.abs(one - two).max(initial=0) <= 1e-5 * np.abs(two).max(initial=0), field


def test_sequences_hold_commands_readings_and_starts(gripper, exported):
    found, out = exported
    model = mujoco.MjModel.from_xml_path(str(out / found.model))
    real = {e.meta.id: e for e in open_dataset(out.parent / "real").episodes()}
    with np.load(out / "sequences/e1.npz", allow_pickle=False) as one:
        steps = round(1 / gripper.file.rate_hz / model.opt.timestep)
        assert np.array_equal(one["control_data"][::steps], real["e1"]["action"])
        assert np.array_equal(one["control_data"][steps - 1 :: steps], real["e1"]["action"])
        assert np.array_equal(one["sensordata_data"][:, :3], real["e1"]["joint_position"])
        assert one["sensordata_data"].shape[1] == model.nsensordata == 10
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        assert len(one["initial_state"]) == mujoco.mj_stateSize(model, kind)
        assert json.loads(str(one["control_signal_mapping"]))["left_ctrl"] == [5, [1]]
        assert json.loads(str(one["sensordata_signal_mapping"]))["object_rotation"] == [0, [6, 7, 8, 9]]
    assert found.sensors == ("lift", "left", "right", "object_position", "object_rotation")


def test_the_toolbox_loads_it_and_its_rollout_is_the_recording(exported):
    sysid = pytest.importorskip("mujoco.sysid")
    if not hasattr(sysid, "optimize"):
        pytest.skip("mujoco.sysid lacks what it needs")
    _, out = exported
    spec = importlib.util.spec_from_file_location("identify", out / "identify.py")
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    parameters, (group,) = program.parameters(), program.sequences()
    residual = sysid.build_residual_fn(models_sequences=[group], n_threads=1)
    worst = []
    for gain in (0.7, 1.0):
        x = np.array([1.5 if "mass" in p.name else gain for p in parameters.values()])
        _, predicted, measured = residual(x, parameters, return_pred_all=True)
        assert measured[0][0].data.shape == predicted[0][0].data.shape == (80, 10)
        worst.append(np.abs(predicted[0][0].data - measured[0][0].data)[:, 1:3].max())
    # The start is taken as at rest, the recording was settling: tenths of a milliradian.
    assert worst[0] < 5e-4
    assert worst[1] > 10 * worst[0]


def test_a_model_without_actuators_gives_tosses(tmp_path):
    scene = load_scene("cube_toss")
    jobs = [EpisodeJob(f"e{i}", i, "toss", 3, (), hidden=True) for i in range(2)]
    create_dataset(tmp_path / "real")
    append(tmp_path / "real", make_episodes(scene, jobs, duration_s=0.6), Lineage(operation="test"))
    export_sysid(scene, [drawn("sliding_friction", scene)], open_dataset(tmp_path / "real"), tmp_path / "out")
    with np.load(tmp_path / "out/sequences/e0.npz") as one:
        assert one["control_data"].shape[1] == 0
        assert one["sensordata_data"].shape[1] == 7
        # A toss starts just before it strikes, with the speed it has there.
        assert np.abs(one["initial_state"][-6:]).max() > 0.1


def test_what_cannot_be_exported_is_refused(gripper, exported, tmp_path):
    real = open_dataset(exported[1].parent / "real")
    with pytest.raises(UsageError, match="exists"):
        export_sysid(gripper, TRUE, real, exported[1])
    with pytest.raises(UsageError, match="cannot act"):
        export_sysid(load_scene("cube_toss"), [DELAY], real, tmp_path / "out")
    with pytest.raises(DataError):
        export_sysid(load_scene("cube_toss"), [], real, tmp_path / "out")
    create_dataset(tmp_path / "none")
    with pytest.raises(DataError, match="empty"):
        export_sysid(gripper, TRUE, open_dataset(tmp_path / "none"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
