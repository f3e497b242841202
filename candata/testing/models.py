"""What every model keeps: shapes, seeds, pads, plain configurations, a state that can be saved; and it learns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch

from candata.errors import UsageError
from candata.loaders import Normaliser, Scale
from candata.models import MODELS, Model, Sizes, integrate
from candata.schema.channels import CHANNELS
from candata.schema.record import Record
from candata.testing._claims import refusal_of, require, require_words

SIZES = Sizes(history=4, horizon=8, joints=3, actuators=2, fingertips=2, points=20)
#: Fields that make the built-in models tiny; of another model, those it has are set.
TINY_FIELDS: Mapping[str, Any] = {
    "latent": 32,
    "temporal_width": 16,
    "point_widths": (8, 16),
    "widths": (16, 32),
    "time_features": 16,
    "width": 32,
    "layers": 2,
    "random_yaw": False,
    "particles": 16,
    "unrolled_steps": 2,
}


def made_up_normaliser(sizes: Sizes = SIZES, increments: Scale | None = None) -> Normaliser:
    """Return made-up scales: positions 0.2 m about 0.1, joints and actions 0.5 about 0.5, steps of 1 cm about 1 mm."""
    return Normaliser(
        method="robust",
        dataset="made-up",
        digest="",
        episodes=1,
        rows=1,
        windows=1,
        rate_hz=10,
        horizon=sizes.horizon,
        channels={
            "object_pose": _scale(0.1, 0.2, 7),
            "joint_position": _scale(0.5, 0.5, sizes.joints),
            "action": _scale(0.5, 0.5, sizes.actuators),
        },
        increments=increments or _scale(0.001, 0.01, sizes.horizon, 6),
    )


def made_up_batch(count: int = 5, seed: int = 0, sizes: Sizes = SIZES, clouds: int = 2) -> dict[str, torch.Tensor]:
    """Return random windows without pads: steps of about 1 cm and 10 mrad, as tensors in SI units."""
    g = generator(seed)
    rows, horizon = sizes.history, sizes.horizon
    start = torch.cat([0.2 * torch.randn(count, 3, generator=g), _unit(torch.randn(count, 4, generator=g))], dim=-1)
    poses = integrate(start, 0.01 * torch.randn(count, rows + horizon, 6, generator=g))
    return {
        "history/object_pose": poses[:, :rows],
        "future/object_pose": poses[:, rows:],
        "history/joint_position": torch.randn(count, rows, sizes.joints, generator=g),
        "history/action": torch.randn(count, rows, sizes.actuators, generator=g),
        "planned/action": torch.randn(count, horizon, sizes.actuators, generator=g),
        "history/contact": torch.rand(count, rows, generator=g) < 0.5,
        "future/contact": torch.rand(count, horizon, generator=g) < 0.5,
        "history/fingertip_contact": torch.rand(count, rows, sizes.fingertips, generator=g) < 0.5,
        "simulated/object_pose": integrate(poses[:, rows - 1], 0.01 * torch.randn(count, horizon, 6, generator=g)),
        "simulated/contact": (torch.rand(count, horizon, generator=g) < 0.5).float(),
        "history_pad": torch.zeros(count, rows, dtype=torch.bool),
        "future_pad": torch.zeros(count, horizon, dtype=torch.bool),
        "cloud": torch.arange(count) % clouds,
        "clouds": 0.05 * torch.randn(clouds, sizes.points, 3, generator=g),
    }


def tiny_config(model: Model, **fields: Any) -> Record:
    """Return a configuration of a model that trains in seconds, as far as it has the built-in models' fields."""
    preset = model.presets["small"].model_dump(mode="json")
    return model.parse(preset | {name: value for name, value in TINY_FIELDS.items() if name in preset} | fields)


def generator(seed: int = 0) -> torch.Generator:
    """Return a fresh generator."""
    return torch.Generator().manual_seed(seed)


class ModelConformance:
    """Conformance of one model.

    Attributes
    ----------
    model : Model
        The constant of the plug-in.
    config : mapping
        Fields that differ from the preset `small`, to make it tiny: a few steps must take seconds.
    learning_steps, learning_rate : int, float
        Steps of AdamW after which the loss on one batch must be half.
    """

    model: ClassVar[Model]
    config: ClassVar[Mapping[str, Any]] = {}
    learning_steps: ClassVar[int] = 80
    learning_rate: ClassVar[float] = 1e-2

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is; its channels are those of the schema."""
        require_words(MODELS, self.model)
        unknown_channels = {*self.model.channels, *self.model.optional.values()} - set(CHANNELS)
        require(not unknown_channels, f"channels that no dataset has: {', '.join(sorted(unknown_channels))}")

    def test_its_configurations_are_plain_values(self) -> None:
        """A run keeps them as JSON; `small` is what `candata train` takes by default, and `seed` the run's."""
        require("small" in self.model.presets, "there is no preset `small`")
        for name, preset in self.model.presets.items():
            read_back = self.model.parse(preset.model_dump(mode="json"))
            require(read_back == preset, f"preset {name} does not come back from plain values")
            require(set(self.model.reads(preset)) <= set(CHANNELS), f"preset {name} reads what is no channel")
            require("seed" in preset.model_dump(), f"preset {name} has no `seed`")

    def test_a_wrong_field_is_refused(self) -> None:
        """With an error that names it."""
        error = refusal_of(lambda: self.model.parse({"no_such_field": 1}), "a field that does not exist")
        names_field = isinstance(error, UsageError) and "no_such_field" in str(error)
        require(names_field, f"the error does not name the field: {error}")

    def test_forecasts_have_their_shapes_and_are_finite(self) -> None:
        """`(M, B, H, 6) float32`, contact `(B, H)` between 0 and 1 or None, and no gradient is kept."""
        state = torch.random.get_rng_state()
        net = self._build()
        forecast = net.forecast(made_up_batch(5), 3, 4, generator())
        shape = (3, 5, SIZES.horizon, 6)
        require(
            forecast.increments.shape == shape, f"increments are {tuple(forecast.increments.shape)}, expected {shape}"
        )
        require(forecast.increments.dtype == torch.float32, f"increments are {forecast.increments.dtype}")
        require(bool(torch.isfinite(forecast.increments).all()), "increments are not finite")
        require(not forecast.increments.requires_grad, "a forecast keeps gradients: use torch.no_grad")
        if forecast.contact is not None:
            require(
                forecast.contact.shape == shape[1:3], f"contact is {tuple(forecast.contact.shape)}, expected (B, H)"
            )
            is_probability = bool(((forecast.contact >= 0) & (forecast.contact <= 1)).all())
            require(is_probability, "contact is no probability")
        net.losses(made_up_batch(5), generator())
        is_untouched = torch.equal(torch.random.get_rng_state(), state)
        require(is_untouched, "it draws from torch's global generator: draw from the one that is passed")

    def test_the_seed_decides_the_first_weights(self) -> None:
        """The same seed gives the same bits, another seed others."""
        weights, weights_again, other_weights = (_weights(self._build(seed=seed)) for seed in (0, 0, 1))
        require(torch.equal(weights, weights_again), "the same seed gives other first weights")
        require(not torch.equal(weights, other_weights), "the configuration's `seed` does not change the first weights")

    def test_the_generator_decides_the_rest(self) -> None:
        """Losses and forecasts repeat with a generator of the same seed."""
        net, batch = _perturbed(self._build()), made_up_batch(4)
        losses = [net.losses(batch, generator(1))["loss"].detach() for _ in range(2)]
        require(torch.equal(*losses), "the same generator gives another loss")
        forecasts = [net.forecast(batch, 3, 4, generator(1)).increments for _ in range(2)]
        require(torch.equal(*forecasts), "the same generator gives another forecast")

    def test_what_is_saved_forecasts_the_same(self) -> None:
        """All that a forecast needs lies in the state that a checkpoint keeps."""
        from safetensors.torch import load, save

        net, loaded = _perturbed(self._build()), self._build(seed=1)
        loaded.load_state_dict(load(save({k: v.contiguous().clone() for k, v in net.state_dict().items()})))
        forecast, loaded_forecast = (
            module.forecast(made_up_batch(3), 2, 3, generator()).increments for module in (net, loaded)
        )
        require(torch.equal(forecast, loaded_forecast), "a model that was saved and loaded forecasts something else")

    def test_pads_are_not_read(self) -> None:
        """Rows that are no part of the episode may hold anything."""
        net, batch = _perturbed(self._build()), made_up_batch(4)
        batch["future_pad"][:, 5:] = True
        loss = net.losses(batch, generator())["loss"].detach()
        batch["future/object_pose"][:, 5:] = torch.nan
        batch["planned/action"][:, 6:] = torch.nan
        padded_loss = net.losses(batch, generator())["loss"].detach()
        require(torch.equal(loss, padded_loss), "what lies behind the end of an episode changes the loss")
        batch = made_up_batch(4)
        batch["history_pad"][:, :2] = True
        forecast = net.forecast(batch, 1, 2, generator()).increments
        for channel in ("history/object_pose", "history/joint_position", "history/action"):
            batch[channel][:, :2] = torch.nan
        padded_forecast = net.forecast(batch, 1, 2, generator()).increments
        require(torch.equal(forecast, padded_forecast), "what lies before the start of an episode changes the forecast")

    def test_a_forecast_does_not_read_the_future(self) -> None:
        """What was recorded after the present is not there when a forecast is made."""
        net, batch = _perturbed(self._build()), made_up_batch(4)
        forecast = net.forecast(batch, 1, 2, generator()).increments
        present_batch = {name: value for name, value in batch.items() if not name.startswith("future/")}
        blind_forecast = net.forecast(present_batch, 1, 2, generator()).increments
        require(torch.equal(forecast, blind_forecast), "the recorded future changes the forecast")

    def test_it_learns_one_batch(self) -> None:
        """The loss is finite, reaches every weight, and falls to half on a batch that is seen again and again."""
        net, batch = self._build(), made_up_batch(4)
        optimiser = torch.optim.AdamW(net.parameters(), lr=self.learning_rate, weight_decay=0.0)
        history, reached_weights = [], set()
        for step in range(self.learning_steps):
            loss = net.losses(batch, generator(step))["loss"]
            optimiser.zero_grad()
            loss.backward()
            reached_weights |= {name for name, p in net.named_parameters() if p.grad is not None and bool(p.grad.any())}
            optimiser.step()
            history.append(float(loss.detach()))
        require(np.isfinite(history).all(), f"the loss is not finite: {history[:5]}")
        unreached_weights = {name for name, _ in net.named_parameters()} - reached_weights
        require(
            not unreached_weights, f"weights that the loss never reaches: {', '.join(sorted(unreached_weights)[:5])}"
        )
        begin, end = np.mean(history[:10]), np.mean(history[-10:])
        require(end < begin / 2, f"the loss on one batch falls from {begin:.3g} to {end:.3g} only")

    def _build(self, **fields: Any) -> Any:
        """Return a tiny module of the model."""
        return self.model.build(tiny_config(self.model, **{**self.config, **fields}), SIZES, made_up_normaliser())


def _scale(centre: float, size: float, *shape: int) -> Scale:
    """Return the same scale for each number of a channel."""
    count = int(np.prod(shape))
    return Scale(shape=shape, centre=(centre,) * count, scale=(size,) * count)


def _unit(q: torch.Tensor) -> torch.Tensor:
    """Return quaternions of norm 1."""
    return q / q.norm(dim=-1, keepdim=True)


def _weights(module: torch.nn.Module) -> torch.Tensor:
    """Return all weights as one vector."""
    return torch.cat([p.detach().flatten() for p in module.parameters()])


def _perturbed(module: Any) -> Any:
    """Return the module with every weight off its start, so that outputs that start at zero show something."""
    with torch.no_grad():
        for number, parameter in enumerate(module.parameters()):
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator(number))
    return module
