"""Poses in torch: increments between them, and back. Quaternions w x y z, vectorised over leading axes.

Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, eqs. 12 (product),
101 (exponential), 105 (logarithm). The same algebra as `candata.rotation`, on tensors and with safe gradients.
"""

from __future__ import annotations

import torch
from torch import Tensor

from candata.models._contract import Batch


def targets(batch: Batch) -> Tensor:
    """Return the increments to forecast `(B, H, 6)` [m, rad], from present and future object poses."""
    present_pose = batch["history/object_pose"][:, -1:]
    return increments(torch.cat([present_pose, batch["future/object_pose"]], dim=1))


def increments(poses: Tensor) -> Tensor:
    """Return the T - 1 increments `(..., T - 1, 6)` [m, rad] between successive poses `(..., T, 7)`.

    First dp = p(k) - p(k-1), then the world-frame rotation vector omega with R(k) = exp(omega^) R(k-1).
    """
    earlier_poses, later_poses = poses[..., :-1, :], poses[..., 1:, :]
    turn = rotation_log(multiply(later_poses[..., 3:], conjugate(earlier_poses[..., 3:])))
    return torch.cat([later_poses[..., :3] - earlier_poses[..., :3], turn], dim=-1)


def integrate(present_pose: Tensor, steps: Tensor) -> Tensor:
    """Return the poses `(..., H, 7)` that increments `(..., H, 6)` lead to from `present_pose (..., 7)`.

    The leading axes of both are broadcast, so that M samples of B windows start from B poses.
    """
    position = present_pose[..., None, :3] + steps[..., :3].cumsum(dim=-2)
    turns = rotation_exp(steps[..., 3:])
    attitude = present_pose[..., 3:].expand(*turns.shape[:-2], 4)
    attitudes = []
    for k in range(steps.shape[-2]):
        attitude = multiply(turns[..., k, :], attitude)
        attitude = attitude / attitude.norm(dim=-1, keepdim=True)
        attitudes.append(attitude)
    return torch.cat([position.expand(*turns.shape[:-1], 3), torch.stack(attitudes, dim=-2)], dim=-1)


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the quaternion product `a b`, `(..., 4)`: first turn by b, then by a."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def conjugate(q: Tensor) -> Tensor:
    """Return the inverse of a unit quaternion, `(..., 4)`."""
    return torch.cat([q[..., :1], -q[..., 1:]], dim=-1)


def rotation_exp(vector: Tensor) -> Tensor:
    """Return the quaternion `(..., 4)` of a rotation vector `(..., 3)` [rad]."""
    half_angle = _length(vector) / 2
    return torch.cat([half_angle.cos(), vector * (half_angle.sin() / (2 * half_angle))], dim=-1)


def rotation_log(q: Tensor) -> Tensor:
    """Return the shortest rotation vector `(..., 3)` [rad] of a quaternion `(..., 4)`, q and -q alike."""
    q = torch.where(q[..., :1] < 0, -q, q)
    sine = _length(q[..., 1:])
    return q[..., 1:] * (2 * torch.atan2(sine, q[..., :1]) / sine)


def rotation_matrix(q: Tensor) -> Tensor:
    """Return the rotation matrix `(..., 3, 3)` of a unit quaternion `(..., 4)`."""
    w, x, y, z = q.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def _length(vector: Tensor) -> Tensor:
    """Return the norm `(..., 1)`, never quite zero: ratios to it and gradients stay finite."""
    smallest_square = torch.finfo(vector.dtype).tiny
    return vector.square().sum(-1, keepdim=True).clamp_min(smallest_square).sqrt()
