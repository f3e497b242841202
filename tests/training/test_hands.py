"""The hand of a model: found by the scene, kept in the run."""

from __future__ import annotations

from pathlib import Path

import pytest

from candata.errors import UsageError
from candata.training import jobs
from candata.training.evaluation import EvaluationSettings, evaluate
from candata.training.hands import with_hand
from candata.training.jobs import TrainRequest, prepare
from candata.training.loop import train
from candata.training.settings import TrainingSettings

HAND = """<mujoco>
  <option timestep=".002"/>
  <worldbody>
    <body name="link">
      <joint name="a"/>
      <geom type="capsule" fromto="0 0 0 0 .1 0" size=".01"/>
      <body name="tip" pos="0 .1 0"><joint name="b"/><geom size=".01"/></body>
    </body>
  </worldbody>
  <actuator><position name="a" joint="a" kp="1"/><position name="b" joint="b" kp="1"/></actuator>
</mujoco>"""
SCENE = "model: hand.xml\nrate_hz: 100\njoints: [{0}]\nactuators: [{0}]\nfingertips: [tip]\n"
PARTICLE = TrainRequest("particle", config={"width": 8, "particles": 8, "unrolled_steps": 2}, history=4, horizon=6)
SETTINGS = TrainingSettings(steps=2, batch=8, validate_every=2, log_every=2)


def scene(folder: Path, joints: str = "a, b") -> str:
    (folder / "hand.xml").write_text(HAND)
    (folder / "scene.yaml").write_text(SCENE.format(joints))
    return str(folder / "scene.yaml")


def test_recordings_without_a_scene_have_no_hand(dataset):
    job = prepare(dataset(), PARTICLE, SETTINGS)
    assert job.run.config["hand"] is None
    assert len(job.notes) == 1
    assert "--scene gives the hand's" in job.notes[0]


def test_a_run_keeps_its_hand(tmp_path, dataset):
    data = dataset()
    request = TrainRequest(**{**PARTICLE.__dict__, "scene": scene(tmp_path)})
    job = prepare(data, request, SETTINGS)
    assert not job.notes
    assert (job.run.preset, job.run.planned_actions) == ("small", True)
    assert job.run.config["hand"]["driven_joints"] == [0, 1]
    train(job, tmp_path / "run")
    (tmp_path / "scene.yaml").unlink()  # the run needs it no more
    found, _ = evaluate([tmp_path / "run"], data, EvaluationSettings(samples=1, steps=1))
    assert found.forecasters["run"].closed_loop.adds_auc is not None
    assert jobs.build(job.run).config.hand is not None


def test_a_scene_of_another_hand_is_refused(tmp_path, dataset):
    config = jobs.find_model("particle").presets["small"]
    with pytest.raises(UsageError, match="joint names a, b"):
        with_hand(config, [dataset()], scene(tmp_path, "b, a"))


def test_a_model_that_reads_no_hand_asks_for_none(dataset):
    config = jobs.find_model("mlp").presets["paper"]
    assert with_hand(config, [dataset()], None) == (config, ())
