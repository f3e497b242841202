"""Record of the card beside a policy's network: what goes in, and what comes out."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from candata.schema.record import Record

Input = Literal["object_pose", "joint_position", "fingertip_force", "action"]


class PolicyCard(Record):
    """`FILE.json` beside `FILE.safetensors`: a multilayer perceptron that gives commands.

    The file holds `layers.0.weight (H, I)`, `layers.0.bias (H,)`, `layers.1.weight` and so on, and may hold
    `input_mean`, `input_scale (I,)`, `output_mean` and `output_scale (A,)`. The input is the `inputs` in their order,
    flat, of the last `history` control steps, the oldest first; before row 0 the first step is repeated. Each layer but
    the last is followed by `activation`. The output times `output_scale` plus `output_mean` is the commands, or, where
    `commands` is `change`, what is added to the previous ones. `scene_digest` is that of the scene it was made for.
    """

    format: Literal["candata-policy-1"] = "candata-policy-1"
    inputs: Annotated[tuple[Input, ...], Field(min_length=1)]
    history: Annotated[int, Field(ge=1)] = 1
    activation: Literal["relu", "tanh", "silu", "elu"] = "relu"
    commands: Literal["absolute", "change"] = "absolute"
    scene_digest: str | None = None
