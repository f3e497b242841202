"""Records of `scene.yaml` and `map.yaml`, the files users write."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from candata.schema.record import Record

Positive = Annotated[float, Field(gt=0)]
#: Rows a second; within it times in ns hold what a step says.
Rate = Annotated[float, Field(gt=1e-6, lt=1e9)]
NonNegative = Annotated[float, Field(ge=0)]


class Servo(Record):
    """A position servo to add to a joint of a model that has no actuators (a URDF)."""

    kp: Positive
    kv: NonNegative = 0.0
    limit: Positive | None = None


class Tracker(Record):
    """The tracker that reports the object's pose, where it is slower than the log, late, or loses the object.

    `rate_hz` are its readings a second; a log that is no faster has one in each row. `delay_s` passes from capture to
    arrival. `drift` is the standard deviation of a random walk after 1 s: it grows with the root of the time
    [m/sqrt(s), rad/sqrt(s)]. `dropout_share` of the time no pose is known, for `dropout_s` on average.
    """

    rate_hz: Rate
    delay_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    drift: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    dropout_share: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    dropout_s: Positive = 0.2


class Noise(Record):
    """Declared sensor noise, one standard deviation: the declared floor.

    `object_pose` is (position m, rotation rad), `joint_position` rad or m, one number or one a joint,
    `joint_velocity` [rad/s or m/s] and `joint_effort` [N m or N] alike, `fingertip_force` N. `force_step` [N] and
    `joint_step` [rad or m, as `joint_position`] are the steps to which readings are rounded. `tracker` is applied to
    simulated episodes; a diagnosis finds slow readings and gaps in the recordings themselves.
    """

    object_pose: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    joint_position: NonNegative | tuple[NonNegative, ...] = 0.0
    fingertip_force: NonNegative = 0.0
    force_step: NonNegative = 0.0
    joint_step: NonNegative | tuple[NonNegative, ...] = Field(default=0.0, exclude_if=lambda step: step == 0.0)
    joint_velocity: NonNegative | tuple[NonNegative, ...] = Field(default=0.0, exclude_if=lambda sd: sd == 0.0)
    joint_effort: NonNegative | tuple[NonNegative, ...] = Field(default=0.0, exclude_if=lambda sd: sd == 0.0)
    tracker: Tracker | None = Field(default=None, exclude_if=lambda value: value is None)


class Repeatability(Record):
    """Declared deviations of one repeat of a motion from the next, one standard deviation, beyond sensor noise.

    They come from drift, temperature, supply or stick-slip and last for `time_s`. Units as in `Noise`.
    """

    object_pose: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    joint_position: NonNegative = 0.0
    fingertip_force: NonNegative = 0.0
    time_s: Positive = 0.5


class ArmWithHand(Record):
    """An arm that carries a hand: a model file, or the name of a registered one, each.

    `at` is the site of the arm that carries the hand; by default the flange of a registered arm.
    """

    arm: str
    hand: str
    at: str | None = None


class SceneFile(Record):
    """`scene.yaml`: an MJCF or URDF, or an arm with a hand, and the roles of what is in it."""

    model: str | ArmWithHand
    rate_hz: Rate
    object: str | None = None
    joints: tuple[str, ...] = ()
    actuators: tuple[str, ...] | dict[str, Servo] = ()
    fingertips: tuple[str, ...] = ()
    fingertip_frames: tuple[str, ...] | None = None
    support: str | None = None
    groups: dict[str, tuple[str, ...]] = {}
    noise: Noise | None = None
    repeatability: Repeatability | None = Field(default=None, exclude_if=lambda value: value is None)

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators in the order of `action`."""
        return tuple(self.actuators)


def _number_as_name(value: object) -> object:
    """Return the number of a column as its name."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


#: Name of a column; the number of one, from 0, in a table without a header.
ColumnName = Annotated[str, BeforeValidator(_number_as_name, json_schema_input_type=str | int)]


class TableMap(Record):
    """`map.yaml`: which column of a table is which channel.

    An entry of `channels` is a column or a list of them. A column that holds a list in each row stands for all of its
    numbers, `state[0:7]` or `state[0:3, 6]` for some of them, counted from 0. `joint_names`, `actuator_names` and
    `fingertip_names` name the elements where the columns do not.
    """

    file: str
    source: Literal["real", "sim"] = "real"
    episode: ColumnName | None = None
    time_s: ColumnName
    rate_hz: Rate
    scene: str | None = None
    object: str | None = None
    task: str | None = None
    channels: dict[str, ColumnName | tuple[ColumnName | tuple[ColumnName, ...], ...]]
    units: dict[ColumnName, str] = {}
    force: Literal["mean", "instant"] = "mean"
    action: Literal["next", "previous"] = "next"
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    joint_names: tuple[str, ...] = ()
    actuator_names: tuple[str, ...] = ()
    fingertip_names: tuple[str, ...] = ()
