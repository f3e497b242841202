"""The simulator integrates by another method: a discrete setting of the solver."""

from __future__ import annotations

import mujoco

from candata.effects._contract import Advice, Array, Effect, Parameter, constant_bounds
from candata.scenes.assemble import Scene

#: Words in the order of `mjtIntegrator`.
CHOICES = ("euler", "rk4", "implicit", "implicitfast", "discrete")
#: The methods in use; `implicit` differs from `implicitfast` in Coriolis terms alone.
USUAL_INTEGRATORS = ("euler", "rk4", "implicitfast")


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the integrator."""
    model.opt.integrator = int(x[0])


def _nominal_integrator(scene: Scene) -> float:
    """Return the scene's integrator."""
    return float(scene.model.opt.integrator)


def _other_integrators(scene: Scene) -> tuple[float, ...]:
    """Return the usual integrators that the scene does not have."""
    return tuple(
        float(CHOICES.index(word)) for word in USUAL_INTEGRATORS if CHOICES.index(word) != _nominal_integrator(scene)
    )


EFFECT = Effect(
    about="integrator of the simulation is replaced",
    advice=Advice("Use the {x} integrator", '<option integrator="{raw}"/>'),
    traits=frozenset({"simulator", "solver"}),
    parameters=(
        Parameter(
            "integrator",
            "1",
            constant_bounds(0, len(CHOICES) - 1),
            _other_integrators,
            lambda scene: tuple((v, v) for v in _other_integrators(scene)),
            "MuJoCo manual, option/integrator: Euler is the default, implicitfast is advised",
            neutral=_nominal_integrator,
            choices=CHOICES,
        ),
    ),
    acts_on="world",
    possible=lambda scene: True,
    edit=_edit,
)
