"""Forward kinematics in torch: where the joints put the fingertips.

Source: K. Lynch, F. Park, "Modern Robotics", 2017, eq. 4.14 (product of exponentials in the space frame) and eq. 3.51
(Rodrigues' formula).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.schema.kinematics import HandKinematics


class Fingertips(nn.Module):
    """Positions of a hand's fingertips; its buffers are the hand's, and no checkpoint holds them."""

    axis: Tensor
    skew: Tensor
    anchor: Tensor
    slides: Tensor
    source: Tensor
    gain: Tensor
    offset: Tensor
    centre: Tensor
    radius: Tensor

    def __init__(self, hand: HandKinematics) -> None:
        super().__init__()
        screws, tips = hand.screws, hand.tips
        axis = torch.tensor([screw.axis for screw in screws]).reshape(-1, 3)
        for name, value in {
            "axis": axis,
            "skew": torch.linalg.cross(axis[:, None], torch.eye(3).expand(len(axis), 3, 3), dim=-1).transpose(1, 2),
            "anchor": torch.tensor([screw.anchor_m for screw in screws]).reshape(-1, 3),
            "slides": torch.tensor([screw.slides for screw in screws], dtype=torch.bool),
            "source": torch.tensor([screw.joint for screw in screws], dtype=torch.long),
            "gain": torch.tensor([screw.gain for screw in screws]),
            "offset": torch.tensor([screw.offset for screw in screws]),
            "centre": torch.tensor([tip.centre_m for tip in tips]),
            "radius": torch.tensor([tip.radius_m for tip in tips]),
        }.items():
            self.register_buffer(name, value, persistent=False)
        self.parents = [screw.parent for screw in screws]
        self.carriers = [tip.carrier for tip in tips]
        self.driven_joints = hand.driven_joints

    def forward(self, joints: Tensor) -> Tensor:
        """Return the centres of the tips `(..., F, 3)` [m, world] for joint positions `(..., J)`."""
        moved = joints[..., self.source] * self.gain + self.offset
        turn = torch.where(self.slides, torch.zeros_like(moved), moved)[..., None, None]
        rotations = torch.eye(3, dtype=moved.dtype, device=moved.device) + turn.sin() * self.skew
        rotations = rotations + (1 - turn.cos()) * (self.skew @ self.skew)
        shifts = torch.where(
            self.slides[:, None],
            moved[..., None] * self.axis,
            self.anchor - (rotations @ self.anchor[..., None])[..., 0],
        )
        chains: list[tuple[Tensor, Tensor]] = []
        for number, parent in enumerate(self.parents):
            rotation, shift = rotations[..., number, :, :], shifts[..., number, :, None]
            if parent >= 0:
                parent_rotation, parent_shift = chains[parent]
                rotation, shift = parent_rotation @ rotation, parent_rotation @ shift + parent_shift
            chains.append((rotation, shift))
        points = []
        for centre, carrier in zip(self.centre, self.carriers, strict=True):
            if carrier < 0:
                points.append(centre.expand(*joints.shape[:-1], 3))
            else:
                rotation, shift = chains[carrier]
                points.append((rotation @ centre[:, None] + shift)[..., 0])
        return torch.stack(points, dim=-2)

    def commanded(self, joints: Tensor, actions: Tensor) -> Tensor:
        """Return joint positions `(..., J)` with the driven ones at their commands `(..., A)`."""
        commanded = joints.expand(*actions.shape[:-1], joints.shape[-1]).clone()
        for actuator, joint in enumerate(self.driven_joints):
            if joint >= 0:
                commanded[..., joint] = actions[..., actuator]
        return commanded
