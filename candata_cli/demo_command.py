"""The whole path on built-in data: withhold an effect, simulate, diagnose, open the seal."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.reports import ReportContext
    from candata.schema.effect import EffectSetting
    from candata.schema.randomisation import RandomisationFile
    from candata.schema.report import Estimate, Report

#: The hand of the demo, and the lighter one of `--quick`.
SCENE, QUICK_SCENE = "xhand_tabletop", "gripper_tabletop"
#: Episodes of each set, and of each quick one: the fewest that a diagnosis takes.
EPISODES, QUICK_EPISODES = 12, 8
#: Joint of each scene that gets stiff.
STIFF_JOINTS = {SCENE: "mid1", QUICK_SCENE: "left_base"}


def _faults(scene: str) -> tuple[tuple[str, str | None, str, float, float], ...]:
    """Return what may be hidden: effect, element, parameter, least and largest value. Each is a fault of hardware.

    Ranges chosen: faults that a user would notice, and that the sensors of the scene show.
    """
    return (
        ("joint_dry_friction", STIFF_JOINTS[scene], "frictionloss_Nm", 0.08, 0.16),
        ("object_mass", None, "mass_scale", 1.5, 2.5),
        ("actuation_delay", None, "delay_s", 0.03, 0.06),
        ("sliding_friction", None, "scale", 0.35, 0.55),
        ("servo_gain", STIFF_JOINTS[scene], "kp_scale", 0.4, 0.6),
    )


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("demo", epilog="Example: candata demo --out out/demo --seed 1")(demo)


def demo(
    seed: Annotated[int, typer.Option("--seed", metavar="K", help="Another seed hides another fault.")] = 1,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where everything goes.")] = Path("out/demo"),
    episodes: Annotated[
        int | None,
        typer.Option("--episodes", metavar="N", help=f"Episodes of each set: {EPISODES}, {QUICK_EPISODES} if quick."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A gripper instead of the hand: about a minute.")] = False,
    jobs: Annotated[int | None, typer.Option("--jobs", metavar="J", help="Processes; all cores.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Hide a fault in a simulated hand, find it from the data alone, compare with the truth.

    The fault is one that hardware has: a stiff joint, a heavier object, a delay, slippery contacts, a weak servo.
    The salt of the seal follows from the seed here, so that a run can be repeated; `generate-sim --withhold`
    draws a secret one. The diagnosis reads the dataset and the nominal scene only.
    """
    check_output(out, "folder")
    from candata.datasets import open_dataset
    from candata.gap import diagnose
    from candata.reports import report_context, write_diagnosis
    from candata.scenes import load_scene
    from candata.simulate import open_seal
    from candata_cli.console import note, stages

    folder, name = out / f"seed-{seed}", QUICK_SCENE if quick else SCENE
    scene, seal = load_scene(name), folder / "real.seal.json"
    count = episodes or (QUICK_EPISODES if quick else EPISODES)
    note(f"two sets of {count} episodes in {name}: nominal, and `real` with a hidden fault")
    _generate(folder, name, seal, seed, count, jobs)
    dataset = open_dataset(folder / "real")
    with stages(with_bar=True) as stage:
        diagnosis = diagnose(dataset, scene, jobs=jobs or os.cpu_count() or 1, progress=stage, ends=stage.ends)
        stage.ends(None)
        stage("writing the report")
        context = report_context(diagnosis, scene, folder / "report")
        page = write_diagnosis(diagnosis, scene, folder / "report", context)
    (truth,) = open_seal(seal, dataset)
    if json:
        _print_json(diagnosis.report, truth, page)
    else:
        _print(diagnosis.report, context, truth, page)


def hidden_fault(scene: str, seed: int) -> RandomisationFile:
    """Return what a seed hides: one fault, its size still to be drawn."""
    from candata.schema.randomisation import Distribution, RandomEffect, RandomisationFile

    faults = _faults(scene)
    name, element, parameter, low, high = faults[(seed - 1) % len(faults)]
    size = Distribution(uniform=(low, high))
    return RandomisationFile(effects=(RandomEffect(name=name, element=element, parameters={parameter: size}),))


def _generate(folder: Path, scene: str, seal: Path, seed: int, episodes: int, jobs: int | None) -> None:
    """Make the nominal set and the set with the hidden fault."""
    import hashlib

    from candata.simulate.generate import Withheld, generate
    from candata_cli.console import progress

    salt = hashlib.sha256(f"candata demo {seed}".encode()).hexdigest()
    withheld_fault = Withheld(hidden_fault(scene, seed), seal, salt)
    for name, withheld in (("nominal", None), ("real", withheld_fault)):
        with progress(name, episodes) as advance:
            generate(folder / name, scene, episodes, seed, withheld=withheld, workers=jobs, progress=advance)


def judge(report: Report, truth: EffectSetting) -> str:
    """Return `found`, `found among others`, `found in a class`, or `missed`: how the verdict stands to the truth."""
    causes = [(effect.name, effect.element) for effect in report.effects]
    if causes == [(truth.name, truth.element)]:
        return "found"
    if (truth.name, truth.element) in causes:
        return "found among others"
    return "found in a class" if _label(truth) in report.ambiguous_class else "missed"


def _label(truth: EffectSetting) -> str:
    """Return the hidden fault as records name it."""
    return truth.name if truth.element is None else f"{truth.name} {truth.element}"


def _print_json(report: Report, truth: EffectSetting, page: Path) -> None:
    """Print verdict and truth as one JSON object."""
    from candata_cli.console import out_json

    record = {
        "verdict": report.verdict,
        "effects": [effect.model_dump(mode="json") for effect in report.effects],
        "class": list(report.ambiguous_class),
        "truth": truth.model_dump(mode="json"),
        "outcome": judge(report, truth),
        "report": str(page),
    }
    out_json(record)


def _print(report: Report, context: ReportContext, truth: EffectSetting, page: Path) -> None:
    """Print the summary, then verdict beside truth, then where the report lies."""
    from candata.reports import summary
    from candata_cli.console import out, out_table

    out(summary(report, context))
    out("")
    out(f"hidden fault: {_label(truth).replace(' ', ' on ')}, {judge(report, truth)}")
    out_table(("", "hidden", "found", "90 % interval"), list(_rows(report, truth)))
    out("")
    out(f"report: {page}")


def _rows(report: Report, truth: EffectSetting) -> list[tuple[str, str, str, str]]:
    """Return a line a parameter of the hidden effect: its truth, and what the diagnosis says."""
    estimates: dict[str, Any] = {}
    for effect in report.effects:
        if (effect.name, effect.element) == (truth.name, truth.element):
            estimates = dict(effect.parameters)
    lines = []
    for name, value in truth.parameters.items():
        estimate = estimates.get(name)
        if estimate is None:
            lines.append((name, _text(value), "-", "-"))
        else:
            lines.append((name, _text(value), _text(estimate.value), _span(estimate)))
    return lines


def _span(estimate: Estimate) -> str:
    """Return the interval of a parameter, or the one end that is known; a dash for none."""
    return {
        None: "-",
        "both": f"{_text(estimate.low)} .. {_text(estimate.high)}",
        "low": f"at least {_text(estimate.low)}",
        "high": f"at most {_text(estimate.high)}",
    }[estimate.bounded]


def _text(value: Any) -> str:
    """Return a number or a vector in four digits, a word as it is."""
    if isinstance(value, tuple):
        return "(" + ", ".join(map(_text, value)) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
