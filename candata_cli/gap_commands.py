"""`candata gap bench` and `candata gap score`: the sealed self-check, on cases of our own or made elsewhere."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.gap.blind.crew import Crew
    from candata.gap.blind.outcomes import Outcome
    from candata.gap.blind.running import Place
    from candata.gap.blind.sanity import Fitness
    from candata.schema.bench import BenchFile, CaseResult, Filled, Kind

KINDS = ("one", "quarter", "null", "pair", "triple", "outside", "background", "solver", "local")
BASELINES = ("lowest_error", "bic", "one_se", "commonest", "oracle")
BENCH_EXAMPLE = """\b
Examples:
  candata gap bench --out out/bench
  candata gap bench --out out/small --kinds one,null --counts one=40,null=10 --jobs 2
  candata gap bench --out out/mine --scene my/scene.yaml --episodes 12
  candata gap bench --out out/bench --minutes 90
  candata gap bench --out out/bench --baselines oracle,bic --baseline-cases 20
  candata gap bench --out /shared/bench --ray auto
  candata gap bench --out out/small --world random-small --counts null=300,one=200

\b
With --world random-small every case brings a random small scene of its own, played by plain MuJoCo: null and one
alone, what matters in that scene; half of the nulls are plain, the others have a trait (a cut log, a joint driven
along, filtered, integrating or delayed motors, a spring, a base that gives). Its cases share no signatures.

\b
On a Ray cluster (pip install "candata[cluster]", the same candata on every machine) cases are made and diagnosed
as tasks of one core each; --out must be a folder that all its machines see at the same path.

\b
Signatures that the cases share are simulated first, each once (a row of the table says their CPU time); of a dozen
cases or more also those that only most of them need. The first case (of many, up to three) is diagnosed apart with
nothing kept: that row is what a first diagnosis costs.

\b
Baselines: lowest_error (smallest training error), bic, one_se (forward and one standard error, no floor),
commonest (the same answer always), oracle (told the cause). Not among them: mujoco.sysid with everything free,
which needs the packages of mujoco[sysid] and a parameter written for each effect.
"""
#: Results whose pace tells the time left.
LATEST = 21
FOLLOW = "Record the motion that an ambiguous case's report proposes in its world, and diagnose it again."
MINUTES = "Begin no case after so many minutes and score what is done; 0 scores what a run left (default: go on)."
RAY = f"{console.RAY} --out must be on a folder that all its machines share."
WORLD = "Draw a random small scene for each case, played by plain MuJoCo: random-small (default: one --scene)."
TRAITS = "Traits of random small scenes that take turns, comma separated (default: half plain, half the others)."
#: Episodes of a case and their length [s]: in one scene, and in random small ones (None: each scene draws its own).
IN_ONE, IN_SMALL = (20, 2.4), (12, None)
#: The scene of the self-check: light, so that a whole table takes minutes, not hours.
SCENE = "gripper_tabletop"
SCORE_EXAMPLE = """\b
Example: candata gap score cases --labels sealed.json --out out/score

\b
A case is a folder: a candata dataset with a case.json beside its files,
  {"name": "case-0001", "scene": "scene.yaml or built-in", "episodes": 20, "sealed": "sha256(label + salt)"}
and all labels are one file, {"salt": "64 hex digits", "labels": {"case-0001": "label as JSON text"}}, a label being
  {"case": "case-0001", "kind": "one", "effects": [{"name": "object_mass", "parameters": {"mass_scale": 1.4}}]}
See schemas/case.schema.json, labels.schema.json and label.schema.json for every field.
"""


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = console.group(app, "gap", console.GAP)
    group.command("bench", epilog=BENCH_EXAMPLE)(bench)
    group.command("score", epilog=SCORE_EXAMPLE)(score)


def bench(
    out: Annotated[Path, typer.Option(help="Folder of the run; an interrupted one goes on.")],
    scene: Annotated[
        str | None, typer.Option(help=f"Nominal simulator: a scene.yaml or a built-in scene (default: {SCENE}).")
    ] = None,
    world: Annotated[str | None, typer.Option(help=WORLD)] = None,
    traits: Annotated[str, typer.Option(help=TRAITS)] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the commands; what is hidden is secret.")] = 1,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes of each case (default: 20, in random small scenes 12).")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(help="Length of an episode (default: 2.4; a random small scene draws 1.2 to 2.5).")
    ] = None,
    kinds: Annotated[str, typer.Option(help=f"Kinds of cases, comma separated: {', '.join(KINDS)}.")] = ",".join(KINDS),
    counts: Annotated[
        str,
        typer.Option(
            help="Cases of a kind, like one=120,quarter=40; others keep theirs (one 120, null 100, else 40; in random "
            "small scenes null 300, one 200)."
        ),
    ] = "",
    only: Annotated[str, typer.Option(help="Effects to draw from, comma separated (default: all).")] = "",
    baselines: Annotated[str, typer.Option(help=f"Also score these, comma separated: {', '.join(BASELINES)}.")] = "",
    baseline_cases: Annotated[int, typer.Option(min=1, help="Cases that the baselines are given.")] = 40,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    ray: Annotated[str | None, typer.Option(metavar="ADDRESS", help=RAY)] = None,
    minutes: Annotated[float | None, typer.Option(min=0, help=MINUTES)] = None,
    follow: Annotated[bool, typer.Option(help=FOLLOW)] = True,
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Hide causes, diagnose them from the data alone, open the labels, print the score: misses first.

    Kinds: one effect; a quarter of its size; null; pair and triple; outside (in no library); background (everything
    5 % wrong and one effect); solver (another simulator setting); local (one joint or fingertip).
    """
    from candata.gap.blind.cases import CASES, LABELS
    from candata.gap.blind.cluster import crew_of

    asked = _asked(world, scene, traits, kinds, counts, only, seed, episodes, duration_s)
    beside, until = _known(baselines, BASELINES, "baseline"), _until(minutes)
    with crew_of(jobs, ray, out) as crew:
        (_make_small if world else _make)(out, asked, crew)
        run = _Run(
            out, out / CASES, out / LABELS, crew, seed, None, beside, baseline_cases, until, follow and not world
        )
        _diagnose_and_score(run, json)


@dataclass(frozen=True)
class _Asked:
    """Which cases a run is asked to make; `scene` is empty for random small scenes."""

    scene: str
    traits: tuple[str, ...]
    counts: dict[Kind, int]
    only: tuple[str, ...]
    seed: int
    episodes: int
    duration_s: float | None


def _asked(
    world: str | None, scene: str | None, traits: str, kinds: str, counts: str, only: str, seed: int,
    episodes: int | None, duration_s: float | None,
) -> _Asked:  # fmt: skip
    """Return what a bench is asked for.

    Raises
    ------
    UsageError
        When options exclude each other.
    UnknownNameError
        When a name is unknown.
    """
    from candata.errors import UsageError
    from candata.gap.blind.draws import COUNTS

    if world is None:
        if traits:
            raise UsageError("--traits is for random small scenes", found=traits, fix="add --world random-small")
        wanted, given = _counts(kinds, counts, COUNTS), console.words(only)
        return _Asked(
            scene or SCENE, (), wanted, given, seed, episodes or IN_ONE[0],
            IN_ONE[1] if duration_s is None else duration_s,
        )  # fmt: skip
    from candata.gap.blind.rigs.cases import COUNTS as SMALL
    from candata.gap.blind.rigs.cases import WORLD as RANDOM
    from candata.gap.blind.rigs.causes import CAUSES
    from candata.gap.blind.rigs.design import all_traits

    _known(world, (RANDOM,), "world")
    if scene is not None:
        raise UsageError(
            "--scene and --world exclude each other: each case of a random world brings its own scene",
            found=f"--scene {scene} --world {world}", fix="leave one of the two out",
        )  # fmt: skip
    usual = kinds == ",".join(KINDS)
    wanted = _counts(",".join(SMALL) if usual else kinds, counts, SMALL)
    return _Asked(
        "", _known(traits, all_traits(), "trait"), wanted, _known(only, tuple(CAUSES), "planted cause"), seed,
        episodes or IN_SMALL[0], duration_s,
    )  # fmt: skip


def _make(out: Path, asked: _Asked, crew: Crew) -> None:
    """Seal the labels of cases in one scene, and make those that are missing."""
    from candata.gap.blind.cases import make_cases, missing_cases, seal_labels
    from candata.gap.blind.sanity import check_scene
    from candata.scenes import load_scene

    world, seed, length = load_scene(asked.scene), asked.seed, asked.duration_s or 0.0

    def live() -> tuple[str, ...]:
        fit = check_scene(world, seed=seed, duration_s=length, only=asked.only)
        for line in _fitness(fit):
            console.note(line)
        return fit.live

    sealed = seal_labels(
        out, world, asked.counts, seed=seed, episodes=asked.episodes, duration_s=length, only=asked.only, live=live
    )
    with console.progress("making cases", len(missing_cases(out, sealed))) as advance:
        make_cases(
            out, asked.scene, sealed, seed=seed, episodes=asked.episodes, duration_s=length, crew=crew,
            told=lambda _name: advance(1),
        )  # fmt: skip


def _make_small(out: Path, asked: _Asked, crew: Crew) -> None:
    """Seal the labels of cases in random small scenes, and make those that are missing."""
    from candata.gap.blind.cases import LABELS, missing_cases
    from candata.gap.blind.rigs.cases import make_rig_cases, seal_rig_labels

    draws = 0 if (out / LABELS).exists() else sum(asked.counts.values())
    with console.progress("drawing cases", draws) as advance:
        sealed = seal_rig_labels(
            out, asked.counts, seed=asked.seed, episodes=asked.episodes, duration_s=asked.duration_s,
            traits=asked.traits, only=asked.only, crew=crew, told=lambda _name: advance(1),
        )  # fmt: skip
    with console.progress("making cases", len(missing_cases(out, sealed))) as advance:
        make_rig_cases(
            out, sealed, episodes=asked.episodes, duration_s=asked.duration_s, crew=crew,
            told=lambda _name: advance(1),
        )  # fmt: skip


def score(
    cases: Annotated[Path, typer.Argument(help="Folder of cases.")],
    labels: Annotated[Path, typer.Option(help="The sealed labels.")],
    out: Annotated[Path, typer.Option(help="Folder for results and score; an interrupted run goes on.")],
    scene: Annotated[str | None, typer.Option(help="Nominal simulator, instead of the one each case names.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of each diagnosis.")] = 0,
    baselines: Annotated[str, typer.Option(help=f"Also score these, comma separated: {', '.join(BASELINES)}.")] = "",
    baseline_cases: Annotated[int, typer.Option(min=1, help="Cases that the baselines are given.")] = 40,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    ray: Annotated[str | None, typer.Option(metavar="ADDRESS", help=RAY)] = None,
    minutes: Annotated[float | None, typer.Option(min=0, help=MINUTES)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Diagnose and score cases that were made elsewhere."""
    from candata.gap.blind.cluster import crew_of

    beside, until = _known(baselines, BASELINES, "baseline"), _until(minutes)
    with crew_of(jobs, ray, out) as crew:
        _diagnose_and_score(_Run(out, cases, labels, crew, seed, scene, beside, baseline_cases, until), json)


@dataclass(frozen=True)
class _Run:
    """What is diagnosed and scored, and how."""

    out: Path
    cases: Path
    labels: Path
    crew: Crew
    seed: int
    scene: str | None
    baselines: tuple[str, ...]
    baseline_cases: int
    until: float
    follow: bool = False


def _diagnose_and_score(run: _Run, json: bool) -> None:
    """Diagnose what is not yet, open the labels, write and print the score."""
    from candata.gap.blind.cases import open_labels, read_cases, read_labels, scene_of
    from candata.gap.blind.outcomes import Outcome
    from candata.gap.blind.running import Place, known, run_cases
    from candata.gap.blind.scoring import score_run
    from candata.gap.blind.shares import measure_shares
    from candata.reports.bench import bench_text, write_bench

    cases = read_cases(run.cases)
    places = [Place(path, run.scene or scene_of(path, case), case.sealed) for path, case in cases.items()]
    standing = known(run.out)
    left = [p for p in places if p.sealed not in standing]
    filled = _filled(run, left)
    with _countdown(len(left)) as told:
        results = run_cases(run.out, places, crew=run.crew, seed=run.seed, told=told, until=run.until)
    labels = open_labels(cases, read_labels(run.labels))
    done = [p for p in places if p.sealed in {r.sealed for r in results}]
    if len(done) < len(places):
        console.note(f"{len(done)} of {len(places)} cases in the time given; the same command goes on with the others")
    hiding = sum(bool(labels[p.folder.name].effects) for p in done)
    with console.progress("weighing true causes", hiding) as advance:
        shares = measure_shares(run.out, done, labels, crew=run.crew, told=advance)
    outcomes = [Outcome(labels[r.case], r, shares.get(r.case)) for r in results]
    followed = _followed(run, done, outcomes) if run.follow else []
    scenes = {p.scene for p in places}
    title = places[0].scene if len(scenes) == 1 else f"{len(scenes)} scenes"
    found = score_run(outcomes, scene=title, cases=len(places), filled=filled, followed=followed)
    if run.baselines:
        found = found.model_copy(update={"baselines": _beside(run, done, outcomes)})
    page = write_bench(found, run.out)
    console.out(found.model_dump_json(indent=2) if json else bench_text(found))
    console.note(f"score: {run.out / 'bench.json'}, {page}")


def _filled(run: _Run, left: Sequence[Place]) -> list[Filled]:
    """Return what has been simulated into the cache that the cases share, after simulating what they will need."""
    from candata.gap.blind.filling import FILLED, keep_signature, shared_tasks
    from candata.gap.blind.running import CACHE, finished, spread
    from candata.schema.bench import Filled

    tasks = shared_tasks(left, run.out / CACHE, run.seed)
    if tasks:
        with console.progress("simulating effects for all cases", len(tasks)) as advance:
            for _ in spread(run.out / FILLED, keep_signature, tasks, run.crew, run.until):
                advance(1)
    return finished(run.out / FILLED, Filled)


def _followed(run: _Run, places: list[Place], outcomes: list[Outcome]) -> list[Outcome]:
    """Return the ambiguous cases diagnosed again, with what their reports proposed recorded in their worlds."""
    from candata.gap.blind.following import follow_up, proposes

    asked = [o for o in outcomes if proposes(o.result)]
    if not asked:
        return []
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("recording what was proposed", len(asked)) as advance:
        found = follow_up(
            run.out, places, [o.result for o in asked], labels, crew=run.crew, seed=run.seed, told=advance
        )  # fmt: skip
    return [replace(o, result=found[o.label.case]) for o in asked]


def _beside(run: _Run, places: list[Place], outcomes: list[Outcome]) -> tuple[BenchFile, ...]:
    """Return the score of the diagnosis and of each baseline on the first cases."""
    from candata.gap.blind.baselines import run_baselines
    from candata.gap.blind.scoring import score_run

    some, count = outcomes[: run.baseline_cases], len(places[: run.baseline_cases])
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("baselines", count) as advance:
        found = run_baselines(
            run.out, places[:count], labels, run.baselines, crew=run.crew, seed=run.seed, told=advance
        )  # fmt: skip
    scores = [score_run(some, scene=places[0].scene, cases=count)]
    for method, results in found.items():
        theirs = [replace(o, result=r) for o, r in zip(some, results, strict=True)]
        scores.append(score_run(theirs, scene=places[0].scene, cases=count, method=method))
    return tuple(scores)


def _until(minutes: float | None) -> float:
    """Return the time [s since the epoch] from which on no case is begun."""
    return inf if minutes is None else time.time() + 60 * minutes


def _counts(kinds: str, counts: str, usual: dict[Kind, int]) -> dict[Kind, int]:
    """Return how many cases of each kind are asked for; `usual` has the kinds there are, and their numbers."""
    from candata.errors import UsageError

    given: dict[str, int] = {}
    for word in console.words(counts):
        name, _, number = word.partition("=")
        if not number.isdigit():
            raise UsageError("a count is not a number", expected="like one=120,null=40", found=word)
        given[name] = int(number)
    wanted = console.words(kinds)
    _known(",".join((*wanted, *given)), tuple(usual), "kind of case")
    return {kind: given.get(kind, number) for kind, number in usual.items() if kind in wanted}


def _known(text: str, names: Sequence[str], kind: str) -> tuple[str, ...]:
    """Return the words of a comma-separated list, each one of `names`."""
    from candata.errors import UnknownNameError

    for word in console.words(text):
        if word not in names:
            raise UnknownNameError(kind, word, names)
    return console.words(text)


def _fitness(fit: Fitness) -> list[str]:
    """Return what to say about the scene, a line each."""
    lines = []
    if fit.moving:
        lines.append(f"{fit.moving} joints follow their targets, correlation at least {fit.follows:.3f} ({fit.worst})")
    if fit.live:
        least = min(fit.live, key=lambda name: fit.moved[name])
        lines.append(f"{len(fit.live)} effects move a channel, the least {least} ({fit.moved[least]:.2g})")
    if fit.dead:
        why = "in these motions they move nothing, or too much to be simulated"
        lines.append(f"not drawn, since {why}: {', '.join(fit.dead)}")
    return lines


@contextmanager
def _countdown(total: int) -> Iterator[Callable[[CaseResult], None]]:
    """Yield what hears of each new result and says on stderr how many are done and the time left.

    The pace is that of the latest results: the first fill the cache and take longer.
    """
    stamps, done = deque([time.monotonic()], maxlen=LATEST), 0

    def told(result: CaseResult) -> None:
        nonlocal done
        done += 1
        stamps.append(time.monotonic())
        pace_s = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
        left = console.duration(pace_s * (total - done))
        console.note(f"{done} of {total}: {result.case}, {result.cpu_s:.1f} CPU s; about {left} left")

    yield told
