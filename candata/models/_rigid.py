"""The rotation that fits two sets of points best."""

from __future__ import annotations

import torch
from torch import Tensor


def best_rotation(points: Tensor, moved: Tensor) -> Tensor:
    """Return the quaternions `(B, 4)` that turn centred points `(B, P, 3)` nearest to centred `moved (B, P, 3)`.

    Least squares, as by W. Kabsch, Acta Cryst. A32, 1976. Source: B. Horn, "Closed-form solution of absolute
    orientation using unit quaternions", JOSA A 4(4), 1987, section 4.A; unlike that of a singular value decomposition,
    its gradient is finite for bodies of revolution.
    """
    s = points.transpose(1, 2) @ moved
    xx, xy, xz, yx, yy, yz, zx, zy, zz = s.flatten(1).unbind(-1)
    rows = [
        torch.stack([xx + yy + zz, yz - zy, zx - xz, xy - yx], dim=-1),
        torch.stack([yz - zy, xx - yy - zz, xy + yx, zx + xz], dim=-1),
        torch.stack([zx - xz, xy + yx, yy - xx - zz, yz + zy], dim=-1),
        torch.stack([xy - yx, zx + xz, yz + zy, zz - xx - yy], dim=-1),
    ]
    _, vectors = torch.linalg.eigh(torch.stack(rows, dim=-2))
    q: Tensor = vectors[..., -1]
    return torch.where(q[:, :1] < 0, -q, q)
