"""The command that makes simulated sets: generate-sim."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console
from candata_cli.generate_report import tell_forecast, tell_set
from candata_cli.outputs import check_output
from candata_cli.recipe_option import use_recipe

if TYPE_CHECKING:
    from candata.errors import UsageError
    from candata.simulate.generate import Withheld
    from candata.simulate.recipe import SetRecipe

Out = Annotated[Path | None, typer.Option("--out", metavar="DATASET", help="Dataset to write or go on with.")]
Episodes = Annotated[int | None, typer.Option("--episodes", metavar="N", help="How many episodes.")]
Recipe = Annotated[
    Path | None,
    typer.Option(
        "--recipe",
        metavar="FILE",
        is_eager=True,
        callback=use_recipe,
        help="Options in a YAML file, such as `episodes: 8`; those typed go before.",
    ),
]
SceneName = Annotated[
    str | None,
    typer.Option("--scene", metavar="SCENE", help="Name or scene.yaml; else that of --effects or --randomise."),
]
Seed = Annotated[int, typer.Option("--seed", metavar="K", help="Seed of all that is random.")]
Objects = Annotated[
    str | None,
    typer.Option("--objects", metavar="A,B|FILE", help="Objects that take turns: names, folders, or an objects.yaml."),
]
Effects = Annotated[Path | None, typer.Option("--effects", metavar="FILE", help="Effects to apply: an effects.yaml.")]
Randomise = Annotated[
    Path | None, typer.Option("--randomise", metavar="FILE", help="Effects to draw anew for each episode.")
]
Policies = Annotated[str | None, typer.Option("--policies", metavar="A,B", help="Motions that take turns.")]
PolicyFile = Annotated[
    Path | None,
    typer.Option("--policy-file", metavar="FILE", help="Motions to play instead: motion.parquet of a diagnosis."),
]
PolicyModule = Annotated[
    str | None,
    typer.Option(
        "--policy-module",
        metavar="MODULE:F|FILE",
        help="Closed loop instead: package.module:function, FILE.py:function, or a network FILE.safetensors.",
    ),
]
Duration = Annotated[
    float, typer.Option("--duration-s", metavar="S", help="Length of an episode; a policy file has its own.")
]
WithNoise = Annotated[bool, typer.Option("--noise/--no-noise", help="Add the declared sensor noise.")]
NoiseFile = Annotated[
    Path | None, typer.Option("--noise-from", metavar="FILE", help="Sensor noise, as `noise` of a scene, in its place.")
]
Taxels = Annotated[bool, typer.Option("--taxels", help="Add what 120 taxels a fingertip count.")]
Jobs = Annotated[int | None, typer.Option("--jobs", metavar="J", help="Processes; all cores by default.")]
Withhold = Annotated[
    str | None, typer.Option("--withhold", metavar="EFFECT", help="Draw and hide an effect, or `any`.")
]
WithholdFrom = Annotated[
    Path | None, typer.Option("--withhold-from", metavar="FILE", help="Draw and hide effects as for --randomise, once.")
]
Seal = Annotated[Path | None, typer.Option("--seal", metavar="FILE", help="Sealed file; DATASET.seal.json by default.")]
Again = Annotated[
    str | None, typer.Option("--again", metavar="DATASET", help="Make one of its episodes again, and compare each bit.")
]
EpisodeId = Annotated[str | None, typer.Option("--episode", metavar="ID", help="The episode for --again.")]
Outcomes = Annotated[
    str | None,
    typer.Option("--outcomes", metavar="NAME:SHARE,..", help="Draw grip, aim and timing until the mix is met."),
]
Shard = Annotated[str, typer.Option("--shard", metavar="I/N", help="Make every N-th chunk from the I-th.")]
Ray = Annotated[str | None, typer.Option("--ray", metavar="ADDRESS", help=console.RAY)]
Strict = Annotated[bool, typer.Option("--strict", help="End at the first episode that cannot be made.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what the set would take; make nothing.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
#: Parameters that go together with --again: where things are now. All else is that of the episode.
BESIDE_AGAIN = ("out", "scene", "objects", "policy_file", "policy_module", "again", "episode")


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("generate-sim", epilog="Example: candata generate-sim --scene xhand_tabletop --episodes 8 --out sim")(
        generate_sim
    )


@console.stoppable()
def generate_sim(
    context: typer.Context,
    out: Out = None,
    episodes: Episodes = None,
    recipe: Recipe = None,
    scene: SceneName = None,
    seed: Seed = 1,
    objects: Objects = None,
    effects: Effects = None,
    randomise: Randomise = None,
    policies: Policies = None,
    policy_file: PolicyFile = None,
    policy_module: PolicyModule = None,
    duration_s: Duration = 3.2,
    noise: WithNoise = True,
    noise_from: NoiseFile = None,
    taxels: Taxels = False,
    jobs: Jobs = None,
    withhold: Withhold = None,
    withhold_from: WithholdFrom = None,
    seal: Seal = None,
    outcomes: Outcomes = None,
    shard: Shard = "1/1",
    ray: Ray = None,
    strict: Strict = False,
    dry_run: DryRun = False,
    again: Again = None,
    episode: EpisodeId = None,
    json: Json = False,
    salt: Annotated[str | None, typer.Option("--salt", hidden=True)] = None,
) -> None:
    """Simulate episodes into a dataset; the same command goes on after a stop and adds nothing twice.

    `--randomise` draws effects for each episode, as a file of distributions says; the seed decides them.
    `--withhold` draws an effect from the seed and a secret salt and keeps it out of the dataset; the sealed
    file holds all three. `--withhold-from` does so with one draw of a file of distributions, for all episodes.
    `--again` makes an episode of a dataset again from what is kept of it.
    `--outcomes success:0.5,fail:0.5` shares out how episodes end: success, slip, drop, miss, topple, or fail for any
    of the last four.
    An episode that cannot be made is left out, with its reason in the dataset, unless `--strict` is given.
    """
    if again is not None or episode is not None:
        return _make_again(context, again, episode, out, scene, objects, policy_file, policy_module)
    if out is None and not dry_run:
        raise _missing("--out DATASET")
    if episodes is None:
        raise _missing("--episodes N")
    if out is not None:
        sealed = seal or out.with_name(f"{out.name}.seal.json")
        check_output(out, "dataset")
    asked_set = _asked_set(context.params)
    scene_name, options = asked_set.scene, asked_set.options() | {"step_policy": policy_module}
    part = _shard(shard)
    if out is None or dry_run:
        from candata.simulate.forecast import forecast

        return tell_forecast(forecast(scene_name, episodes, seed, workers=jobs, shard=part, **options), json)
    from candata.simulate.generate import generate

    withheld = _withheld(withhold, withhold_from, sealed, salt)
    make_set = partial(
        generate, out, scene_name, episodes, seed, withheld=withheld, workers=jobs, ray=ray, shard=part, strict=strict
    )
    with console.stoppable(lambda: _kept_text(out), goes_on=True), _progress(episodes, part) as (advance, tally):
        version = make_set(**options, progress=advance, tally=tally, note=console.note)
    if withheld:
        console.note(f"withheld {'effect' if withhold else 'effects'} sealed in {withheld.seal}")
    tell_set(out, version, json)


@contextmanager
def _progress(
    episodes: int, shard: tuple[int, int]
) -> Iterator[tuple[Callable[[int], None], Callable[[Mapping[str, int]], None]]]:
    """Show progress, with the shares of outcomes so far; yield what counts episodes, and what hears of outcomes."""
    from candata.simulate.jobs import chunks

    seen: dict[str, int] = {}
    with console.progress("episodes", sum(len(chunk) for chunk in chunks(episodes, shard))) as advance:
        yield (lambda count: advance(count, console.shares_text(seen)), seen.update)


def _shard(text: str) -> tuple[int, int]:
    """Return which shard of how many is made."""
    from candata.errors import UsageError

    number, mark, count = text.partition("/")
    if not (mark and number.isdecimal() and count.isdecimal()):
        raise UsageError("--shard cannot be read", expected="such as 1/2", found=repr(text))
    return int(number), int(count)


def _asked_set(typed: Mapping[str, Any]) -> SetRecipe:
    """Return the set that the options ask for."""
    from candata.simulate.recipe import SetRecipe, check_count
    from candata.simulate.wanted import parsed_outcomes

    check_count(typed["episodes"], typed["seed"], typed["jobs"])
    values = {name: typed[name] for name in SetRecipe.model_fields}
    values |= {
        "scene": _scene(*(typed[name] for name in ("scene", "randomise", "withhold_from", "effects"))),
        "objects": _objects(typed["objects"]),
        "policies": tuple(typed["policies"].split(",")) if typed["policies"] else (),
        "outcomes": None if typed["outcomes"] is None else parsed_outcomes(typed["outcomes"]),
    }
    texts = {name: str(value) for name, value in values.items() if isinstance(value, Path)}
    return SetRecipe.parse(values | texts, "generate-sim")


def _withheld(effect_name: str | None, hidden_path: Path | None, seal: Path, salt: str | None) -> Withheld | None:
    """Return what is withheld: one effect, or a draw of a file."""
    from candata.effects import read_randomisation
    from candata.errors import UsageError
    from candata.simulate.generate import Withheld

    if effect_name is not None and hidden_path is not None:
        raise UsageError("--withhold and --withhold-from at once", fix="leave one of them out")
    hidden_file = read_randomisation(hidden_path) if hidden_path is not None else None
    if hidden_file is not None and (hidden_file.disturbances is not None or not hidden_file.effects):
        raise UsageError(
            "the file of --withhold-from does more than draw effects"
            if hidden_file.effects
            else "no effect to withhold",
            expected="effects alone",
            fix="give disturbances by --randomise, in a set of their own",
        )
    asked = hidden_file if hidden_file is not None else effect_name
    if asked is not None:
        check_output(seal, "file", "--seal")
    return None if asked is None else Withheld(asked, seal, salt)


def _make_again(
    context: typer.Context,
    again: str | None,
    episode_id: str | None,
    out: Path | None,
    scene: str | None,
    objects: str | None,
    policy_file: Path | None,
    policy_module: str | None,
) -> None:
    """Make an episode of a dataset again, say that it is the same, and store it where that is asked for."""
    if again is None or episode_id is None:
        raise _missing("--again DATASET" if again is None else "--episode ID")
    _refuse_beside_again(context)
    if out is not None:
        check_output(out, "dataset")
    from candata.simulate.repetition import repeat_episode, store_repeated

    dataset = console.open_named(again)
    repeated = repeat_episode(
        dataset,
        episode_id,
        scene=scene,
        objects=_objects(objects),
        policy_file=policy_file,
        step_policy=policy_module,
    )
    console.out(f"{episode_id}: bit-equal, {len(repeated)} rows of {len(repeated.arrays)} channels")
    if out is not None:
        version = store_repeated(out, dataset, repeated)
        console.out(f"{out}: version {version.number}, digest {version.digest[:12]}")


def _refuse_beside_again(context: typer.Context) -> None:
    """Refuse options that would ask for another episode than the one that is made again."""
    from candata.errors import UsageError

    given_options = [
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.name not in BESIDE_AGAIN and _is_typed(context, str(parameter.name))
    ]
    if given_options:
        raise UsageError(
            f"--again and {given_options[0]} at once",
            expected="what the episode was made with",
            fix="leave one of them out",
        )


def _is_typed(context: typer.Context, name: str) -> bool:
    """Tell whether an option stands on the command line; defaults do not."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _missing(option: str) -> UsageError:
    """Return the error for an option that is needed."""
    from candata.errors import UsageError

    name = option.split()[0]
    return UsageError(f"option {name} is missing", expected=option, fix="see candata generate-sim --help")


def _kept_text(out: Path) -> str:
    """Return how many episodes a run that was stopped leaves, published or not, as a clause."""
    from candata.datasets import pending_parts
    from candata.datasets.versions import DATASET, members_of, newest_version

    if not (out / DATASET).exists():
        return "nothing was written"
    version = newest_version(out)
    pending_count = sum(len(part.episodes) for part in pending_parts(out))
    return f"{pending_count + (len(members_of(out, version)) if version else 0)} episodes are kept in {out}"


def _objects(text: str | None) -> tuple[str, ...]:
    """Return the objects that are asked for, as names or folders; a file lists them."""
    from candata.scenes.object_folder import listed_objects

    if text is None:
        return ()
    return listed_objects(Path(text)) if text.endswith((".yaml", ".yml")) else console.words(text)


def _scene(scene: str | None, randomise: Path | None, withhold_from: Path | None, effects: Path | None) -> str:
    """Return the scene asked for, else the one of the file of effects that is given."""
    from candata.effects import read_effects, read_randomisation, scene_of
    from candata.errors import UsageError

    if scene is not None:
        return scene
    for path, read in ((randomise, read_randomisation), (withhold_from, read_randomisation), (effects, read_effects)):
        if path is not None:
            return scene_of(read(path), path)
    raise UsageError("no scene", expected="--scene NAME or scene.yaml", fix="see candata scene list")
