"""`diffusion_unet`: conditional denoising diffusion over pose increments, without a forecast of contact."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from candata.loaders import Normaliser
from candata.models._config import DIFFUSION_PRESETS, DiffusionConfig, check_sizes, parser
from candata.models._contract import Batch, Forecast, Losses, Model, Sizes
from candata.models._diffusion import Process, cosine_alpha_bars, integers, normal
from candata.models._encoders import HistoryEncoder
from candata.models._inputs import Inputs, Reader, masked_mean
from candata.models._members import with_members
from candata.models._unet import UNet


class DiffusionUNet(nn.Module):
    """Encodes the history to z and denoises H pose increments under it."""

    alpha_bars: Tensor

    def __init__(
        self,
        config: DiffusionConfig,
        sizes: Sizes,
        normaliser: Normaliser,
        extra_features: int = 0,
        step_features: int = 0,
    ) -> None:
        super().__init__()
        self.config, self.sizes = config, sizes
        self.process = Process(tuple(cosine_alpha_bars(config.train_steps)), config.target, config.sampler)
        self.register_buffer("alpha_bars", torch.tensor(self.process.alpha_bars), persistent=False)
        self.unit = config.epsilon_range if config.target == "epsilon" else 1.0
        self.reader = Reader(config, sizes, normaliser)
        self.encoder = HistoryEncoder(config, sizes, self.reader)
        self.unet = UNet(
            6 + self.reader.plan_size + step_features,
            6,
            config.latent + extra_features,
            config.time_features,
            config.widths,
            config.kernel,
            config.groups,
        )

    def losses(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Return `loss`, the mean squared error of the denoiser over the steps that are known."""
        inputs = self.reader(batch)
        return {"loss": self.diffusion_loss(batch, inputs, self.encoder(batch, inputs), generator)}

    @torch.no_grad()
    def forecast(self, batch: Batch, samples: int, steps: int, generator: torch.Generator) -> Forecast:
        """Return `samples` forecasts, each by `steps` sampling steps."""
        inputs = self.reader(batch)
        return Forecast(self.sample(inputs, self.encoder(batch, inputs), samples, steps, generator), None)

    def target(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return what is denoised `(B, H, 6)`, normalised, and where it is known `(B, H)`."""
        return self.reader.target(batch)

    def diffusion_loss(self, batch: Batch, inputs: Inputs, condition: Tensor, generator: torch.Generator) -> Tensor:
        """Return the mean squared error of the denoiser at one random time a window."""
        value, is_known = self.target(batch)
        value = value / self.unit
        time = integers(self.config.train_steps, len(value), value, generator)
        level = self.alpha_bars[time][:, None, None]
        noise = normal(value.shape, value, generator)
        noisy = level.sqrt() * value + (1 - level).sqrt() * noise
        film = self.unet.window_film(condition) + self.unet.time_film(time.to(value.dtype))
        output = self._denoise(noisy, inputs.plan, film)
        target = value if self.config.target == "x0" else noise
        return masked_mean((output - target).square().mean(-1), is_known)

    def sample(self, inputs: Inputs, condition: Tensor, samples: int, steps: int, generator: torch.Generator) -> Tensor:
        """Return sampled increments `(M, B, H, 6)` [m, rad]."""
        count, horizon = len(condition), self.sizes.horizon
        by_window = self.unet.window_film(condition).repeat(samples, 1)
        plan = inputs.plan.repeat(samples, 1, 1)
        times = torch.tensor(self.process.times(steps), dtype=condition.dtype, device=condition.device)
        by_time = self.unet.time_film(times)
        increments = self.process.sample(
            lambda x, i: self._denoise(x, plan, by_window + by_time[i]),
            normal((samples * count, horizon, 6), condition, generator),
            steps,
            generator,
        )
        return self.reader.to_si(self.unit * increments.unflatten(0, (samples, count)))

    def _denoise(self, x: Tensor, plan: Tensor, film: Tensor) -> Tensor:
        """Return the network's output `(B, H, 6)`."""
        output: Tensor = self.unet(torch.cat([x, plan], dim=-1).transpose(1, 2), film)
        return output.transpose(1, 2)


def _build(config: DiffusionConfig, sizes: Sizes, normaliser: Normaliser) -> nn.Module:
    """Return the module with the first weights of the configuration's seed."""
    check_sizes(config, sizes)
    return with_members(config, lambda: DiffusionUNet(config, sizes, normaliser))


MODEL = Model(
    "denoising diffusion over pose increments, blind to contact",
    ("object_pose", "joint_position", "action"),
    {name: DiffusionConfig(**values) for name, values in DIFFUSION_PRESETS.items()},
    parser(DiffusionConfig),
    _build,
    {"contact_history": "contact", "fingertip_contact": "fingertip_contact"},
)
