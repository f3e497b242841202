"""`particle`: the rigid particle-grid baseline: particles move a grid, the hand and the table push it, one motion fits.

Each step encodes the object's surface particles, takes the mean of their features to the nodes of a grid in the
object's box, maps each node to a velocity, lets fingertips and support push the nodes, takes the velocities back to the
particles, and fits one rigid motion to them. It reads no contact and samples nothing.

Sources: the particle baseline of "Contact-Aware Neural Dynamics", arXiv 2601.12796, which says little of it; K. Zhang
et al., "Particle-Grid Neural Dynamics", arXiv 2506.15680 (particles, grid, colliders on it), which is for soft bodies;
C. Qi et al., "PointNet", arXiv 1612.00593, section 4.2 (features of a particle beside the maximum over all).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from candata.errors import UsageError
from candata.loaders import Normaliser
from candata.models._config import ParticleConfig, check_sizes, parser
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.models._diffusion import uniform
from candata.models._encoders import chosen_clouds, mlp
from candata.models._inputs import masked_mean, require_names
from candata.models._kinematics import Fingertips
from candata.models._poses import multiply, rotation_exp, rotation_log, rotation_matrix
from candata.models._rigid import best_rotation
from candata.models._seed import with_seed

#: Nodes along each axis that a key has room for: the box is `cells` wide, and a turned one may reach past it.
_KEY = 64


class Body(NamedTuple):
    """The object of B windows as P particles, in axes turned by each window's yaw.

    Attributes
    ----------
    points : (B, P, 3)
        Particles in the object's frame [m].
    particles, previous : (B, P, 3)
        Particles at present and one step before [m].
    diameter : (B, 1, 1)
        Of the object [m].
    has_cloud : (B, 1, 1) bool
        False where the window has no cloud: nothing is known of the object, and it stays.
    """

    points: Tensor
    particles: Tensor
    previous: Tensor
    diameter: Tensor
    has_cloud: Tensor


class Particle(nn.Module):
    """Moves particles step by step; every step is one rigid motion."""

    scale: Tensor

    def __init__(self, config: ParticleConfig, sizes: Sizes, normaliser: Normaliser) -> None:
        super().__init__()
        self.config, self.sizes = config, sizes
        if normaliser.increments is None:
            raise UsageError("the normaliser has no scale of pose increments", expected="windows with object_pose")
        _, scale = normaliser.increments.arrays()
        self.register_buffer("scale", torch.tensor(float(scale[:, :3].mean())))
        self.support_m = None if config.hand is None else config.hand.support_height_m
        if config.hand is not None:
            self.fingertips = Fingertips(config.hand)
        width = config.width
        self.encoder = mlp(3 + 3 + 1 + 6 * (config.hand is not None), width, width)
        self.node = mlp(2 * width + 3, width, width, 3)
        for parameter in self.node[-1].parameters():
            nn.init.zeros_(parameter)  # the first forecast is that the object stays

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `loss`, the mean squared error of the particles over the unrolled steps, in scales of a step."""
        angle = uniform((len(batch["history_pad"]), 1), self.scale, generator)
        angle = angle * (2 * torch.pi if self.config.random_yaw else 0.0)
        yaw = rotation_exp(torch.cat([torch.zeros_like(angle), torch.zeros_like(angle), angle], dim=-1))
        steps = min(self.config.unrolled_steps, self.sizes.horizon)
        is_known = ~(batch["future_pad"][:, :steps] | batch["history_pad"][:, -1:])
        present = batch["history/object_pose"][:, -1:]
        future = torch.where(is_known[..., None], batch["future/object_pose"][:, :steps], present)
        body = self._body(batch, yaw)
        truth = [_placed(_turned(future[:, k].to(self.scale.dtype), yaw), body.points) for k in range(steps)]
        particles, _ = self._rollout(batch, body, yaw, steps)
        error = ((particles - torch.stack(truth, dim=1)) / self.scale).square().mean((2, 3))
        return {"loss": masked_mean(error, is_known & body.has_cloud[:, :, 0])}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return the one forecast, `samples` times; `steps` and `generator` change nothing."""
        upright = self.scale.new_tensor([1.0, 0, 0, 0]).expand(len(batch["history_pad"]), 4)
        body = self._body(batch, upright)
        _, increments = self._rollout(batch, body, upright, self.sizes.horizon)
        increments = torch.where(body.has_cloud, increments, torch.zeros_like(increments))
        return Forecast(increments.expand(samples, *increments.shape), None)

    def _rollout(self, batch: Batch, body: Body, yaw: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """Return the particles `(B, steps, P, 3)` [m] and the increments `(B, steps, 6)` [m, rad] of the body."""
        tips = self._tips(batch, yaw, steps)
        pose = _turned(batch["history/object_pose"][:, -1].to(self.scale.dtype), yaw)
        position, particles, previous = pose[:, None, :3], body.particles, body.previous
        courses, increments = [], []
        for k in range(steps):
            wanted = particles + self._velocity(particles, previous, body.diameter, tips[:, k : k + 2])
            centre, wanted_centre = particles.mean(1, keepdim=True), wanted.mean(1, keepdim=True)
            turn = best_rotation((particles - centre) / body.diameter, (wanted - wanted_centre) / body.diameter)
            rotation = rotation_matrix(turn).transpose(1, 2)
            next_position = (position - centre) @ rotation + wanted_centre
            increments.append(torch.cat([(next_position - position)[:, 0], rotation_log(turn)], dim=-1))
            position, previous = next_position, particles
            particles = (particles - centre) @ rotation + wanted_centre
            courses.append(particles)
        return torch.stack(courses, dim=1), torch.stack(increments, dim=1)

    def _velocity(self, particles: Tensor, previous: Tensor, diameter: Tensor, tips: Tensor) -> Tensor:
        """Return how far each particle would move in the step `(B, P, 3)` [m] if the body were not rigid.

        `tips (B, 2, F, 3)` are the fingertips at its beginning and end.
        """
        count, centre = len(particles), particles.mean(1, keepdim=True)
        local = (particles - centre) / diameter
        height = self._height(particles)
        columns = [2 * local, (particles - previous) / self.scale, (height / diameter).clamp(-1, 1)]
        if tips.shape[2]:
            columns += self._nearest_tip(particles, diameter, tips)
        features = self.encoder(torch.cat(columns, dim=-1))
        cells = (local * self.config.cells).floor()
        window = torch.arange(count, device=cells.device)[:, None]
        index = (cells.detach().long() + _KEY // 2).clamp(0, _KEY - 1)
        key = ((window * _KEY + index[..., 0]) * _KEY + index[..., 1]) * _KEY + index[..., 2]
        nodes, node_of = torch.unique(key.flatten(), return_inverse=True)
        members = torch.bincount(node_of, minlength=len(nodes))[:, None]
        sums = features.new_zeros(len(nodes), features.shape[-1]).index_add(0, node_of, features.flatten(0, 1))
        owner = nodes // _KEY**3
        index = torch.stack([nodes // _KEY**2, nodes // _KEY, nodes], dim=-1) % _KEY - _KEY // 2
        place = (index + 0.5) / self.config.cells
        whole = features.amax(1)[owner]
        velocity = self.scale * self.node(torch.cat([sums / members, whole, 2 * place], dim=-1))
        position = centre[owner, 0] + place * diameter[owner, 0]
        velocity = self._pushed(velocity, position, diameter[owner, 0] / self.config.cells, tips[owner])
        return velocity[node_of].unflatten(0, particles.shape[:2])

    def _pushed(self, velocity: Tensor, position: Tensor, cell: Tensor, tips: Tensor) -> Tensor:
        """Return the velocities of nodes `(n, 3)` [m a step] that neither enter the nearest fingertip nor the support.

        `cell (n, 1)` is the width of a cell [m]; `tips (n, 2, F, 3)` are the fingertips of each node's window, at the
        beginning and the end of the step. A fingertip touches the nodes within a cell of the path of its ball.
        """
        if tips.shape[2]:
            begin, moved = tips[:, 0], tips[:, 1] - tips[:, 0]
            apart = position[:, None] - begin
            along = ((apart * moved).sum(-1) / moved.square().sum(-1).clamp_min(1e-12)).clamp(0, 1)
            gap = (apart - along[..., None] * moved).norm(dim=-1) - self.fingertips.radius - cell
            gap, nearest = gap.min(dim=-1)
            rows = torch.arange(len(gap), device=gap.device)
            normal = nn.functional.normalize(apart[rows, nearest], dim=-1)
            velocity = _blocked(velocity, moved[rows, nearest], normal, gap < 0, self.config.friction)
        if self.support_m is not None:
            up = velocity.new_tensor([0.0, 0, 1]).expand_as(velocity)
            is_low = position[:, 2] + velocity[:, 2] - cell[:, 0] / 2 < self.support_m
            velocity = _blocked(velocity, torch.zeros_like(velocity), up, is_low, self.config.friction)
        return velocity

    def _nearest_tip(self, particles: Tensor, diameter: Tensor, tips: Tensor) -> list[Tensor]:
        """Return where the nearest fingertip of each particle will be, and how it moves `(B, P, 3)`, scaled.

        arXiv 2506.15680 shows its networks no gripper. One rigid motion averages a push over the whole body, so that
        the collider alone would hardly move it.
        """
        begin, end = tips[:, 0], tips[:, 1]
        nearest = torch.cdist(particles, end).argmin(dim=-1)
        window = torch.arange(len(particles), device=particles.device)[:, None]
        offset = (end[window, nearest] - particles) / diameter
        return [offset.clamp(-1, 1), (end - begin)[window, nearest] / self.scale]

    def _height(self, particles: Tensor) -> Tensor:
        """Return the height above the support `(B, P, 1)` [m]; 0 where there is none."""
        height = particles[..., 2:]
        return torch.zeros_like(height) if self.support_m is None else height - self.support_m

    def _body(self, batch: Batch, yaw: Tensor) -> Body:
        """Return the object at present and one step before."""
        planned = ["planned/action"] * (self.config.planned_actions and self.config.hand is not None)
        require_names(
            batch, ["history_pad", "history/object_pose", "history/joint_position", "history/action", *planned]
        )
        points, has_cloud = chosen_clouds(batch, self.config.particles)
        poses = batch["history/object_pose"].to(self.scale.dtype)
        previous = poses[:, -2:][:, 0]
        previous = torch.where(batch["history_pad"][:, -2:][:, :1], poses[:, -1], previous)
        radius = (points - points.mean(1, keepdim=True)).norm(dim=-1).amax(1)
        return Body(
            points,
            _placed(_turned(poses[:, -1], yaw), points),
            _placed(_turned(previous, yaw), points),
            2 * radius[:, None, None].clamp_min(1e-6),
            has_cloud[:, None, None],
        )

    def _tips(self, batch: Batch, yaw: Tensor, steps: int) -> Tensor:
        """Return the fingertips `(B, steps + 1, F, 3)` [m] from the present on; F is 0 where the hand is not known.

        The joints move as their commands do from the one that led to the present: what holds a finger back holds on.
        Without planned actions the last command stays.
        """
        count = len(batch["history_pad"])
        if self.config.hand is None:
            return self.scale.new_zeros(count, steps + 1, 0, 3)
        joints, actions = (batch[f"history/{name}"].to(self.scale.dtype) for name in ("joint_position", "action"))
        now = actions[:, -1:]
        before = torch.where(batch["history_pad"][:, -2:][:, :1, None], now, actions[:, -2:][:, :1])
        if self.config.planned_actions:
            plan = batch["planned/action"][:, :steps].to(now.dtype)
            if "future_pad" in batch:
                pad = torch.cat([batch["history_pad"][:, -1:], batch["future_pad"][:, : steps - 1]], dim=1)
                plan = torch.where(pad[..., None], before, plan)
        else:
            plan = now.expand(-1, steps, -1)
        commands = torch.cat([before, plan], dim=1)
        present = joints[:, -1:]
        moved = self.fingertips.commanded(present, commands) - self.fingertips.commanded(present, before)
        return self.fingertips(present + moved) @ rotation_matrix(yaw)[:, None].transpose(-1, -2)


def _blocked(velocity: Tensor, wall: Tensor, normal: Tensor, touches: Tensor, friction: float) -> Tensor:
    """Return velocities `(n, 3)` that do not enter a wall which moves with `wall`; Coulomb friction slows the sliding.

    Source: arXiv 2506.15680; the law is that of A. Stomakhin et al., "A material point method for snow
    simulation", ACM TOG 32(4), 2013, section 8.
    """
    relative = velocity - wall
    closing = (relative * normal).sum(-1, keepdim=True)
    sliding = relative - closing * normal
    speed = sliding.square().sum(-1, keepdim=True).clamp_min(1e-12).sqrt()
    slowed = sliding * (1 + friction * closing / speed).clamp_min(0)
    return torch.where(touches[:, None] & (closing < 0), wall + slowed, velocity)


def _turned(pose: Tensor, yaw: Tensor) -> Tensor:
    """Return poses `(B, 7)` in a world turned about the vertical by the quaternions `yaw (B, 4)`."""
    position = (rotation_matrix(yaw) @ pose[:, :3, None])[..., 0]
    return torch.cat([position, multiply(yaw, pose[:, 3:])], dim=-1)


def _placed(pose: Tensor, points: Tensor) -> Tensor:
    """Return points `(B, P, 3)` of the objects' frames in the world."""
    return points @ rotation_matrix(pose[:, 3:]).transpose(1, 2) + pose[:, None, :3]


def _build(config: ParticleConfig, sizes: Sizes, normaliser: Normaliser) -> Particle:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_seed(config.seed, lambda: Particle(config, sizes, normaliser))


MODEL = Model(
    "rigid particle-grid baseline: fingertips push the object's particles",
    ("object_pose", "joint_position", "action"),
    {
        "small": ParticleConfig(particles=64, width=48),
        "base": ParticleConfig(),
        "paper": ParticleConfig(planned_actions=False),
    },
    parser(ParticleConfig),
    _build,
)
