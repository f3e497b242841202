"""Records of what disturbs an episode: noise on its commands, and kicks at random moments."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from candata.schema.record import Record

#: Shortest time between kicks [s], and their largest sizes [m/s, rad/s]. Chosen: a tenth of a control step of a fast
#: hand, and what a thrown ball has.
LEAST_INTERVAL_S, MOST_SPEED_M_S, MOST_TURN_RAD_S = 0.001, 30.0, 300.0
Vector = tuple[float, float, float]


class Kick(Record):
    """A kick that an episode got: the velocity it added to the object, or to the hand, along and about world axes."""

    time_s: Annotated[float, Field(ge=0)]
    target: Literal["object", "hand"]
    speed_m_s: Vector
    turn_rad_s: Vector


class KickDraw(Record):
    """How kicks are drawn: the time to the next is uniform in `interval_s` [s].

    Directions are isotropic. Sizes are uniform from 0 to `speed_m_s` [m/s] and `turn_rad_s` [rad/s].
    """

    interval_s: tuple[Annotated[float, Field(ge=LEAST_INTERVAL_S)], Annotated[float, Field(ge=LEAST_INTERVAL_S)]]
    speed_m_s: Annotated[float, Field(ge=0, le=MOST_SPEED_M_S)] = 0.0
    turn_rad_s: Annotated[float, Field(ge=0, le=MOST_TURN_RAD_S)] = 0.0

    @model_validator(mode="after")
    def _is_kick(self) -> Self:
        """Refuse an interval in the wrong order, and kicks that move nothing."""
        if self.interval_s[0] > self.interval_s[1]:
            raise ValueError("the shortest interval comes first")
        if not self.speed_m_s and not self.turn_rad_s:
            raise ValueError("expected speed_m_s or turn_rad_s above 0")
        return self


class CommandNoise(Record):
    """White Gaussian noise on each command of a position servo, one standard deviation.

    `joint_rad` [rad] is that of the fingers' hinges. `hand_m` [m] is how far each rail that carries the hand moves it,
    or all hinges that carry it together.
    """

    joint_rad: Annotated[float, Field(ge=0)] = 0.0
    hand_m: Annotated[float, Field(ge=0)] = 0.0


class Disturbances(Record):
    """What disturbs each episode of a set; null for nothing of the kind."""

    command_noise: CommandNoise | None = None
    object_kicks: KickDraw | None = None
    hand_kicks: KickDraw | None = None
