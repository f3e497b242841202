"""From raw batches to what networks read: normalised, relative to the present pose, padded rows blanked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from candata.errors import DataError, UsageError
from candata.loaders import Normaliser
from candata.models._config import HistoryConfig
from candata.models._contract import Batch, Sizes
from candata.models._kinematics import Fingertips
from candata.models._poses import increments, rotation_matrix, targets
from candata.models._sharing import mean_count

#: Divides distances from hand to object, so that those at hand are of size one [m]. A round number.
HAND_SCALE_M = 0.1


class Inputs(NamedTuple):
    """What a network reads of B windows.

    Attributes
    ----------
    history : (B, K + 1, S)
        Object, joints, actions and fingertips at each past row, and whether the row is there.
    place : (B, P)
        Attitude of the object at present and, where the configuration asks, its position.
    contact : (B, K + 1, 1 + F) or (B, K + 1, 0)
        Past contact as -1 and 1; 0 where it is not known.
    plan : (B, H, A + 3 F) or (B, H, 0)
        Planned actions, and where the fingertips are when the joints have reached them.
    """

    history: Tensor
    place: Tensor
    contact: Tensor
    plan: Tensor


class Reader(nn.Module):
    """Reads batches; its buffers are the normaliser's values, so a checkpoint holds them."""

    increment_centre: Tensor
    increment_scale: Tensor

    def __init__(self, config: HistoryConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__()
        self.config, self.sizes, self.clips = config, sizes, normaliser.clips
        for name, channel, columns in (
            ("position", "object_pose", 3),
            ("joint", "joint_position", sizes.joints),
            ("action", "action", sizes.actuators),
        ):
            centre, scale = normaliser.channel(channel) if columns else (np.zeros(0), np.zeros(0))
            self._keep(name, centre[:columns], scale[:columns], (columns,))
        if normaliser.increments is None:
            raise UsageError("the normaliser has no scale of pose increments", expected="windows with object_pose")
        centre, scale = normaliser.increments.arrays()
        self._keep("increment", centre, scale, (sizes.horizon, 6))
        self.fingertips = Fingertips(config.hand) if config.fingertip_points and config.hand else None

    @property
    def history_size(self) -> int:
        """Columns of `Inputs.history`."""
        return 3 + 6 + 6 + self.sizes.joints + self.sizes.actuators + self.fingertip_size + 1

    @property
    def place_size(self) -> int:
        """Columns of `Inputs.place`."""
        return 6 + 3 * self.config.world_position

    @property
    def contact_size(self) -> int:
        """Columns of `Inputs.contact`."""
        config = self.config
        return config.contact_history * 1 + config.fingertip_contact * self.sizes.fingertips

    @property
    def plan_size(self) -> int:
        """Columns of `Inputs.plan`."""
        return (self.sizes.actuators + self.fingertip_size) * self.config.planned_actions

    @property
    def fingertip_size(self) -> int:
        """Columns that say where the fingertips are; 0 where they are not read."""
        return 0 if self.fingertips is None else 3 * len(self.fingertips.carriers)

    def forward(self, batch: Batch) -> Inputs:
        """Return what the network reads of a raw batch.

        Raises
        ------
        DataError
            When the batch lacks a name that this configuration reads.
        """
        self._check(batch)
        pad = batch["history_pad"]
        poses = batch["history/object_pose"].to(self.increment_scale.dtype)
        poses = torch.where(pad[..., None], poses[:, -1:], poses)
        present_pose = poses[:, -1]
        place = [_attitude_columns(present_pose)]
        if self.config.world_position:
            place.append(self._read("position", present_pose[:, :3]))
        return Inputs(
            self._history(batch, poses, pad),
            torch.cat(place, dim=-1),
            self._contact(batch, pad),
            self._plan(batch),
        )

    def target(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the normalised increments `(B, H, 6)`, zero where unknown, and where they are known `(B, H)`."""
        is_known = known_steps(batch)
        values = targets({k: v.to(self.increment_scale.dtype) for k, v in batch.items() if k.endswith("object_pose")})
        increments_scaled = self._normalise("increment", values)
        return torch.where(is_known[..., None], increments_scaled, torch.zeros_like(increments_scaled)), is_known

    def to_si(self, values: Tensor) -> Tensor:
        """Return increments `(..., 6)` [m, rad] from normalised ones."""
        return values * self.increment_scale + self.increment_centre

    def _history(self, batch: Batch, poses: Tensor, pad: Tensor) -> Tensor:
        """Return the object's path relative to the present, its increments, joints and actions."""
        offsets = poses[..., :3] - poses[:, -1:, :3]
        past_centre, past_scale = self.increment_centre.mean(0), self.increment_scale.mean(0)
        steps = (increments(poses) - past_centre) / past_scale
        rows = [
            offsets / self.get_buffer("position_scale"),
            _attitude_columns(poses),
            torch.cat([steps.new_zeros(len(steps), 1, 6), steps], dim=1),
        ]
        rows += [self._read("joint", batch["history/joint_position"])] if self.sizes.joints else []
        rows += [self._read("action", batch["history/action"])] if self.sizes.actuators else []
        if self.fingertips is not None:
            rows.append(self._tips(self.fingertips, batch["history/joint_position"].to(poses.dtype), poses[:, -1]))
        features = torch.cat(rows, dim=-1)
        features = torch.where(pad[..., None], torch.zeros_like(features), features)
        return torch.cat([features, (~pad)[..., None].to(features.dtype)], dim=-1)

    def _tips(self, fingertips: Fingertips, joints: Tensor, present_pose: Tensor) -> Tensor:
        """Return where the fingertips are from the object's present position `(B, T, 3 F)`, hand-sized about one."""
        offsets = fingertips(joints) - present_pose[:, None, None, :3]
        return offsets.flatten(-2) / HAND_SCALE_M

    def _contact(self, batch: Batch, pad: Tensor) -> Tensor:
        """Return the past contact as -1 and 1, 0 where padded."""
        dtype = self.increment_scale.dtype
        rows = [batch["history/contact"][..., None]] if self.config.contact_history else []
        rows += [batch["history/fingertip_contact"]] if self.config.fingertip_contact else []
        if not rows:
            return torch.zeros(*pad.shape, 0, dtype=dtype, device=pad.device)
        signs = 2 * torch.cat([row.to(dtype) for row in rows], dim=-1) - 1
        return torch.where(pad[..., None], torch.zeros_like(signs), signs)

    def _plan(self, batch: Batch) -> Tensor:
        """Return the plan, 0 at rows that are padded; planned row k is the episode's row t + k."""
        if not self.plan_size:
            size = (len(batch["history_pad"]), self.sizes.horizon, 0)
            return torch.zeros(size, dtype=self.increment_scale.dtype, device=batch["history_pad"].device)
        plan = self._read("action", batch["planned/action"])
        if self.fingertips is not None:
            present_joints, actions = batch["history/joint_position"][:, -1:].to(plan), batch["planned/action"].to(plan)
            joints = self.fingertips.commanded(present_joints, actions)
            tips = self._tips(self.fingertips, joints, batch["history/object_pose"][:, -1].to(plan))
            plan = torch.cat([plan, tips], dim=-1)
        if "future_pad" not in batch:
            return plan
        pad = torch.cat([batch["history_pad"][:, -1:], batch["future_pad"][:, :-1]], dim=1)
        return torch.where(pad[..., None], torch.zeros_like(plan), plan)

    def _read(self, name: str, value: Tensor) -> Tensor:
        """Return `value` normalised, within [-1, 1] where the normaliser clips."""
        values = self._normalise(name, value)
        return values.clamp(-1, 1) if self.clips else values

    def _normalise(self, name: str, value: Tensor) -> Tensor:
        """Return `value` less the centre, over the scale."""
        centre, scale = self.get_buffer(f"{name}_centre"), self.get_buffer(f"{name}_scale")
        return (value.to(centre.dtype) - centre) / scale

    def _keep(self, name: str, centre: NDArray, scale: NDArray, shape: tuple[int, ...]) -> None:
        """Register centre and scale as buffers; raise UsageError when their shape is not the data's."""
        if centre.shape != shape or scale.shape != shape:
            raise UsageError(
                f"the normaliser's scale of {name} does not fit the windows",
                expected=f"shape {shape}",
                found=f"shape {centre.shape}",
                fix="build the model with the sizes of the windows that the normaliser was fitted on",
            )
        for part, values in (("centre", centre), ("scale", scale)):
            self.register_buffer(f"{name}_{part}", torch.tensor(values, dtype=torch.float32))

    def _check(self, batch: Mapping[str, Tensor]) -> None:
        """Raise DataError when a name is missing."""
        config = self.config
        required_names = ["history_pad", "history/object_pose"]
        required_names += ["history/joint_position"] * bool(self.sizes.joints)
        required_names += ["history/action"] * bool(self.sizes.actuators)
        required_names += ["history/contact"] * config.contact_history
        required_names += ["history/fingertip_contact"] * config.fingertip_contact
        required_names += ["planned/action"] * bool(self.plan_size)
        require_names(batch, required_names)


def require_names(batch: Mapping[str, Tensor], required_names: Sequence[str]) -> None:
    """Return nothing when a batch has all of these names.

    Raises
    ------
    DataError
        When it lacks one.
    """
    absent_names = [name for name in required_names if name not in batch]
    if absent_names:
        raise DataError(
            "the windows lack what the model reads",
            expected=", ".join(required_names),
            found=f"no {', '.join(absent_names)}",
            fix="open the windows with the channels `MODEL.reads(config)` names",
        )


def known_steps(batch: Batch) -> Tensor:
    """Return where increments are known `(B, H) bool`: neither end padded, and the present row is there."""
    future, present_pad = batch["future_pad"], batch["history_pad"][:, -1:]
    pad_before = torch.cat([present_pad, future[:, :-1]], dim=1)
    return ~(future | pad_before | present_pad)


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean of `values` where `mask`; 0 where it is nowhere. In a share the mask is that of all processes."""
    masked_values = torch.where(mask, values, torch.zeros_like(values))
    return masked_values.sum() / mean_count(mask.sum())


def turn_points(poses: Tensor, points: Tensor) -> Tensor:
    """Return points `(B, N, 3)` of the objects' frames turned by the attitudes of `poses (B, 7)`."""
    return points @ rotation_matrix(poses[..., 3:]).transpose(-1, -2)


def _attitude_columns(poses: Tensor) -> Tensor:
    """Return attitudes as the first two columns of their matrices `(..., 6)`, which are continuous.

    Source: Y. Zhou et al., "On the continuity of rotation representations", arXiv 1812.07035, section 4.2.
    """
    return rotation_matrix(poses[..., 3:])[..., :2].flatten(-2)
