"""Records of a randomisation: effects of a simulation, each with a distribution for each of its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Discriminator, Field, Tag, model_validator

from candata.schema.disturbance import Disturbances
from candata.schema.effect import Value
from candata.schema.record import Record


class Distribution(Record):
    """What a value is drawn from: one of the three, in the unit of the parameter.

    `uniform` holds the smallest and the largest value, `normal` mean and standard deviation, `choice` values that are
    all as likely. Each number of a vector is drawn on its own, except from a `choice`, whose values are whole vectors.
    """

    uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    choice: Annotated[tuple[Value, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        """Refuse none or several at once, limits in the wrong order, and a standard deviation of zero or less."""
        if sum(kind is not None for kind in (self.uniform, self.normal, self.choice)) != 1:
            raise ValueError("expected one of uniform, normal and choice")
        if self.uniform is not None and self.uniform[0] > self.uniform[1]:
            raise ValueError("the smallest value of uniform comes first")
        if self.normal is not None and self.normal[1] <= 0:
            raise ValueError("the standard deviation of normal, its second number, is above 0")
        return self


def _kind_of(value: Any) -> str:
    """Return which alternative a value is meant as, so that an error speaks of that one alone."""
    return "drawn" if isinstance(value, Mapping | Distribution) else "plain"


#: A plain value, or what it is drawn from.
PossiblyDrawn = Annotated[
    Annotated[Distribution, Tag("drawn")] | Annotated[Value, Tag("plain")], Discriminator(_kind_of)
]


class RandomEffect(Record):
    """One effect of a randomisation: `element` null means all elements it can act on.

    `share` is the probability that an episode has it. A parameter is a plain value or is drawn for each episode; one
    that is left out is that of the model. What is possible in a scene is said by who knows the scene.
    """

    name: str
    element: str | None = None
    share: Annotated[float, Field(ge=0, le=1)] = 1.0
    parameters: dict[str, PossiblyDrawn] = Field(min_length=1)


class RandomisationFile(Record):
    """A file for `generate-sim --randomise`: a scene, and effects and disturbances that are drawn for each episode.

    With `together` so many of the effects act at once, from the fewest to the most, each number and each choice as
    likely; their shares are not used then.
    """

    scene: str | None = None
    effects: tuple[RandomEffect, ...] = ()
    together: tuple[int, int] | None = Field(default=None, exclude_if=lambda value: value is None)
    disturbances: Disturbances | None = None

    @model_validator(mode="after")
    def _is_something(self) -> Self:
        """Refuse a file that draws nothing."""
        if not self.effects and self.disturbances in (None, Disturbances()):
            raise ValueError("expected effects or disturbances")
        return self

    @model_validator(mode="after")
    def _has_so_many(self) -> Self:
        """Refuse numbers of effects in the wrong order or beyond the list, and shares beside them."""
        if self.together is None:
            return self
        fewest, most = self.together
        if not 0 <= fewest <= most <= len(self.effects):
            raise ValueError(f"together: expected [fewest, most], at most {len(self.effects)} effects")
        if any(effect.share != 1 for effect in self.effects):
            raise ValueError("together and share at once: leave one of them out")
        return self
