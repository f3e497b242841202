"""Run an example from one command: fetch or make its recordings, diagnose them, say where the report lies.

    python examples/run.py                                     # the examples there are
    python examples/run.py cube_tosses
    python examples/run.py elbow_tosses --from FOLDER          # published files that are here already
    python examples/run.py other_engine --hidden mass
    python examples/run.py real_servos --set so101_motions --from FOLDER

Each step is printed before it runs, so that it can be run, or changed, by hand. Recordings that stand in --out are not
made again; remove the folder for fresh ones.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent


class Step(NamedTuple):
    """One command, as `candata` or a script of this folder has it; it is skipped where what it `makes` is there."""

    words: tuple[str, ...]
    makes: Path | None = None


def _step(*words: str | Path, makes: Path | None = None) -> Step:
    """Return a step of words and paths."""
    return Step(tuple(map(str, words)), makes)


def _fetched(source: str, asked: argparse.Namespace, data: Path) -> Step:
    """Return the step that fetches published recordings, or reads them from a folder."""
    here = ("--from", asked.folder) if asked.folder else ()
    return _step("candata", "fetch", source, *here, "--out", data, makes=data / "dataset.json")


def _diagnosis(data: Path, scene: Path, report: Path, seed: int) -> Step:
    """Return the step that diagnoses recordings."""
    return _step("candata", "diagnose", data, "--scene", scene, "--out", report, "--seed", str(seed))


def _tosses(name: str, asked: argparse.Namespace) -> list[Step]:
    """Return the steps of real tosses."""
    folder, data, report = HERE / name, asked.out / name / "recordings", asked.out / name / "report"
    steps = [
        _fetched(name.replace("_", "-"), asked, data),
        _step("candata", "validate", data),
        _diagnosis(data, folder / "scene.yaml", report, asked.seed),
    ]
    compare = folder / "compare.py"
    return [*steps, _step(compare, report / "report.json")] if compare.exists() else steps


def _servos(name: str, asked: argparse.Namespace) -> list[Step]:
    """Return the steps of a robot without a model."""
    data, scene = asked.out / name / "recordings", asked.out / name / "scene"
    return [
        _fetched(name.replace("_", "-"), asked, data),
        _step("candata", "validate", data),
        _step("candata", "scene", "servo", "--dataset", data, "--out", scene, makes=scene / "scene.yaml"),
        _step(HERE / name / "report.py", "--dataset", data, "--scene", scene / "scene.yaml", "--seed", str(asked.seed)),
    ]


#: Real servo sets: the label that says most, and the episodes that are diagnosed: those in which the servo drives, and
#: of the longer sets a part that takes minutes. The arm is calibrated instead, on about half of its motions.
REAL_SERVOS = {
    "xl330_pendulum": ("kp", "task <> 'lift_and_drop'"),
    "so101_motions": ("kp", "length(id) % 2 = 0"),
    "rh56_contacts": ("speed", "id LIKE 'speed1000-limit%-0%'"),
}


def _real_servos(name: str, asked: argparse.Namespace) -> list[Step]:
    """Return the steps of real servos with labelled causes."""
    out, scene = asked.out / name / asked.set, HERE / name / asked.set / "scene.yaml"
    data, chosen = out / "recordings", out / "chosen"
    label, condition = REAL_SERVOS[asked.set]
    steps = [
        _fetched(asked.set.replace("_", "-"), asked, data),
        _step("candata", "validate", data),
        _step("candata", "registry", "filter", data, condition, "--out", chosen, makes=chosen / "dataset.json"),
        _step(HERE / name / "nominal.py", "--dataset", chosen, "--scene", scene, "--by", label),
    ]
    if asked.set == "so101_motions":
        return [*steps, *_calibration(HERE / name, data, chosen, scene, out, f"not ({condition})")]
    return [*steps, _diagnosis(chosen, scene, out / "report", asked.seed)]


def _calibration(folder: Path, data: Path, chosen: Path, scene: Path, out: Path, other: str) -> list[Step]:
    """Return the steps that fit a scene to 10 s of each chosen motion, and score it on the motions of a condition."""
    pieces, second, others, fitted = (out / n for n in ("pieces", "second_pieces", "others", "calibration.json"))
    return [
        _step("candata", "registry", "cut", chosen, "--length-s", "10", "--out", pieces, makes=pieces / "dataset.json"),
        _step(
            *("candata", "registry", "filter", pieces, "regexp_full_match(id, '.*-1')", "--out", second),
            makes=second / "dataset.json",
        ),
        _step(folder / "calibrate.py", "--dataset", second, "--scene", scene, "--out", fitted, makes=fitted),
        _step("candata", "registry", "filter", data, other, "--out", others, makes=others / "dataset.json"),
        _step(folder / "nominal.py", "--dataset", others, "--scene", scene, "--effects", fitted),
    ]


def _other_engine(name: str, asked: argparse.Namespace) -> list[Step]:
    """Return the steps of a world of another physics engine."""
    out = asked.out / f"{name}_{asked.hidden}"
    return [
        _step(HERE / name / "record.py", "--hidden", asked.hidden, "--out", out, makes=out / "recordings/dataset.json"),
        _diagnosis(out / "recordings", out / "scene.yaml", out / "report", asked.seed),
    ]


def _hand(withhold: str, *more: str) -> Callable[[str, argparse.Namespace], list[Step]]:
    """Return what makes the steps of a simulated hand with a hidden effect."""

    def steps(name: str, asked: argparse.Namespace) -> list[Step]:
        scene, data = HERE / name / "scene.yaml", asked.out / name / "recordings"
        drawn = ("candata", "generate-sim", "--scene", scene, *more, "--withhold", withhold, "--out", data)
        return [
            _step(*drawn, makes=data / "dataset.json"),
            _diagnosis(data, scene, asked.out / name / "report", asked.seed),
        ]

    return steps


EXAMPLES: dict[str, Callable[[str, argparse.Namespace], list[Step]]] = {
    "cube_tosses": _tosses,
    "elbow_tosses": _tosses,
    "g1_inspire_pick": _servos,
    "real_servos": _real_servos,
    "other_engine": _other_engine,
    "four_finger_hand": _hand("any", "--episodes", "10", "--duration-s", "2.5", "--seed", "4"),
    "shadow_hand": _hand("joint_damping", "--episodes", "8", "--duration-s", "2.0", "--seed", "3"),
}


def run(step: Step) -> int:
    """Return the exit status of a step, which is printed first."""
    script = [] if step.words[0] == "candata" else ["python"]
    print(f"\n$ {shlex.join([*script, *step.words])}", file=sys.stderr, flush=True)
    if step.makes is not None and step.makes.exists():
        print(f"{step.makes} is there already: skipped", file=sys.stderr, flush=True)
        return 0
    head = ("-m", "candata_cli.main") if step.words[0] == "candata" else (step.words[0],)
    return subprocess.run([sys.executable, *head, *step.words[1:]], check=False).returncode


def parsed(words: list[str] | None = None) -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=EXAMPLES, help="folder of the example")
    parser.add_argument("--out", type=Path, default=Path("out"), help="where recordings and reports go")
    parser.add_argument("--from", dest="folder", help="folder with the published files, where no network is to be used")
    parser.add_argument("--hidden", default="none", help="other_engine: none, mass, friction or damping")
    parser.add_argument("--set", choices=REAL_SERVOS, default="xl330_pendulum", help="real_servos: which recordings")
    parser.add_argument("--seed", type=int, default=0, help="of the diagnosis: folds, null replays, resamples")
    return parser.parse_args(words)


def main() -> None:
    """Run the steps until one fails."""
    asked = parsed(None if len(sys.argv) > 1 else ["--help"])
    for step in EXAMPLES[asked.name](asked.name, asked):
        status = run(step)
        if status:
            sys.exit(status)


if __name__ == "__main__":
    main()
