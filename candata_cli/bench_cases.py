"""What `candata gap bench` is asked for, and the making of its cases: in one scene, or each in a random small one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from candata_cli import console

if TYPE_CHECKING:
    from candata.gap.blind.sanity import Fitness
    from candata.schema.bench import Kind
    from candata.simulate.crew import Crew

KINDS = ("one", "quarter", "null", "pair", "triple", "outside", "background", "solver", "local")
#: Episodes of a case and their length [s]: in one scene, and in random small ones (None: each scene draws its own).
IN_ONE, IN_SMALL = (20, 2.4), (12, None)
#: The scene of the self-check: light, so that a whole table takes minutes, not hours.
SCENE = "gripper_tabletop"


@dataclass(frozen=True)
class BenchRequest:
    """Which cases a run is asked to make; `scene` is empty for random small scenes, `salt` null for a secret one."""

    scene: str
    traits: tuple[str, ...]
    counts: dict[Kind, int]
    only: tuple[str, ...]
    seed: int
    episodes: int
    duration_s: float | None
    noise: str = "declared"
    salt: str | None = None


def bench_request(
    world: str | None,
    scene: str | None,
    traits: str,
    kinds: str,
    counts: str,
    only: str,
    seed: int,
    episodes: int | None,
    duration_s: float | None,
    noise: str = "declared",
) -> BenchRequest:
    """Return what a bench is asked for.

    Raises
    ------
    UsageError
        When options exclude each other.
    UnknownNameError
        When a name is unknown.
    """
    from candata.effects import effect_names
    from candata.errors import UsageError
    from candata.gap.blind.draws import COUNTS, NOISES

    listed_words(noise, tuple(NOISES), "kind of noise")
    if world is None:
        if traits:
            raise UsageError("--traits is for random small scenes", found=traits, fix="add --world random-small")
        case_counts, effect_list = _counts(kinds, counts, COUNTS), listed_words(only, effect_names(), "effect")
        return BenchRequest(
            scene or SCENE,
            (),
            case_counts,
            effect_list,
            seed,
            episodes or IN_ONE[0],
            IN_ONE[1] if duration_s is None else duration_s,
            noise,
        )
    from candata.gap.blind.rigs.cases import COUNTS as SMALL
    from candata.gap.blind.rigs.cases import WORLD as RANDOM
    from candata.gap.blind.rigs.causes import CAUSES
    from candata.gap.blind.rigs.design import all_traits

    listed_words(world, (RANDOM,), "world")
    if scene is not None:
        raise UsageError(
            "--scene and --world exclude each other: each case of a random world brings its own scene",
            found=f"--scene {scene} --world {world}",
            fix="leave one of the two out",
        )
    if noise != "declared":
        raise UsageError(
            "--noise is for cases in one scene: random small scenes draw whether their noise is declared",
            found=f"--noise {noise} --world {world}",
            fix="leave --noise or --world out",
        )
    default_kinds = kinds == ",".join(KINDS)
    case_counts = _counts(",".join(SMALL) if default_kinds else kinds, counts, SMALL)
    return BenchRequest(
        "",
        listed_words(traits, all_traits(), "trait"),
        case_counts,
        listed_words(only, tuple(CAUSES), "planted cause"),
        seed,
        episodes or IN_SMALL[0],
        duration_s,
    )


def make(out: Path, request: BenchRequest, crew: Crew) -> None:
    """Seal the labels of a run's cases and make those that are missing."""
    (_make_in_one if request.scene else _make_small)(out, request, crew)


def _make_in_one(out: Path, request: BenchRequest, crew: Crew) -> None:
    """Seal the labels of cases in one scene, and make those that are missing."""
    from candata.gap.blind.cases import make_cases, missing_cases
    from candata.gap.blind.labels import seal_labels
    from candata.gap.blind.sanity import check_scene
    from candata.scenes import load_scene

    world, seed, length = load_scene(request.scene), request.seed, request.duration_s or 0.0

    def live_effects() -> tuple[str, ...]:
        fit = check_scene(world, seed=seed, duration_s=length, only=request.only)
        for line in _fitness(fit):
            console.note(line)
        return fit.live

    sealed_labels = seal_labels(
        out,
        world,
        request.counts,
        seed=seed,
        episodes=request.episodes,
        duration_s=length,
        only=request.only,
        live=live_effects,
        noise=request.noise,
        salt=request.salt,
    )
    with console.progress("making cases", len(missing_cases(out, sealed_labels))) as advance:
        make_cases(
            out,
            request.scene,
            sealed_labels,
            seed=seed,
            episodes=request.episodes,
            duration_s=length,
            crew=crew,
            told=lambda _name: advance(1),
        )


def _make_small(out: Path, request: BenchRequest, crew: Crew) -> None:
    """Seal the labels of cases in random small scenes, and make those that are missing."""
    from candata.gap.blind.cases import missing_cases
    from candata.gap.blind.labels import LABELS
    from candata.gap.blind.rigs.cases import make_rig_cases, seal_rig_labels

    draws = 0 if (out / LABELS).exists() else sum(request.counts.values())
    with console.progress("drawing cases", draws) as advance:
        sealed_labels = seal_rig_labels(
            out,
            request.counts,
            seed=request.seed,
            episodes=request.episodes,
            duration_s=request.duration_s,
            traits=request.traits,
            only=request.only,
            crew=crew,
            told=lambda _name: advance(1),
            salt=request.salt,
        )
    with console.progress("making cases", len(missing_cases(out, sealed_labels))) as advance:
        make_rig_cases(
            out,
            sealed_labels,
            episodes=request.episodes,
            duration_s=request.duration_s,
            crew=crew,
            told=lambda _name: advance(1),
        )


def _counts(kinds: str, counts: str, default_counts: dict[Kind, int]) -> dict[Kind, int]:
    """Return how many cases of each kind are asked for; `default_counts` has the kinds there are, and their numbers."""
    from candata.errors import UsageError

    stated_counts: dict[str, int] = {}
    for word in console.words(counts):
        name, _, number = word.partition("=")
        if not number.isdigit():
            raise UsageError("a count is not a number", expected="like one=120,null=40", found=word)
        stated_counts[name] = int(number)
    kind_names = console.words(kinds)
    listed_words(",".join((*kind_names, *stated_counts)), tuple(default_counts), "kind of case")
    return {kind: stated_counts.get(kind, number) for kind, number in default_counts.items() if kind in kind_names}


def listed_words(text: str, names: Sequence[str], kind: str) -> tuple[str, ...]:
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
        slightest = min(fit.live, key=lambda name: fit.moved[name])
        lines.append(f"{len(fit.live)} effects move a channel, the least {slightest} ({fit.moved[slightest]:.2g})")
    if fit.dead:
        reason = "in these motions they move nothing, or too much to be simulated"
        lines.append(f"not drawn, since {reason}: {', '.join(fit.dead)}")
    return lines
