"""What networks read of raw batches: scales, pads, and what moving the world changes."""

from __future__ import annotations

import pytest
import torch

from candata.errors import DataError, UsageError
from candata.models import Sizes, model, targets
from candata.models._inputs import known_steps, masked_mean, turn_points
from candata.schema.kinematics import HandKinematics, JointScrew, TipPoint


def test_targets_are_scaled_and_come_back(tiny, batch):
    reader, windows = tiny("mlp").reader, batch(4)
    value, known = reader.target(windows)
    assert known.all()
    # Centre 1 mm and scale 1 cm of the made-up normaliser; float32.
    torch.testing.assert_close(value, (targets(windows) - 0.001) / 0.01, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(reader.to_si(value), targets(windows), rtol=1e-5, atol=1e-7)


def test_a_step_is_known_when_both_its_ends_are():
    windows = {"history_pad": torch.tensor([[True, False]]), "future_pad": torch.tensor([[False, True, False, False]])}
    assert known_steps(windows).tolist() == [[True, False, False, True]]


def test_nothing_is_known_from_a_present_that_is_not_there():
    windows = {"history_pad": torch.tensor([[False, True]]), "future_pad": torch.zeros(1, 3, dtype=torch.bool)}
    assert not known_steps(windows).any()


@pytest.mark.parametrize("name", ["mlp", "unet", "particle", "contact_diffusion"])
def test_the_shortest_windows(name, tiny, batch, generator):
    sizes = Sizes(history=1, horizon=1, joints=3, actuators=3, fingertips=2, points=16)
    net, windows = tiny(name, sizes), batch(3, sizes=sizes)
    net.losses(windows, generator(0))["loss"].backward()
    assert net.forecast(windows, 2, 2, generator(0)).increments.shape == (2, 3, 1, 6)


def test_a_mean_over_nothing_is_zero():
    assert masked_mean(torch.full((2, 3), torch.nan), torch.zeros(2, 3, dtype=torch.bool)) == 0


def test_contact_is_signed_and_blank_where_padded(tiny, batch):
    windows = batch(3)
    windows["history_pad"][:, 0] = True
    found = tiny("mlp", contact_history=True, fingertip_contact=True).reader(windows).contact
    assert found.shape == (3, 4, 3)
    assert not found[:, 0].any()
    assert torch.equal(found[:, 1:, 0] > 0, windows["history/contact"][:, 1:])
    assert set(found[:, 1:].unique().tolist()) == {-1.0, 1.0}


@pytest.mark.parametrize("name", ["mlp", "unet", "contact_diffusion"])
def test_padded_history_is_not_read(name, tiny, batch, awake, generator):
    windows, net = batch(3), awake(tiny(name, fingertip_contact=True))
    whole = net.forecast(windows, 2, 2, generator(0)).increments
    windows["history_pad"][:, :2] = True
    before = net.forecast(windows, 2, 2, generator(0)).increments
    for key in ("history/object_pose", "history/joint_position", "history/action"):
        windows[key][:, :2] = torch.nan
    for key in ("history/contact", "history/fingertip_contact"):
        windows[key][:, :2] = ~windows[key][:, :2]
    assert torch.equal(net.forecast(windows, 2, 2, generator(0)).increments, before)
    assert not torch.equal(before, whole)


@pytest.mark.parametrize("name", ["mlp", "unet", "contact_diffusion"])
@pytest.mark.parametrize("world_position", [False, True])
def test_moving_the_world(name, world_position, tiny, batch, awake, generator):
    windows, net = batch(3), awake(tiny(name, world_position=world_position))
    before = net.forecast(windows, 2, 2, generator(0)).increments
    moved = windows | {
        "history/object_pose": windows["history/object_pose"] + torch.tensor([0.5, -0.25, 1, 0, 0, 0, 0])
    }
    change = (net.forecast(moved, 2, 2, generator(0)).increments - before).abs().max()
    # Positions near 1 m are rounded at 1e-7 m, 1e-5 of the 1 cm steps; the networks may stretch that tenfold.
    assert (change < 1e-6) == (not world_position)


def test_a_cloud_turns_with_the_pose():
    quarter = torch.tensor([[9.0, 9, 9, 0.5**0.5, 0, 0, 0.5**0.5]])  # about z; where it is does not matter
    found = turn_points(quarter, torch.tensor([[[1.0, 0, 0], [0, 2, 3]]]))
    torch.testing.assert_close(found, torch.tensor([[[0.0, 1, 0], [-2, 0, 3]]]))


@pytest.mark.parametrize("cloud", ["object", "world"])
def test_each_window_reads_its_own_cloud(cloud, tiny, batch, awake, generator):
    net, windows = awake(tiny("diffusion_unet", cloud=cloud)), batch(4, clouds=2)
    before = net.forecast(windows, 1, 2, generator(0)).increments[0]
    other = windows["clouds"].clone()
    other[1] *= 2
    change = (net.forecast(windows | {"clouds": other}, 1, 2, generator(0)).increments[0] - before).abs()
    assert change[1::2].amax() > 1e-6
    # Matrix products of one batch size: only the other cloud's windows change.
    assert change[::2].amax() == 0


def test_clouds_that_no_window_uses_are_not_encoded(tiny, batch, awake, generator):
    net, windows = awake(tiny("diffusion_unet")), batch(3, clouds=2)
    before = net.forecast(windows, 1, 2, generator(0)).increments
    many = torch.cat([windows["clouds"], torch.full((9, *windows["clouds"].shape[1:]), torch.nan)])
    after = net.forecast(windows | {"clouds": many}, 1, 2, generator(0)).increments
    torch.testing.assert_close(after, before, rtol=0, atol=1e-7)  # float32, in SI


def test_a_window_without_a_cloud_reads_none(tiny, batch, awake, generator):
    net, windows = awake(tiny("diffusion_unet")), batch(3)
    windows["cloud"][0] = -1
    before = net.forecast(windows, 1, 2, generator(0)).increments[0]
    after = net.forecast(windows | {"clouds": 2 * windows["clouds"]}, 1, 2, generator(0)).increments[0]
    assert torch.equal(after[0], before[0])
    assert not torch.equal(after[1:], before[1:])


@pytest.mark.parametrize(
    ("name", "lost"),
    [
        ("mlp", "history/action"),
        ("diffusion_unet", "planned/action"),
        ("contact_diffusion", "history/contact"),
        ("diffusion_unet", "clouds"),
        ("particle", "history/object_pose"),
        ("unet", "planned/action"),
    ],
)
def test_a_name_that_is_missing_is_told(name, lost, tiny, batch, generator):
    windows = batch(2)
    del windows[lost]
    with pytest.raises(DataError, match=lost):
        tiny(name).forecast(windows, 1, 1, generator(0))


def test_a_normaliser_of_other_windows_is_refused(tiny, normaliser):
    found, other = model("mlp"), Sizes(history=4, horizon=6, joints=3, actuators=2, fingertips=2, points=20)
    with pytest.raises(UsageError, match="scale of increment does not fit"):
        found.build(found.parse({}), other, normaliser())


def test_a_normaliser_without_increments_is_refused(normaliser):
    found, sizes = model("mlp"), Sizes(4, 8, 3, 2, 2, 20)
    with pytest.raises(UsageError, match="no scale of pose increments"):
        found.build(found.parse({}), sizes, normaliser().model_copy(update={"increments": None}))


def test_data_without_clouds_need_a_model_without(normaliser):
    found, sizes = model("diffusion_unet"), Sizes(4, 8, 3, 2, 2, 0)
    with pytest.raises(UsageError, match="set the model's `cloud` to `none`"):
        found.build(found.presets["small"], sizes, normaliser())
    assert found.build(found.parse({"cloud": "none"}), sizes, normaliser())
    particle = model("particle")
    with pytest.raises(UsageError, match="take a model that reads none"):
        particle.build(particle.presets["small"], sizes, normaliser())


#: A ball that a slide along x carries from the origin.
SLIDER = HandKinematics(
    screws=(JointScrew(parent=-1, axis=(1, 0, 0), anchor_m=(0, 0, 0), slides=True, joint=0),),
    tips=(TipPoint(carrier=0, centre_m=(0, 0, 0), radius_m=0.01),),
    driven_joints=(-1, 0),
)


def test_fingertips_are_read_from_where_the_object_is(tiny, batch):
    windows = batch(3)
    inputs = tiny("mlp", hand=SLIDER).reader(windows)
    position = windows["history/object_pose"][:, -1, :3]
    past, planned = (torch.zeros(3, rows, 3) - position[:, None] for rows in (4, 8))
    past[..., 0] += windows["history/joint_position"][..., 0]
    planned[..., 0] += windows["planned/action"][..., 1]
    torch.testing.assert_close(inputs.history[..., -4:-1], past / 0.1)
    torch.testing.assert_close(inputs.plan[..., 2:], planned / 0.1)


def test_fingertips_are_blank_where_padded(tiny, batch):
    windows = batch(2)
    windows["history_pad"][:, :2] = True
    windows["future_pad"][:, 5:] = True
    inputs = tiny("mlp", hand=SLIDER).reader(windows)
    assert not inputs.history[:, :2].any()
    assert not inputs.plan[:, 6:].any()


def test_the_paper_reads_no_fingertips(tiny, batch):
    reader = tiny("mlp", hand=SLIDER, fingertip_points=False, planned_actions=False).reader
    assert (reader.fingertip_size, reader.plan_size) == (0, 0)
    assert reader(batch(2)).history.shape[-1] == reader.history_size
