"""The simulator takes longer or shorter physics steps: a setting of the solver."""

from __future__ import annotations

import mujoco

from candata.effects._contract import Advice, Array, Bounds, Effect, Parameter
from candata.scenes.assemble import Scene

#: Largest number of physics steps in one of the scene's, and of the scene's steps in one.
FINER, COARSER = 8, 2.5


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the physics step by the nearest one that divides the control step."""
    model.opt.timestep *= _dividing_step(scene, x[0]) / scene.model.opt.timestep


def _dividing_step(scene: Scene, step_s: float) -> float:
    """Return the physics step nearest to `step_s` of which a whole number makes a control step [s]."""
    control = scene.substeps * scene.model.opt.timestep
    return float(control / max(1, round(control / step_s)))


def _bounds(scene: Scene) -> Bounds:
    """Return the range, the scene's own step inside."""
    nominal_step = scene.model.opt.timestep
    return Bounds(nominal_step / FINER, min(COARSER, scene.substeps) * nominal_step)


def _probes(scene: Scene) -> tuple[float, ...]:
    """Return the finer and coarser steps that divide the control step."""
    nominal_step, steps = scene.model.opt.timestep, scene.substeps
    ends = _bounds(scene)
    probes = [_dividing_step(scene, factor * nominal_step) for factor in (0.2, 0.25, 0.5, 1.6, 2.5)]
    return tuple(
        v for v in dict.fromkeys(probes) if v != nominal_step and v <= ends.high and (v < nominal_step or steps > 1)
    )


def _draws(scene: Scene) -> tuple[tuple[float, float], ...]:
    """Return the same steps as intervals."""
    return tuple((v, v) for v in _probes(scene))


EFFECT = Effect(
    about="physics step of the simulation is replaced by the nearest that divides the control step",
    advice=Advice("Use a physics step of {x}", '<option timestep="{raw}"/>'),
    traits=frozenset({"simulator", "solver"}),
    parameters=(
        Parameter(
            "time_step_s",
            "s",
            _bounds,
            _probes,
            _draws,
            "MuJoCo manual, option/timestep: 2 ms is the default, models in use have 0.5 to 5 ms",
            neutral=lambda scene: float(scene.model.opt.timestep),
            enumerated=True,
        ),
    ),
    acts_on="world",
    possible=lambda scene: True,
    edit=_edit,
)
