"""Forward kinematics in torch: where the joints put the fingertips.

Source: K. Lynch, F. Park, "Modern Robotics", 2017, eq. 4.14 (product of exponentials in the space frame) and eq. 3.51
(Rodrigues' formula).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from candata.schema.kinematics import HandKinematics, Vector


class Fingertips(nn.Module):
    """Positions of a hand's fingertips; its buffers are the hand's, and no checkpoint holds them."""

    identity: Tensor
    axis: Tensor
    skew: Tensor
    skew_squared: Tensor
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
        axis = _columns([screw.axis for screw in screws])
        x, y, z = axis
        skew = torch.stack([0 * x, -z, y, z, 0 * x, -x, -y, x, 0 * x]).unflatten(0, (3, 3))
        for name, value in {
            "identity": torch.eye(3)[:, :, None, None],
            "axis": axis,
            "skew": skew,
            "skew_squared": (skew[:, :, None] * skew[None]).sum(1),
            "anchor": _columns([screw.anchor_m for screw in screws]),
            "slides": torch.tensor([screw.slides for screw in screws], dtype=torch.bool),
            "source": torch.tensor([screw.joint for screw in screws], dtype=torch.long),
            "gain": torch.tensor([screw.gain for screw in screws]),
            "offset": torch.tensor([screw.offset for screw in screws]),
            "centre": _columns([tip.centre_m for tip in tips]),
            "radius": torch.tensor([tip.radius_m for tip in tips]),
        }.items():
            self.register_buffer(name, value, persistent=False)
        self.levels = _levels([screw.parent for screw in screws])
        order = {screw: i for i, screw in enumerate(screw for level, _ in self.levels for screw in level)}
        #: Where the motion of each tip's carrier stands behind that of the world, level by level.
        self.carriers = [0 if tip.carrier < 0 else 1 + order[tip.carrier] for tip in tips]
        self.driven_joints = hand.driven_joints

    def forward(self, joints: Tensor) -> Tensor:
        """Return the centres of the tips `(..., F, 3)` [m, world] for joint positions `(..., J)`."""
        # Components come first and rows last, so that each product runs over all rows at once.
        readings = joints.reshape(-1, joints.shape[-1]).T
        moved = readings[self.source] * self.gain[:, None] + self.offset[:, None]
        turn = torch.where(self.slides[:, None], torch.zeros_like(moved), moved)
        rotation = self.identity + turn.sin() * self.skew + (1 - turn.cos()) * self.skew_squared
        shift = torch.where(self.slides[:, None], moved * self.axis, self.anchor - (rotation * self.anchor).sum(1))
        still = self.identity.expand(3, 3, 1, readings.shape[1])
        motions = [(still, torch.zeros_like(still[0]))]
        for level, parents in self.levels:
            carrier, carried = motions[-1][0][:, :, parents], motions[-1][1][:, parents]
            motions.append(
                (
                    (carrier[:, :, None] * rotation[None, :, :, level]).sum(1),
                    (carrier * shift[:, level]).sum(1) + carried,
                )
            )
        rotations, shifts = (torch.cat(parts, dim=-2) for parts in zip(*motions, strict=True))
        points = (rotations[:, :, self.carriers] * self.centre).sum(1) + shifts[:, self.carriers]
        return points.permute(2, 1, 0).reshape(*joints.shape[:-1], len(self.carriers), 3)

    def commanded(self, joints: Tensor, actions: Tensor) -> Tensor:
        """Return joint positions `(..., J)` with the driven ones at their commands `(..., A)`."""
        commanded = joints.expand(*actions.shape[:-1], joints.shape[-1]).clone()
        for actuator, joint in enumerate(self.driven_joints):
            if joint >= 0:
                commanded[..., joint] = actions[..., actuator]
        return commanded


def _columns(vectors: Sequence[Vector]) -> Tensor:
    """Return vectors as `(3, n, 1)`."""
    return torch.tensor(vectors, dtype=torch.float32).reshape(-1, 3).T[..., None].contiguous()


def _levels(parents: list[int]) -> list[tuple[list[int], list[int]]]:
    """Return the screws by depth, and for each its parent's place in the level before; all of a level move at once."""
    depth: list[int] = []
    for parent in parents:
        depth.append(1 if parent < 0 else 1 + depth[parent])
    levels: list[tuple[list[int], list[int]]] = []
    before: list[int] = []
    for number in range(1, max(depth, default=0) + 1):
        level = [screw for screw, at in enumerate(depth) if at == number]
        levels.append((level, [0 if number == 1 else before.index(parents[screw]) for screw in level]))
        before = level
    return levels
