"""The command `policy evaluate`: policies from held-out real starts in several worlds, one page for all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.effects_option import note_other_scene
from candata_cli.outputs import check_output
from candata_cli.torch_options import Device, Threads, need_torch, set_threads

if TYPE_CHECKING:
    from candata.policy_evaluation.seen import Withheld

Targets = Annotated[
    list[str],
    typer.Argument(
        metavar="[RUN|SCENE...] DATASET",
        help="Runs that are worlds, or the nominal scene (else the episodes' own); then the dataset.",
    ),
]
Policies = Annotated[Path, typer.Option("--policies", metavar="FILE", help="YAML list of {name, source}.")]
Effects = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Adds the simulator repaired by this effects.yaml.")
]
WithheldFile = Annotated[
    Path | None,
    typer.Option("--withheld", metavar="FILE", help="Stand-in for the real world: an effects.yaml, or a seal.json."),
]
Goal = Annotated[
    str | None,
    typer.Option("--goal", help="lift[:m[,s]], place:x,y, turn[:rad] or topple; else what each policy means."),
]
EXAMPLES = """\b
Examples:
  candata policy evaluate xhand_tabletop real --policies policies.yaml --effects effects.yaml
  candata policy evaluate runs/first real --policies policies.yaml --withheld hidden.yaml --out out/policies
"""


def register(app: typer.Typer) -> None:
    """Add `policy evaluate`; other files add to the group `policy`."""
    console.group(app, "policy", console.POLICY).command("evaluate", epilog=EXAMPLES)(evaluate)


@console.stoppable()
def evaluate(
    targets: Targets,
    policies: Policies,
    scene: Annotated[
        str | None, typer.Option("--scene", metavar="SCENE", help="The nominal scene, where it is not named before.")
    ] = None,
    effects: Effects = None,
    withheld: WithheldFile = None,
    goal: Goal = None,
    starts: Annotated[int, typer.Option("--starts", min=1, metavar="N", help="Most starts.")] = 50,
    duration_s: Annotated[
        float, typer.Option("--duration-s", min=0.1, metavar="S", help="Length of an episode.")
    ] = 3.2,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of all that is drawn.")] = 1,
    split: Annotated[str, typer.Option("--split", help="test, val or train of the runs' split, or all.")] = "test",
    joints: Annotated[
        str, typer.Option("--joints", help="What moves the joints of learned worlds: servo or simulator.")
    ] = "servo",
    samples: Annotated[int, typer.Option("--samples", min=1, help="Samples of each forecast.")] = 4,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Steps of the sampler.")] = 4,
    out: Annotated[Path, typer.Option("--out", help="Folder for the page.")] = Path("policies"),
    device: Device = "cpu",
    threads: Threads = None,
    version: Annotated[str | None, typer.Option("--version", help="Version of the dataset.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Play policies from held-out real starts in every world, and say which world predicts them best.

    Worlds: the nominal simulator, the repaired one, trained models. What was seen: recordings of the policies in the
    dataset, or a stand-in world. Writes policies.html, policies.json and the motion to record next.
    """
    *names, data = targets
    check_output(out, "folder")
    from candata.effects import read_effects
    from candata.policy_evaluation.evaluation import PolicyEvaluationSettings, evaluate_policies
    from candata.policy_evaluation.worlds import ModelSettings
    from candata.reports.policy_evaluation import summary, write_policy_evaluation

    runs, scene = _worlds(names, scene)
    if runs:
        need_torch()
        set_threads(threads)
    with console.stages() as stage:
        dataset = console.open_named(data, version)
        settings = PolicyEvaluationSettings(
            split,
            starts,
            duration_s,
            seed,
            goal,
            scene,
            None if effects is None else read_effects(effects).effects,
            _withheld(withheld),
            ModelSettings(samples, steps, None, joints, device),  # type: ignore[arg-type]
            threads or 1,
        )
        evaluation, exhibit = evaluate_policies(runs, dataset, policies, settings, stage)
        stage("writing the page")
        page = write_policy_evaluation(evaluation, exhibit, out)
    if effects is not None and exhibit is not None:
        note_other_scene(read_effects(effects), effects, exhibit.scene.digest)
    console.out(evaluation.model_dump_json(indent=2) if json else summary(evaluation))
    console.note(f"page: {page}")


def _worlds(names: list[str], scene: str | None) -> tuple[list[Path], str | None]:
    """Return which of the names are runs, and the scene; a folder or a checkpoint is a run."""
    from candata.errors import UsageError

    runs = [Path(name) for name in names if Path(name).is_dir() or name.endswith(".safetensors")]
    scenes = [*filter(None, [scene]), *(name for name in names if Path(name) not in runs)]
    if len(scenes) > 1:
        raise UsageError(
            "policies are evaluated in one scene",
            expected="folders of runs, one scene at most, and the dataset last",
            found=", ".join(scenes),
        )
    return runs, scenes[0] if scenes else None


def _withheld(path: Path | None) -> Withheld | None:
    """Return the stand-in for the real world."""
    if path is None:
        return None
    from candata.policy_evaluation.seen import withheld_effects

    return withheld_effects(path)
