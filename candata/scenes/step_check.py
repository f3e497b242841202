"""Checks of a compiled model's time step and of its actuators' commands."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.errors import SceneError
from candata.schema.scene import SceneFile

#: Physics step of a model that names none [s] (MuJoCo XML reference, option/timestep).
USUAL_STEP_S = 0.002
#: Physics steps a control step. Measured: this many of `cube_toss`, the lightest scene, take half a second.
MOST_SUBSTEPS = 100_000


def check_rate(name: str, file: SceneFile, model: mujoco.MjModel) -> None:
    """Refuse a physics step that does not fit into the control step.

    Raises
    ------
    SceneError
        When the step is no time, too short to simulate, or does not divide the control step.
    """
    if not 0 < model.opt.timestep < np.inf:
        raise SceneError(
            f"scene {name}: the physics step is no time",
            expected="<option timestep> above 0 s",
            found=f"{model.opt.timestep:g} s",
            fix=f'set <option timestep="{1 / file.rate_hz / max(1, round(1 / file.rate_hz / USUAL_STEP_S)):.9g}"/>',
        )
    steps = 1 / file.rate_hz / model.opt.timestep
    if steps > MOST_SUBSTEPS:
        raise SceneError(
            f"scene {name}: the physics step is too short to simulate",
            expected=f"at most {MOST_SUBSTEPS:,} physics steps a control step of {1 / file.rate_hz:g} s",
            found=f"{steps:,.0f} of {model.opt.timestep:g} s",
            fix=f'set <option timestep="{1 / file.rate_hz / max(1, round(1 / file.rate_hz / USUAL_STEP_S)):.9g}"/>',
        )
    if steps < 0.99 or abs(steps - round(steps)) > 0.02:
        raise SceneError(
            f"scene {name}: the physics step does not divide the control step",
            expected=f"timestep = 1 / ({file.rate_hz:g} x n) s",
            found=f"{model.opt.timestep:g} s ({steps:.2f} a step)",
            fix=f'set <option timestep="{1 / file.rate_hz / max(1, round(steps)):.9g}"/>',
        )


def check_commands(name: str, model: mujoco.MjModel) -> None:
    """Refuse an actuator that takes more than one number a step: a column of `action` is one number.

    Raises
    ------
    SceneError
        When the model has such an actuator.
    """
    actuator_ids = [a for a in range(model.nactuator) if model.actuator_ctrlnum[a] != 1]
    if actuator_ids:
        raise SceneError(
            f"scene {name}: actuator {model.actuator(actuator_ids[0]).name} takes several numbers at once",
            expected="actuators of one command each",
            found=f"{model.actuator_ctrlnum[actuator_ids[0]]} numbers",
            fix="use <position>, <velocity>, <motor> or <general> on each joint in its place",
        )
