"""Configurations of the models: checked values, no torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from candata.errors import UsageError
from candata.models._contract import Sizes
from candata.schema.kinematics import HandKinematics
from candata.schema.record import Record


class HistoryConfig(Record):
    """What every model reads.

    Attributes
    ----------
    seed : int
        Seed of the first weights.
    members : int
        Nets that are trained side by side and forecast in turn: their spread says how sure they are.
    planned_actions : bool
        Whether the actions a(t..t+H-1) that will be taken are read too. Without them the forecast must guess what
        the policy will do, as the paper's does.
    world_position : bool
        Whether the object's position in the world is read, beside its path relative to the present. It says where
        the hand is when the wrist's joints are in the world, and how high the table. Without it the forecast is the
        same wherever the episode happens.
    contact_history : bool
        Whether the past of the hand contact is read.
    fingertip_contact : bool
        Whether the past contact of each fingertip is read too.
    fingertip_points : bool
        Whether it is read where the fingertips were and, with planned actions, where these will put them, relative to
        the object's present position. Nothing is read without `hand`.
    hand : HandKinematics or None
        How the joints move the fingertips. `candata train` reads it off the scene that the recordings name.
    """

    seed: int = Field(default=0, ge=0, lt=2**64)
    members: int = Field(default=1, ge=1)
    planned_actions: bool = True
    world_position: bool = True
    contact_history: bool = False
    fingertip_contact: bool = False
    fingertip_points: bool = False
    hand: HandKinematics | None = None

    @property
    def reads_hand(self) -> bool:
        """Whether `hand` is of use."""
        return self.fingertip_points


class MlpConfig(HistoryConfig):
    """Configuration of `mlp`: width and number of hidden layers."""

    fingertip_points: bool = True
    width: int = Field(default=512, ge=1)
    layers: int = Field(default=3, ge=1)


class ParticleConfig(Record):
    """Configuration of `particle`.

    Attributes
    ----------
    seed : int
        Seed of the first weights.
    planned_actions : bool
        Whether the actions that will be taken move the fingertips; without them the last command stays.
    hand : HandKinematics or None
        How the joints move the fingertips, and how high the table is. `candata train` reads it off the scene that the
        recordings name; without it nothing pushes the object.
    particles : int
        Points of the cloud that are moved.
    cells : int
        Cells of the grid along the object's diameter.
    width : int
        Features of a particle and of a node.
    unrolled_steps : int
        Steps that the loss is taken over.
    friction : float
        Coefficient between the object and what pushes it.
    random_yaw : bool
        Whether each window is turned about the vertical by chance while training.
    """

    seed: int = Field(default=0, ge=0, lt=2**64)
    planned_actions: bool = True
    hand: HandKinematics | None = None
    particles: int = Field(default=256, ge=4)
    cells: int = Field(default=12, ge=1, le=32)
    width: int = Field(default=128, ge=1)
    unrolled_steps: int = Field(default=5, ge=1)
    friction: float = Field(default=0.5, ge=0)
    random_yaw: bool = True

    @property
    def reads_hand(self) -> bool:
        """Whether `hand` is of use."""
        return True


class UnetConfig(HistoryConfig):
    """Configuration of `unet`: the encoder of the history, and a U-Net over the horizon.

    Attributes
    ----------
    latent : int
        Size of the fused state z.
    temporal_width : int
        Channels of the encoder over the history.
    point_widths : tuple of int
        The shared MLP of the cloud's encoder.
    cloud : str
        `object`: the cloud is encoded in the object's frame, once for each distinct cloud of a batch, and its pose
        enters the fusion. `world`: each window's cloud is turned with the present pose first, as in the paper.
        `none`: no cloud.
    cloud_points : int or None
        Read only so many of the cloud's points; None is all.
    widths, kernel, groups : U-Net
        Channels of its levels, kernel over the horizon, groups of the norms.
    """

    latent: int = Field(default=512, ge=1)
    temporal_width: int = Field(default=128, ge=1)
    point_widths: tuple[int, ...] = Field(default=(64, 128, 1024), min_length=1)
    cloud: Literal["object", "world", "none"] = "object"
    cloud_points: int | None = Field(default=None, ge=1)
    widths: tuple[int, ...] = Field(default=(128, 256, 512), min_length=1)
    kernel: int = Field(default=5, ge=1)
    groups: int = Field(default=8, ge=1)

    @field_validator("widths", "point_widths")
    @classmethod
    def _positive(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        """Return the widths; all must be at least 1."""
        if min(value) < 1:
            raise ValueError("every width must be at least 1")
        return value

    @field_validator("kernel")
    @classmethod
    def _check_odd(cls, value: int) -> int:
        """Return the kernel; an even one would shift the sequence."""
        if value % 2 == 0:
            raise ValueError("the kernel must be odd")
        return value

    @model_validator(mode="after")
    def _check_groups(self) -> Self:
        """Return the configuration; groups must divide widths."""
        if any(width % self.groups for width in (*self.widths, self.temporal_width)):
            raise ValueError(f"groups {self.groups} must divide every one of widths and temporal_width")
        return self


class DiffusionConfig(UnetConfig):
    """Configuration of `diffusion_unet`.

    Attributes
    ----------
    time_features : int
        Features of the diffusion time.
    train_steps : int
        Steps of the squared-cosine noise schedule.
    target : str
        What the network predicts: the clean increments (`x0`), or the noise (`epsilon`).
    epsilon_range : float
        For `epsilon` so many standard deviations are scaled to [-1, 1], and forecasts are clipped there.
    sampler : str
        `ddim` or `ddpm`.
    sampling_steps : int
        Steps a forecast takes unless told otherwise.
    """

    time_features: int = Field(default=256, ge=2)
    train_steps: int = Field(default=100, ge=1)
    target: Literal["x0", "epsilon"] = "x0"
    epsilon_range: float = Field(default=8.0, gt=0)
    sampler: Literal["ddim", "ddpm"] = "ddim"
    sampling_steps: int = Field(default=10, ge=1)

    @model_validator(mode="after")
    def _check_steps(self) -> Self:
        """Return the configuration; a forecast cannot take more steps than trained."""
        if self.sampling_steps > self.train_steps:
            raise ValueError("sampling_steps must not exceed train_steps")
        return self


class ContactConfig(DiffusionConfig):
    """Configuration of `contact_diffusion`.

    Attributes
    ----------
    contact_features : int
        Size of the contact feature f_c.
    contact_grad : str
        `full`: the diffusion loss trains the contact head too; `stop`: only the contact loss does.
    contact_input : str
        Which contact the denoiser is trained on: `predicted`, the recorded (`true`), or `mixed`: for each window one
        of the two by chance. A forecast always uses the predicted one.
    diffusion_weight : float
        Lambda in L = L_contact + lambda L_diffusion.
    """

    contact_history: bool = True
    contact_features: int = Field(default=64, ge=1)
    contact_grad: Literal["full", "stop"] = "full"
    contact_input: Literal["predicted", "true", "mixed"] = "predicted"
    diffusion_weight: float = Field(default=1.0, ge=0)


#: Fields of `unet` that differ from the defaults, by preset. `small` trains usefully in minutes on two cores; `paper`
#: reads only past actions and turns the cloud with the pose, as arXiv 2601.12796 says.
UNET_PRESETS: Mapping[str, Mapping[str, Any]] = {
    "small": {
        "latent": 128,
        "temporal_width": 64,
        "point_widths": (32, 64, 128),
        "cloud_points": 128,
        "widths": (32, 64, 128),
    },
    "base": {},
    "paper": {"widths": (256, 512, 1024), "planned_actions": False, "cloud": "world"},
}
#: The same for the models that denoise; `paper` forecasts the noise, as arXiv 2601.12796 says.
DIFFUSION_PRESETS: Mapping[str, Mapping[str, Any]] = {
    "small": {**UNET_PRESETS["small"], "time_features": 64},
    "base": UNET_PRESETS["base"],
    "paper": {**UNET_PRESETS["paper"], "target": "epsilon"},
}


def parser(kind: type[Record]) -> Callable[[Mapping[str, Any]], Record]:
    """Return the function that makes a configuration of `kind` from plain values, or raises UsageError."""
    return lambda values: kind.parse(dict(values), "model configuration")


def check_sizes(config: HistoryConfig | ParticleConfig, sizes: Sizes) -> None:
    """Return nothing when a model of this configuration can be built for such data.

    Raises
    ------
    UsageError
        When a size is impossible, or the data hold no clouds and the configuration reads them.
    """
    if sizes.history < 1 or sizes.horizon < 1:
        raise UsageError(
            "windows too short",
            expected="history and horizon of at least 1",
            found=f"history {sizes.history}, horizon {sizes.horizon}",
        )
    reads_clouds = config.cloud != "none" if isinstance(config, UnetConfig) else isinstance(config, ParticleConfig)
    if reads_clouds and sizes.points < 1:
        raise UsageError(
            "the data hold no point clouds",
            expected="a cloud for each object",
            found="0 points",
            fix="add clouds to the dataset, or "
            + (
                "set the model's `cloud` to `none`"
                if isinstance(config, UnetConfig)
                else "take a model that reads none"
            ),
        )
