"""The gap on fresh episodes: named effects are tried on episodes of the hidden world that no search has seen.

What a report says is closed comes from episodes that took part in choosing names; the bench owns the hidden world, and
can record more of it. Seeds of commands, starts and noise are others, the policies are those of the case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path

from candata.errors import CandataError
from candata.gap.blind.cases import hidden_world
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.runs import Place, finished, spread
from candata.gap.data.recordings import recordings
from candata.gap.replay.effort_unit import with_effort_unit
from candata.gap.replay.replayer import EffectSet, Replayer
from candata.gap.run.streams import Streams
from candata.gap.validation.closure import gap
from candata.gap.verdict.edit_test import FEW_REPLICAS, replayed
from candata.scenes import load_scene
from candata.schema.bench import FreshGap, Label, LabelsFile
from candata.schema.effect import EffectSetting, EffectsFile
from candata.simulate.crew import Crew, alone
from candata.simulate.episodes import EpisodeJob
from candata.simulate.jobs import possible_policies

FRESH = "fresh.jsonl"
#: Number of the first fresh episode, which seeds it with the set's seed: no case has as many episodes.
FIRST_FRESH = 10**6


def is_recordable(sealed: LabelsFile) -> bool:
    """Tell whether more can be recorded of the hidden worlds: candata played them itself, all in one scene."""
    return {"scene", "seed", "duration_s"} <= set(sealed.asked)


def named_settings(outcome: Outcome) -> EffectSet:
    """Return the named effects with the values that the report gives them."""
    return tuple(
        EffectSetting(name=e.name, element=e.element, parameters={n: p.value for n, p in e.parameters.items()})
        for e in outcome.effects
    )


def measure_fresh_gaps(
    out: Path,
    places: Sequence[Place],
    outcomes: Sequence[Outcome],
    sealed: LabelsFile,
    episodes: int,
    *,
    crew: Crew = alone,
    told: Callable[[int], None] = lambda count: None,
    until: float = inf,
) -> dict[str, FreshGap]:
    """Return the gap on fresh episodes of each case in which effects are named, by the case's name.

    Parameters
    ----------
    out : Path
        Folder of the results; what stands in `fresh.jsonl` of as many episodes is taken as it is.
    places : sequence of Place
        Where each case lies.
    outcomes : sequence of Outcome
        The cases that were diagnosed, opened.
    sealed : LabelsFile
        The labels; `is_recordable`.
    episodes : int
        How many are recorded of each hidden world.
    crew : Crew
        Who does the work.
    told : callable
        Called with 1 for each case just done.
    until : float
        Time [s since the epoch] from which on no case is begun.
    """
    standing = {f.sealed: f for f in finished(out / FRESH, FreshGap) if f.episodes == episodes}
    where = {p.sealed: p for p in places}
    named = [o for o in outcomes if o.effects]
    seed, duration_s = int(sealed.asked["seed"]), float(sealed.asked["duration_s"])
    tasks = []
    for o in named:
        if o.result.sealed not in standing:
            world = EffectsFile(effects=named_settings(o)).model_dump_json()
            case = where[o.result.sealed].anywhere
            tasks.append((*case, o.label.model_dump_json(), world, seed, episodes, duration_s))
    for found in spread(out / FRESH, fresh_gap, tasks, crew, until):
        standing[found.sealed] = found
        told(1)
    return {o.label.case: standing[o.result.sealed] for o in named if o.result.sealed in standing}


def fresh_gap(
    folder: str,
    scene: NominalScene,
    sealed: str,
    label: str,
    world: str,
    seed: int,
    episodes: int,
    duration_s: float,
) -> FreshGap:
    """Return how far the named effects close the gap on fresh episodes; runs in any process.

    Parameters
    ----------
    folder : str
        The case's.
    scene : NominalScene
        In which it was diagnosed.
    sealed : str
        Hash of the label.
    label, world : str
        The truth, and the named effects as an effects file, both as JSON.
    seed : int
        Seed of the set's commands.
    episodes : int
    duration_s : float
        Length of an episode [s].
    """
    case = Path(folder).name
    try:
        truth, effects = Label.model_validate_json(label), EffectsFile.model_validate_json(world).effects
        own = load_scene(scene.name)
        policies = possible_policies(own)
        plans = [
            EpisodeJob(
                f"fresh-{i:04d}",
                FIRST_FRESH + i,
                policies[i % len(policies)],
                seed,
                truth.effects,
                hidden=True,
                noise_seed=truth.seed,
            )
            for i in range(episodes)
        ]
        nominal = scene.load()
        replayer, streams = Replayer(nominal), Streams()
        recs, _ = with_effort_unit(replayer, recordings(nominal, hidden_world(own, truth, plans, duration_s)))
        found = replayed(replayer, recs, effects, streams, FEW_REPLICAS)
        size = gap(found.size_before, found.size_after, streams.of("gap", recs.ids), gap_left=True)
    except CandataError as problem:
        return FreshGap(case=case, sealed=sealed, episodes=episodes, error=problem.problem)
    return FreshGap(case=case, sealed=sealed, episodes=episodes, gap=size)
