"""`policy evaluate`: every policy from every start in every world, and how well each world predicts what was seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata import __version__
from candata.datasets import Dataset
from candata.errors import UsageError, Where
from candata.policies import Motion
from candata.policy_evaluation.attribution import disagreement, effect_share, next_motion
from candata.policy_evaluation.contract import Played, RealStarts, World
from candata.policy_evaluation.goals import check_held, parsed_goal
from candata.policy_evaluation.policies import EvaluatedPolicy, read_policies
from candata.policy_evaluation.ranking import best_ranking, headline, is_comparable, lead, wilson, world_ranking
from candata.policy_evaluation.results import (
    Disagreement,
    EffectShare,
    Interval,
    PolicyEvaluation,
    PolicyFacts,
    PolicyScore,
    WorldRanking,
)
from candata.policy_evaluation.seen import Withheld, recorded_success
from candata.policy_evaluation.simulated import SimulatedWorld
from candata.policy_evaluation.starts import real_starts
from candata.policy_evaluation.worlds import (
    NOMINAL,
    RECORDINGS,
    REPAIRED,
    WITHHELD,
    HeldOut,
    ModelSettings,
    effect_text,
    held_out_episodes,
    simulated_worlds,
    summaries,
    without_effect,
)
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.schema.outcome import SUCCESS

Array = NDArray[np.float64]
Stage = Callable[[str], None]


@dataclass(frozen=True)
class PolicyEvaluationSettings:
    """How to evaluate policies.

    Attributes
    ----------
    group : str
        Group of the split whose episodes are starts: `test`, `val`, `train` or `all`.
    starts : int
        Most starts.
    duration_s : float
        Length of an episode [s].
    seed : int
        Of all that policies, sensors and forecasts draw.
    goal : str or None
        What is meant, as `parsed_goal` takes it, in place of what each policy means.
    scene : str or None
        The nominal scene; by default the one that the episodes name.
    effects : tuple of EffectSetting or None
        Effects of the repaired simulator; None leaves it out.
    withheld : Withheld or None
        A stand-in for the real world.
    models : ModelSettings
        How trained models forecast.
    threads : int
        Threads of the simulators.
    """

    group: str = "test"
    starts: int = 50
    duration_s: float = 3.2
    seed: int = 1
    goal: str | None = None
    scene: str | None = None
    effects: tuple[EffectSetting, ...] | None = None
    withheld: Withheld | None = None
    models: ModelSettings = field(default_factory=ModelSettings)
    threads: int = 1


@dataclass(frozen=True)
class Exhibit:
    """The policy and start for which worlds disagree most, as states to draw.

    Attributes
    ----------
    scene : Scene
    title : str
        Policy and start.
    rate_hz : float
        Rows a second.
    qpos : dict of str to (T, nq) float64
        Positions by world.
    motion : Motion
        The commands, to be recorded next.
    """

    scene: Scene
    title: str
    rate_hz: float
    qpos: dict[str, Array]
    motion: Motion


def evaluate_policies(
    runs: Sequence[Path],
    dataset: Dataset,
    policies_file: Path,
    settings: PolicyEvaluationSettings,
    stage: Stage = lambda _words: None,
) -> tuple[PolicyEvaluation, Exhibit | None]:
    """Return what was found, and the worst disagreement where there is one.

    Parameters
    ----------
    runs : sequence of Path
        Runs that are worlds; none compares simulators alone.
    dataset : Dataset
        Recordings whose held-out episodes are starts, and of the policies where it holds such.
    policies_file : Path
        Policies, see `candata.policy_evaluation.policies.PolicyFile`.
    settings : PolicyEvaluationSettings
        How.
    stage : callable
        Called with what is being done.

    Raises
    ------
    CandataError
        As `held_out_episodes`, `read_policies`, `real_starts` and `World.play`.
    """
    goal = None if settings.goal is None else parsed_goal(settings.goal)
    check_held(goal, settings.duration_s)
    stage("reading the recordings")
    held_out = held_out_episodes(runs, dataset, settings.group, settings.scene, settings.models, settings.threads)
    if settings.withheld is not None:
        settings.withheld.check(held_out.scene)
    policies = read_policies(policies_file, held_out.scene, goal)
    starts, notes = real_starts(held_out.scene, dataset, held_out.ids, settings.starts, settings.threads)
    notes += held_out.seen_notes(starts.ids)
    worlds: tuple[World, ...] = (
        *simulated_worlds(held_out.scene, settings.effects, settings.threads),
        *held_out.learned_worlds,
    )
    plays = play_all(policies, worlds, starts, settings, stage)
    recorded_flags = recorded_success(dataset, policies, starts)
    seen_world: tuple[World, ...] = ()
    if settings.withheld is not None:
        seen_world = (SimulatedWorld(WITHHELD, held_out.scene, settings.withheld.effects, settings.threads),)
        plays |= play_all(policies, seen_world, starts, settings, stage)
    seen_name, seen_success = _seen(policies, plays, recorded_flags, settings.withheld is not None)
    effects, compared_with = _effects(policies, worlds, starts, settings, plays, seen_success, stage)
    findings = _Findings(policies, worlds, seen_world, starts, plays, seen_name, seen_success, recorded_flags)
    evaluation = _evaluation(findings, held_out, dataset, settings, effects, compared_with, notes)
    return evaluation, _exhibit(findings, held_out.scene, evaluation.next_motion)


def play_all(
    policies: Sequence[EvaluatedPolicy],
    worlds: Sequence[World],
    starts: RealStarts,
    settings: PolicyEvaluationSettings,
    stage: Stage = lambda _words: None,
) -> dict[tuple[str, str], Played]:
    """Return what came of every policy in every world, by their names.

    Raises
    ------
    UsageError
        When a policy means nothing with the object.
    """
    plays: dict[tuple[str, str], Played] = {}
    for world in worlds:
        stage(f"{len(policies)} policies in {world.name}")
        for policy in policies:
            result = world.play(policy, starts, settings.seed, settings.duration_s)
            if None in result.outcomes:
                raise UsageError(
                    f"policy {policy.name} does not say what is meant with the object",
                    expected="a goal, so that success can be told",
                    where=Where(path=policy.source),
                    fix="give --goal lift, place, turn or topple",
                )
            plays[policy.name, world.name] = result
    return plays


@dataclass(frozen=True)
class _Findings:
    """What was played and seen: worlds that predict, the world that stands in for the real one, and recordings."""

    policies: tuple[EvaluatedPolicy, ...]
    worlds: tuple[World, ...]
    seen_world: tuple[World, ...]
    starts: RealStarts
    plays: Mapping[tuple[str, str], Played]
    seen_name: str | None
    seen_success: Array
    recorded_flags: Array

    def success(self, world: str) -> Array:
        """Return the success `(P, n)` of all policies in a world, NaN where a simulation became unstable."""
        return _success(self.policies, self.plays, world)


def _success(policies: Sequence[EvaluatedPolicy], plays: Mapping[tuple[str, str], Played], world: str) -> Array:
    """Return the success `(P, n)` of all policies in a world, NaN where a simulation became unstable."""
    return np.array([plays[policy.name, world].counted_success for policy in policies])


def _seen(
    policies: Sequence[EvaluatedPolicy],
    plays: Mapping[tuple[str, str], Played],
    recorded_flags: Array,
    has_withheld: bool,
) -> tuple[str | None, Array]:
    """Return what counts as seen and its name: the stand-in where there is one and it is stable, else recordings."""
    name, success = (WITHHELD, _success(policies, plays, WITHHELD)) if has_withheld else (RECORDINGS, recorded_flags)
    return (name if np.isfinite(success).any() else None), success


def _effects(
    policies: Sequence[EvaluatedPolicy],
    worlds: Sequence[World],
    starts: RealStarts,
    settings: PolicyEvaluationSettings,
    plays: Mapping[tuple[str, str], Played],
    seen_success: Array,
    stage: Stage,
) -> tuple[tuple[EffectShare, ...], str | None]:
    """Return what each effect of the repair explains, and against what that was counted."""
    repaired_world = next((world for world in worlds if world.name == REPAIRED), None)
    if not isinstance(repaired_world, SimulatedWorld):
        return (), None
    nominal, repaired_success = (_success(policies, plays, name) for name in (NOMINAL, REPAIRED))
    compared_with = "seen" if np.isfinite(seen_success).any() else REPAIRED
    truth = seen_success if compared_with == "seen" else repaired_success
    shares = []
    for number, effect in enumerate(repaired_world.effects):
        if len(repaired_world.effects) == 1:
            success = nominal
        else:
            world = without_effect(repaired_world, number)
            success = _success(policies, play_all(policies, (world,), starts, settings, stage), world.name)
        shares.append(effect_share(effect_text(effect), truth, nominal, repaired_success, success))
    return tuple(shares), compared_with


def _evaluation(
    findings: _Findings,
    held_out: HeldOut,
    dataset: Dataset,
    settings: PolicyEvaluationSettings,
    effects: tuple[EffectShare, ...],
    compared_with: str | None,
    notes: tuple[str, ...],
) -> PolicyEvaluation:
    """Return the record of an evaluation."""
    rankings, margin = _rankings(findings, settings.seed)
    top_ranking = best_ranking(rankings)
    names = tuple(policy.name for policy in findings.policies)
    world_names = tuple(world.name for world in findings.worlds)
    return PolicyEvaluation(
        headline=headline(top_ranking, margin, findings.seen_success, world_names),
        dataset=f"{dataset.name}@{dataset.digest[:12]}",
        split=held_out.split,
        group=settings.group,
        scene=held_out.scene.name,
        starts=findings.starts.ids,
        duration_s=settings.duration_s,
        seed=settings.seed,
        goal=settings.goal,
        seen=findings.seen_name,
        policies={policy.name: PolicyFacts(source=policy.source, kind=policy.kind) for policy in findings.policies},
        worlds=summaries((*findings.worlds, *findings.seen_world)),
        scores=_scores(findings),
        rankings=rankings,
        best=None if top_ranking is None else top_ranking.world,
        ahead_of_nominal=margin,
        effects=effects,
        compared_with=compared_with,
        next_motion=disagreement(
            findings.plays,
            names,
            world_names,
            findings.starts,
            top_ranking.world if top_ranking is not None else world_names[-1],
        ),
        notes=(*notes, *_notes(findings, settings.goal, settings.duration_s)),
        revision=__version__,
    )


def _rankings(findings: _Findings, seed: int) -> tuple[tuple[WorldRanking, ...], Interval | None]:
    """Return how well each world predicts, and by how much the best is ahead of the nominal simulator."""
    if findings.seen_name is None:
        return (), None
    pairs = {world.name: (findings.success(world.name), findings.seen_success) for world in findings.worlds}
    rankings_drawn = {
        name: world_ranking(name, *success, seed) for name, success in pairs.items() if is_comparable(*success)
    }
    rankings = tuple(entry for entry, _ in rankings_drawn.values())
    top_ranking = best_ranking(rankings)
    if top_ranking is None or top_ranking.world == NOMINAL:
        return rankings, None
    if NOMINAL not in rankings_drawn:
        return rankings, Interval(value=np.nan, low=np.nan, high=np.nan)
    nominal = rankings_drawn[NOMINAL]
    value = top_ranking.spearman.value - nominal[0].spearman.value
    return rankings, lead(rankings_drawn[top_ranking.world][1], nominal[1], value)


def _scores(findings: _Findings) -> tuple[PolicyScore, ...]:
    """Return the success of each policy in each world, seen ones last."""
    scores = []
    for policy in findings.policies:
        for world in (*findings.worlds, *findings.seen_world):
            scores.append(_score(policy.name, world.name, findings.plays[policy.name, world.name]))
    if findings.seen_name == RECORDINGS:
        for policy, row in zip(findings.policies, findings.recorded_flags, strict=True):
            seen_flags = row[np.isfinite(row)]
            count, total = round(float(seen_flags.sum())), len(seen_flags)
            scores.append(
                PolicyScore(
                    policy=policy.name,
                    world=RECORDINGS,
                    success=wilson(count, total),
                    count=count,
                    total=total,
                    outcomes={SUCCESS: count, "other": total - count},
                )
            )
    return tuple(scores)


def _score(policy: str, world: str, plays: Played) -> PolicyScore:
    """Return the success of one policy in one world."""
    count, total = int(np.nansum(plays.counted_success)), int((~plays.failed).sum())
    words = [str(word) for word, has_failed in zip(plays.outcomes, plays.failed, strict=True) if not has_failed]
    return PolicyScore(
        policy=policy,
        world=world,
        success=wilson(count, total),
        count=count,
        total=total,
        outcomes=dict(sorted(Counter(words).items())),
        unstable=int(plays.failed.sum()),
        spread_m=None if plays.spread_m is None else float(plays.spread_m.mean()),
    )


def _notes(findings: _Findings, goal: str | None, duration_s: float) -> tuple[str, ...]:
    """Return what a reader must know."""
    notes = []
    for world in (*findings.worlds, *findings.seen_world):
        results = [findings.plays[policy.name, world.name] for policy in findings.policies]
        if any(np.isnan(result.contact).any() for result in results):
            notes.append(f"{world.name} forecasts no contact: slips and drops are not told there")
        if unstable := sum(int(result.failed.sum()) for result in results):
            notes.append(f"{unstable} simulations of {world.name} became unstable and count for nothing")
    if findings.seen_name == RECORDINGS:
        notes.append(
            f"recordings count as their `outcome` says: it must be of {goal or 'what each policy means'} within "
            f"{duration_s:g} s, as it is in the worlds"
        )
    if findings.seen_name is None:
        notes.append("the data set holds no recording of these policies from these starts: no world can be judged")
    return tuple(notes)


def _exhibit(findings: _Findings, scene: Scene, choice: Disagreement | None) -> Exhibit | None:
    """Return the worst disagreement as states of every world."""
    if choice is None:
        return None
    i = findings.starts.ids.index(choice.start)
    qpos = {}
    for world in (*findings.seen_world, *findings.worlds):
        run = findings.plays[choice.policy, world.name]
        states = np.repeat(findings.starts.qpos[i][None], run.object_pose.shape[1], axis=0)
        states[:, scene.joint_qpos] = run.joint_position[i]
        states[:, scene.object_qpos : scene.object_qpos + 7] = run.object_pose[i]
        qpos[world.name] = states
    commands = findings.plays[choice.policy, choice.commands]
    motion = next_motion(scene, choice, commands, findings.starts)
    return Exhibit(scene, f"{choice.policy} from {choice.start}", scene.file.rate_hz, qpos, motion)
