"""The policies of an evaluation: a file names them, and each gives its orders from any start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from candata.errors import DataError, UsageError, Where
from candata.policies import (
    Goal,
    Plan,
    StepPolicy,
    command_limits,
    motion_plan,
    opening_plan,
    policy,
    policy_names,
    read_motions,
    read_step_policy,
)
from candata.policies._network import SUFFIX
from candata.policy_evaluation.contract import Array, Orders, RealStarts
from candata.scenes import Scene
from candata.schema.record import Record
from candata.schema.yaml_text import read_yaml
from candata.simulate.episodes import PLAN_STREAM, POLICY_STREAM

#: Stream of the random numbers that are added to a policy's commands.
COMMAND_NOISE_STREAM = 7
#: Correlation time of noise on commands [s]. Chosen: as that of the scripted policies' own.
NOISE_TIME_S = 0.08


class PolicyEntry(Record):
    """One policy of a file: `source` is what `generate-sim` plays.

    A scripted policy by its name (`variant` numbers one of its variants from 1), a network `FILE.safetensors`,
    `FILE.py:function`, `package.module:function`, or a command file `FILE.parquet` (`motion` names one of several).
    `noise_share` adds correlated noise of this share of each command's range (1 sd), `seed` shifts what the policy
    draws.
    """

    name: str
    source: str
    variant: Annotated[int, Field(ge=1)] | None = None
    motion: str | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    noise_share: Annotated[float, Field(ge=0, le=1)] = 0.0


class PolicyFile(Record):
    """`policies.yaml`: the policies that are evaluated."""

    policies: Annotated[tuple[PolicyEntry, ...], Field(min_length=1)]


Planner = Callable[[Scene, np.random.Generator, float], Plan]


@dataclass(frozen=True)
class EvaluatedPolicy:
    """A policy of a file.

    Attributes
    ----------
    name, source : str
        As the file has them.
    plan : callable
        `(scene, rng, duration_s) -> Plan`.
    step_policy : StepPolicy or None
        What gives the commands in a closed loop; None where the plan is played.
    goal : Goal or None
        What is meant, in place of what the plan means.
    seed : int
        Shifts what the policy draws.
    noise_share : float
        Noise on planned commands, 1 sd as a share of each range.
    """

    name: str
    source: str
    plan: Planner
    step_policy: StepPolicy | None = None
    goal: Goal | None = None
    seed: int = 0
    noise_share: float = 0.0

    @property
    def kind(self) -> str:
        """`closed loop` or `planned`."""
        return "planned" if self.step_policy is None else "closed loop"

    def orders(self, scene: Scene, starts: RealStarts, seed: int, duration_s: float) -> Orders:
        """Return the orders from some starts; see `candata.policy_evaluation.contract.PlayedPolicy`."""
        rngs = [[seed, int(number), self.seed] for number in starts.numbers]
        plans = [self.plan(scene, np.random.default_rng([*key, PLAN_STREAM]), duration_s) for key in rngs]
        noise = [_noise(scene, plan, self.noise_share, key) for plan, key in zip(plans, rngs, strict=True)]
        commands = np.stack([plan.commands for plan in plans])
        if self.step_policy is None:
            commands = np.clip(commands + np.stack(noise), *command_limits(scene).T)
        self._refuse_impossible(scene, commands)
        begins = tuple(
            None
            if self.step_policy is None
            else partial(self.step_policy.begin, scene, np.random.default_rng([*key, POLICY_STREAM]))
            for key in rngs
        )
        return Orders(
            commands,
            begins,
            tuple(self.goal or plan.goal for plan in plans),
            plans[0].settle_s,
        )

    def _refuse_impossible(self, scene: Scene, commands: Array) -> None:
        """Refuse planned commands that are no finite numbers, or not the scene's."""
        is_finite = bool(np.isfinite(commands).all())
        if commands.shape[2] != len(scene.actuator_ids) or not is_finite:
            raise DataError(
                f"policy {self.name} plans what cannot be played",
                expected=f"{len(scene.actuator_ids)} finite commands a row",
                found="numbers that are not finite" if not is_finite else f"{commands.shape[2]} commands a row",
                where=Where(path=self.source),
                fix="mend the policy, or leave it out of the file",
            )


def _noise(scene: Scene, plan: Plan, share: float, key: list[int]) -> Array:
    """Return noise `(T, A)` on planned commands: white noise through a first-order low-pass."""
    out = np.zeros_like(plan.commands)
    if share == 0:
        return out
    rng = np.random.default_rng([*key, COMMAND_NOISE_STREAM])
    keep = float(np.exp(-1 / (NOISE_TIME_S * scene.file.rate_hz)))
    low, high = command_limits(scene).T
    white = rng.standard_normal(out.shape) * np.sqrt(1 - keep**2) * share * (high - low)
    for k in range(1, len(out)):
        out[k] = keep * out[k - 1] + white[k]
    return out


@dataclass(frozen=True)
class GivenCommands:
    """Commands that are at hand, one set for each start in its order.

    Attributes
    ----------
    name : str
        What they are called.
    commands : (n, T, A) float64
        At the scene's rate.
    goal : Goal or None
        What is meant with the object.
    settle_s : float
        Time for which the first commands are held before row 0 [s].
    """

    name: str
    commands: NDArray[np.float64]
    goal: Goal | None = None
    settle_s: float = 0.0

    def orders(self, scene: Scene, starts: RealStarts, seed: int, duration_s: float) -> Orders:
        """Return the commands as they are; seed and duration change nothing."""
        count = len(starts)
        return Orders(np.array(self.commands, float), (None,) * count, (self.goal,) * count, self.settle_s)


def read_policies(path: Path, scene: Scene, goal: Goal | None = None) -> tuple[EvaluatedPolicy, ...]:
    """Return the policies of a file, each checked to be there.

    Parameters
    ----------
    path : Path
        `policies.yaml`; sources that are files may lie beside it.
    scene : Scene
        For motions, which must be within its limits.
    goal : Goal, optional
        What is meant, in place of what each policy means.

    Raises
    ------
    UsageError
        When the file is missing or not valid, two policies have one name, or a source names nothing.
    DataError
        When a module, network or command file is not sound.
    """
    file = PolicyFile.parse(_as_record(read_yaml(path, "the policies file")), path)
    names = [entry.name for entry in file.policies]
    repeated_name = next((name for name in names if names.count(name) > 1), None)
    if repeated_name is not None:
        raise UsageError(
            f"two policies are called {repeated_name}", where=Where(path=str(path)), fix="name each of them once"
        )
    return tuple(_policy(entry, path.parent, scene, goal) for entry in file.policies)


def _as_record(value: object) -> object:
    """Return a bare list of policies as the record that holds it."""
    return {"policies": value} if isinstance(value, list) else value


def _policy(entry: PolicyEntry, folder: Path, scene: Scene, goal: Goal | None) -> EvaluatedPolicy:
    """Return the policy of one entry."""
    common_fields = {"goal": goal, "seed": entry.seed, "noise_share": entry.noise_share}
    source = entry.source
    if source in policy_names():
        return EvaluatedPolicy(entry.name, source, _script_planner(entry, scene), **common_fields)  # type: ignore[arg-type]
    if source.endswith(".parquet"):
        return EvaluatedPolicy(entry.name, source, _motion(entry, folder, scene), **common_fields)  # type: ignore[arg-type]
    if not (source.endswith(SUFFIX) or ":" in source):
        raise UsageError(
            f"{source!r} names no policy",
            expected=f"one of {', '.join(policy_names())}; FILE.safetensors, FILE.parquet, FILE.py:function, "
            "or package.module:function",
            where=Where(path=entry.name),
        )
    if entry.noise_share:
        raise UsageError(f"policy {entry.name} acts in a closed loop: it takes no noise_share", fix="leave it out")
    step_policy = read_step_policy(_source_beside(source, folder))
    plan: Planner = opening_plan
    return EvaluatedPolicy(entry.name, source, plan, step_policy, **common_fields)  # type: ignore[arg-type]


def _script_planner(entry: PolicyEntry, scene: Scene) -> Planner:
    """Return the planner of a scripted policy, or of one of its variants."""
    script = policy(entry.source)
    if not script.possible(scene):
        raise UsageError(f"policy {entry.source} is not possible in scene {scene.name}", found=script.about)
    if entry.variant is None:
        return script.plan
    if entry.variant > len(script.variants):
        raise UsageError(
            f"policy {entry.source} has no variant {entry.variant}",
            expected=f"1 to {len(script.variants)}" if script.variants else "none: it has no variants",
        )
    return script.variants[entry.variant - 1].plan


def _motion(entry: PolicyEntry, folder: Path, scene: Scene) -> Planner:
    """Return the planner that plays one motion of a command file."""
    path = Path(_source_beside(entry.source, folder))
    motions = {motion.name: motion for motion in read_motions(path, scene).motions}
    name = entry.motion or (next(iter(motions)) if len(motions) == 1 else None)
    if name not in motions:
        raise UsageError(
            f"policy {entry.name} names no motion of its file",
            expected=f"motion: one of {', '.join(motions)}",
            found=str(entry.motion),
            where=Where(path=str(path)),
        )
    motion = motions[name]

    def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
        rows = round(duration_s * scene.file.rate_hz)
        held_commands = np.repeat(motion.commands[-1:], max(rows - len(motion.commands), 0), axis=0)
        return motion_plan(
            scene, replace(motion, commands=np.concatenate([motion.commands, held_commands])[:rows]), rng
        )

    return plan


def _source_beside(source: str, folder: Path) -> str:
    """Return a source whose file lies beside the policies file by its path; another one as it is."""
    file, colon, function = source.partition(":") if ".py:" in source else (source, "", "")
    neighbour = folder / file
    return f"{neighbour}{colon}{function}" if neighbour.is_file() else source
