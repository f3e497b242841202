"""What the particle baseline promises: rigid motions, a hand and a table that push, no sense of direction."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from candata.models import Sizes, model
from candata.models._kinematics import Fingertips
from candata.models._poses import rotation_exp, rotation_matrix
from candata.models._rigid import best_rotation
from candata.schema.kinematics import HandKinematics, JointScrew, TipPoint
from candata.testing.models import generator as fresh_generator
from candata.testing.models import made_up_batch, made_up_normaliser, tiny_config

#: One slide along x that carries one ball of 1 cm.
SLIDE = HandKinematics(
    screws=(JointScrew(parent=-1, axis=(1, 0, 0), anchor_m=(0, 0, 0), slides=True, joint=0),),
    tips=(TipPoint(carrier=0, centre_m=(-0.08, 0, 0), radius_m=0.01),),
    driven_joints=(0, -1),
)
SIZES = Sizes(history=2, horizon=4, joints=3, actuators=2, fingertips=1, points=64)


def build(**fields: Any) -> torch.nn.Module:
    """Return a tiny model that has learnt nothing: on its own the object stays."""
    found = model("particle")
    config = tiny_config(found, particles=64, friction=0.0, **fields)
    return found.build(config, SIZES, made_up_normaliser(SIZES))


def still(count: int = 2) -> dict[str, torch.Tensor]:
    """Return windows of a ball of 5 cm that lies still at the origin, and a hand that holds still."""
    batch = made_up_batch(count, sizes=SIZES)
    for name, value in batch.items():
        if name.endswith(("joint_position", "action")):
            batch[name] = torch.zeros_like(value)
        if name.endswith("object_pose"):
            batch[name] = torch.tensor([0.0, 0, 0, 1, 0, 0, 0]).expand_as(value).clone()
    directions = torch.randn(2, SIZES.points, 3, generator=fresh_generator(3))
    batch["clouds"] = 0.05 * directions / directions.norm(dim=-1, keepdim=True)
    return batch


def sweep(batch: dict[str, torch.Tensor], step_m: float) -> dict[str, torch.Tensor]:
    """Return the windows with a hand whose command moves by so much a step."""
    planned = batch["planned/action"].clone()
    planned[..., 0] = step_m * torch.arange(1, SIZES.horizon + 1)
    return batch | {"planned/action": planned}


def forecast(net: torch.nn.Module, batch: dict[str, torch.Tensor]) -> torch.Tensor:
    return net.forecast(batch, 1, 1, fresh_generator()).increments[0]


def test_a_fingertip_pushes_the_object_its_own_way():
    pushed = forecast(build(hand=SLIDE), sweep(still(), 0.02)).sum(1)
    # Only the nodes that it sweeps move with it, and the rigid motion is their mean over the body.
    assert (pushed[:, 0] > 0.0005).all()
    assert (pushed[:, 1:3].abs() < pushed[:, :1]).all()


@pytest.mark.parametrize("step_m", [0.0, -0.02])
def test_a_fingertip_that_does_not_come_nearer_moves_nothing(step_m):
    assert forecast(build(hand=SLIDE), sweep(still(), step_m)).abs().max() < 1e-6


def test_without_a_hand_nothing_is_pushed():
    assert forecast(build(), sweep(still(), 0.02)).abs().max() < 1e-6


def test_the_table_holds_what_falls():
    batch, falls = still(), []
    for support_height_m in (None, -0.05):
        net = build(hand=SLIDE.model_copy(update={"support_height_m": support_height_m}))
        with torch.no_grad():
            net.node[-1].bias.copy_(torch.tensor([0.0, 0, -0.2]))  # 0.2 of a scale of 1 cm
        falls.append(forecast(net, batch)[..., 2].sum(1))
    assert falls[0].tolist() == pytest.approx([-0.008] * 2, rel=1e-4)
    assert (falls[1] > falls[0] + 1e-4).all()


def test_every_step_is_a_rigid_motion_of_the_pose():
    angle = torch.tensor([[0.3, -0.2, 0.5], [0.0, 0.0, 3.0]])
    turn = rotation_exp(angle)
    points = torch.randn(2, 20, 3, generator=fresh_generator())
    points = points - points.mean(1, keepdim=True)
    found = best_rotation(points, points @ rotation_matrix(turn).transpose(1, 2))
    # float32 products of 20 points.
    torch.testing.assert_close(found, turn, rtol=0, atol=1e-5)


def test_a_body_of_revolution_has_finite_gradients():
    ring = torch.linspace(0, 2 * torch.pi, 13)[:-1]
    points = torch.stack([ring.cos(), ring.sin(), torch.zeros(12)], dim=-1)[None]
    moved = points.clone().requires_grad_()
    best_rotation(points, moved).square().sum().backward()
    assert torch.isfinite(moved.grad).all()


def test_a_window_without_a_cloud_stays(awake):
    batch = still()
    batch["cloud"][0] = -1
    found = forecast(awake(build()), batch)
    assert not found[0].any()
    assert found[1].any()


def test_training_turns_the_world_and_forecasts_do_not(awake):
    net, batch = awake(build(random_yaw=True)), made_up_batch(3, sizes=SIZES)
    losses = [float(net.losses(batch, fresh_generator(seed))["loss"].detach()) for seed in (1, 2)]
    assert losses[0] != losses[1]
    assert torch.equal(*(net.forecast(batch, 1, 1, fresh_generator(seed)).increments for seed in (1, 2)))


def test_fingertips_follow_a_chain():
    hand = HandKinematics(
        screws=(
            JointScrew(parent=-1, axis=(0, 0, 1), anchor_m=(0, 0, 0), slides=False, joint=0),
            JointScrew(parent=0, axis=(0, 0, 1), anchor_m=(1, 0, 0), slides=False, joint=1, gain=2.0, offset=0.1),
        ),
        tips=(
            TipPoint(carrier=1, centre_m=(2, 0, 0), radius_m=0.1),
            TipPoint(carrier=-1, centre_m=(5, 5, 5), radius_m=0.1),
        ),
        driven_joints=(1,),
    )
    first, second = 0.4, 0.7
    total = first + 2 * second + 0.1
    wanted = torch.tensor([[first, total]]).cos().sum(), torch.tensor([[first, total]]).sin().sum()
    found = Fingertips(hand)(torch.tensor([[first, second]]))
    torch.testing.assert_close(found[0, 0], torch.tensor([*wanted, 0.0]), rtol=0, atol=1e-6)
    assert found[0, 1].tolist() == [5, 5, 5]
    commanded = Fingertips(hand).commanded(torch.tensor([[0.1, 0.2]]), torch.tensor([[0.9]]))
    assert commanded[0].tolist() == pytest.approx([0.1, 0.9])
