"""How much of a learned correction is played, chosen on validation episodes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from candata.loaders import windows
from candata.models import Sizes
from candata.models import model as find_model
from candata.testing.models import tiny_config
from candata.training import TrainingSettings, TrainRequest, prepare, simulated, train
from candata.training.checkpoint import AVERAGE, read
from candata.training.correction_gain import GAINS, choose_gain, least_near_best
from candata.training.simulator import simulator

TINY = {"cloud": "none", "latent": 16, "temporal_width": 8, "widths": (8, 16), "groups": 8}
#: What the object of the drifting recordings moves on its own each row [m].
DRIFT_M = 0.001


def drifting(episode):
    """The recorded object moves on along x, whatever the hand does."""
    pose = episode["object_pose"].copy()
    pose[:, 0] += DRIFT_M * np.arange(len(pose))
    return {"object_pose": pose}


def pushing_model(feed):
    """A model whose correction is the drift of a model step, whatever it reads."""
    model = find_model("sim_residual")
    module = model.build(tiny_config(model, **TINY), Sizes(**feed.sizes()), feed.normaliser)
    increment = torch.zeros(6)
    increment[0] = DRIFT_M * int(feed.stride[0])
    last_bias = [each for name, each in module.named_parameters() if name.endswith("bias") and each.shape == (6,)][-1]
    with torch.no_grad():
        last_bias.copy_((increment / module.reader.increment_scale).mean(0))
    return module.eval()


def test_a_correction_that_is_right_is_played_and_one_that_is_wrong_is_not(nominal, tmp_path, rewritten):
    options = {"channels": ("object_pose", "joint_position", "action"), "history": 3, "horizon": 4}
    drifted = windows(rewritten(tmp_path / "drift", nominal, drifting), **options)
    still = windows(rewritten(tmp_path / "still", nominal, lambda _: {}), **options)
    module = pushing_model(drifted)
    gains = {}
    for name, feed in (("drifted", drifted), ("still", still)):
        gains[name] = choose_gain(module, [(feed, simulator(feed, None))], 2, 0, "cpu")
        assert float(module.gain) == gains[name]
    assert gains == {"drifted": 1.0, "still": 0.0}


@pytest.mark.parametrize(
    ("errors", "row"),
    [
        ([[3.0, 3.0, 3.0], [2.0, 2.1, 1.9], [1.0, 1.1, 0.9]], 2),  # the best one is better beyond doubt
        ([[1.0, 3.0, 2.0], [2.0, 1.0, 1.1], [2.0, 1.0, 1.0]], 0),  # nothing can be told apart: no correction
        ([[3.0, 3.1], [1.0, 1.1], [np.nan, 1.0]], 1),  # a loop that diverges at one gain hides none that is better
        ([[2.0], [1.0]], 1),  # one episode has no standard error: the least
    ],
)
def test_the_least_gain_within_one_standard_error_of_the_best_is_taken(errors, row):
    assert least_near_best(np.array(errors)) == row


def test_a_run_ends_with_a_gain_and_goes_on_to_the_same_one(nominal, tmp_path, rewritten, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(simulated, "DENSE_WINDOWS", 60)
    data = rewritten(tmp_path / "data", nominal, lambda _: {})
    request = TrainRequest(model="sim_residual", config=TINY, history=3, horizon=4)
    job = prepare(data, request, TrainingSettings(steps=4, batch=8, validate_every=4, learning_rate=0.05))
    averages = []
    for _ in range(2):  # the second time as after a kill behind the last step
        train(job, tmp_path / "run")
        averages.append(read(tmp_path / "run").tensors(AVERAGE))
    assert all(torch.equal(averages[0][name], value) for name, value in averages[1].items())
    assert float(averages[0]["gain"]) in GAINS[:-1]  # the simulator is right already
