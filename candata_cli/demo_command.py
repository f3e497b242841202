"""The whole path on built-in data: withhold an effect, simulate, diagnose, open the seal."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.schema.effect import EffectSetting
    from candata.schema.report import Estimate, Report

SCENE = "xhand_tabletop"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("demo", epilog="Example: candata demo --out out/demo --seed 1")(demo)


def demo(
    seed: Annotated[int, typer.Option("--seed", metavar="K", help="Another seed hides another effect.")] = 1,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where everything goes.")] = Path("out/demo"),
    episodes: Annotated[int, typer.Option("--episodes", metavar="N", help="Episodes of each set.")] = 12,
    jobs: Annotated[int | None, typer.Option("--jobs", metavar="J", help="Processes; all cores.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Hide an effect in a simulated hand, find it from the data alone, compare with the truth.

    The salt of the seal follows from the seed here, so that a run can be repeated; `generate-sim --withhold`
    draws a secret one. The diagnosis reads the dataset and the nominal scene only.
    """
    check_output(out, "folder")
    from candata.datasets import open_dataset
    from candata.gap import diagnose
    from candata.reports import write_diagnosis
    from candata.scenes import load_scene
    from candata.simulate import open_seal
    from candata_cli.console import note, stages

    folder = out / f"seed-{seed}"
    scene, seal = load_scene(SCENE), folder / "real.seal.json"
    note(f"two sets of {episodes} episodes in {SCENE}: nominal, and `real` with a hidden effect")
    _generate(folder, seal, seed, episodes, jobs)
    dataset = open_dataset(folder / "real")
    with stages(with_bar=True) as stage:
        diagnosis = diagnose(dataset, scene, jobs=jobs or os.cpu_count() or 1, progress=stage, ends=stage.ends)
        stage.ends(None)
        stage("writing the report")
        page = write_diagnosis(diagnosis, scene, folder / "report")
    (truth,) = open_seal(seal, dataset)
    (_print_json if json else _print)(diagnosis.report, truth, page)


def _generate(folder: Path, seal: Path, seed: int, episodes: int, jobs: int | None) -> None:
    """Make the nominal set and the set with the hidden effect."""
    import hashlib

    from candata.simulate.generate import Withheld, generate
    from candata_cli.console import progress

    salt = hashlib.sha256(f"candata demo {seed}".encode()).hexdigest()
    withheld_effect = Withheld("any", seal, salt)
    for name, withheld in (("nominal", None), ("real", withheld_effect)):
        with progress(name, episodes) as advance:
            generate(folder / name, SCENE, episodes, seed, withheld=withheld, workers=jobs, progress=advance)


def judge(report: Report, truth: EffectSetting) -> str:
    """Return `found`, `found in a class`, or `missed`: how the verdict stands to the truth."""
    names = [effect.name for effect in report.effects]
    if names == [truth.name]:
        return "found"
    if truth.name in names:
        return "found among others"
    return "found in a class" if truth.name in report.ambiguous_class else "missed"


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


def _print(report: Report, truth: EffectSetting, page: Path) -> None:
    """Print the summary, then verdict beside truth, then where the report lies."""
    from candata.reports import summary
    from candata_cli.console import out, out_table

    out(summary(report))
    out("")
    out(f"seal opened: {truth.name}, {judge(report, truth)}")
    out_table(("", "hidden", "found", "90 % interval"), list(_rows(report, truth)))
    out("")
    out(f"report: {page}")


def _rows(report: Report, truth: EffectSetting) -> list[tuple[str, str, str, str]]:
    """Return a line a parameter of the hidden effect: its truth, and what the diagnosis says."""
    estimates: dict[str, Any] = {}
    for effect in report.effects:
        if effect.name == truth.name:
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
