"""False alarms in random small scenes by trait, and planted causes recorded from rest and cut in motion.

    python benchmarks/small_scenes.py --each 4 --causes 2 --jobs 2 --out out/small_scenes

Every scene is drawn anew and played by plain MuJoCo (`candata/gap/blind/rigs`). Printed: for each trait, of scenes
without any cause, how many reports name an effect, how many say `unknown_effect`, how many `no_gap`; then, for each
planted cause, what is named and how much of the gap is closed where the episodes begin at rest and where the same scene
with the same cause is recorded in episodes cut from longer logs. Targets: no effect named, `unknown_effect` in at most
1 % of all; the same names, and shares closed within 5 points. A run that was killed goes on when it is given the same
--out; the cases of a new run are secret, so that no two runs have the same.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from candata.gap.blind.cases import CASE, CASES, read_cases, scene_of
from candata.gap.blind.labels import LABELS, open_labels, read_labels
from candata.gap.blind.outcomes import Outcome
from candata.gap.blind.rigs.cases import make_rig_case, make_rig_cases, seal_rig_labels
from candata.gap.blind.rigs.causes import CAUSES
from candata.gap.blind.rigs.design import ALSO_CUT, TRAITS
from candata.gap.blind.rigs.planted_world import drawn_cause, is_clear
from candata.gap.blind.rigs.recording import sane_rig
from candata.gap.blind.runs import Place, run_cases
from candata.schema.bench import CaseResult, Label, LabelsFile
from candata.simulate.crew import Crew, local
from candata.simulate.seal import canonical, commitment, new_salt, secret_number, write_once

#: Episodes of a case: what a small recording has.
EPISODES = 12
#: Targets: share of nulls that may come out as unknown [%], distance of the shares closed [points].
UNKNOWN_HIGH, CLOSED_APART = 1.0, 5.0
STYLES = ("plain", "cut")


def nulls(out: Path, trait: str, each: int, seed: int, crew: Crew) -> Path:
    """Return the folder with the cases of one trait, those that may be cut at rest and cut in turns."""
    folder = out / trait
    turns = (trait, f"{trait} cut") if trait in ALSO_CUT else (trait,)
    sealed = seal_rig_labels(folder, {"null": each, "one": 0}, seed=seed, episodes=EPISODES, traits=turns, crew=crew)
    make_rig_cases(folder, sealed, episodes=EPISODES, crew=crew)
    return folder


def pair(name: str, number: int, seed: int) -> list[Label]:
    """Return the labels of a cause in one scene, at rest and cut; the scene is drawn until it matters in both."""
    rng = np.random.default_rng(seed)
    while True:
        seed, given = drawn_cause(name, "plain", int(rng.integers(2**62)), EPISODES, None)
        rest, moving = (sane_rig(seed, style, EPISODES) for style in STYLES)
        if rest.rig.xml == moving.rig.xml and is_clear(moving, given):
            return [
                Label(case=f"case-{number:03d}-{style}", kind="one", effects=(given,), trait=style, seed=seed)
                for style in STYLES
            ]


def planted(out: Path, count: int, seed: int, crew: Crew) -> Path:
    """Return the folder with the cases of planted causes."""
    folder = out / "planted"
    if not (folder / LABELS).exists():
        salt = new_salt()
        rng = np.random.default_rng(secret_number(seed, salt, "rest and cut"))
        names = [str(n) for n in rng.permutation(list(CAUSES))[:count]]
        tasks = [(name, i, int(rng.integers(2**62))) for i, name in enumerate(names)]
        labels = {label.case: canonical(label) for both in crew(pair, tasks) for label in both}
        write_once(folder / LABELS, LabelsFile(salt=salt, asked={"seed": seed, "causes": count}, labels=labels))
    sealed = read_labels(folder / LABELS)
    cases = (folder / CASES).resolve()
    missing = {n: t for n, t in sealed.labels.items() if not (cases / n / CASE).exists()}
    for _ in crew(
        make_rig_case, [(str(cases / n), t, commitment(t, sealed.salt), EPISODES, None) for n, t in missing.items()]
    ):
        pass
    return folder


def diagnosed(folder: Path, crew: Crew) -> list[Outcome]:
    """Return the outcomes of a folder's cases; those that were diagnosed before are taken as they are."""
    cases = read_cases(folder / CASES)
    labels = open_labels(cases, read_labels(folder / LABELS))
    places = [Place(path, scene_of(path, case), case.sealed) for path, case in cases.items()]

    def told(result: CaseResult) -> None:
        print(f"  {folder.name} {result.case}: {result.cpu_s:.1f} CPU s", flush=True)

    return [Outcome(labels[r.case], r) for r in run_cases(folder, places, crew=crew, told=told)]


def null_table(groups: dict[str, list[Outcome]]) -> list[str]:
    """Return the rows of nulls by trait, and of all together."""
    every = [o for group in groups.values() for o in group]
    lines = [f"{'trait':<14}{'n':>5}{'named':>8}{'unknown':>9}{'no_gap':>8}{'CPU s':>8}"]
    for name, group in {**groups, "all": every}.items():
        spent = float(np.median([o.result.cpu_s for o in group])) if group else float("nan")
        counts = [sum(bool(o.named) for o in group), *(_verdicts(group, v) for v in ("unknown_effect", "no_gap"))]
        lines.append(f"{name:<14}{len(group):>5}{counts[0]:>8}{counts[1]:>9}{counts[2]:>8}{spent:>8.1f}")
    named, unknown = sum(bool(o.named) for o in every), _verdicts(every, "unknown_effect")
    met = named == 0 and unknown <= UNKNOWN_HIGH / 100 * len(every)
    lines.append(f"target: named 0, unknown <= {UNKNOWN_HIGH:g} % of all: {'met' if met else 'MISSED'}")
    return lines


def _verdicts(group: Sequence[Outcome], verdict: str) -> int:
    """Return how many came to a verdict."""
    return sum(o.verdict == verdict for o in group)


def pair_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the rows of planted causes, at rest beside cut."""
    by_case = {o.label.case: o for o in outcomes}
    lines, met = [f"{'cause':<22}{'at rest':<34}{'closed':>8}  {'cut':<34}{'closed':>8}"], True
    for name in sorted({case.rsplit("-", 1)[0] for case in by_case}):
        rest, moving = (by_case[f"{name}-{style}"] for style in STYLES)
        shares = [None if o.closed is None else 100 * o.closed for o in (rest, moving)]
        apart = abs(shares[0] - shares[1]) if None not in shares else (0.0 if shares[0] is shares[1] else 100.0)
        met &= rest.named == moving.named and apart <= CLOSED_APART
        cells = [
            f"{', '.join(o.named) or o.verdict:<34}{'-' if c is None else f'{c:.0f} %':>8}"
            for o, c in zip((rest, moving), shares, strict=True)
        ]
        lines.append(f"{rest.truth[0]:<22}{'  '.join(cells)}")
    lines.append(f"target: same names, closed within {CLOSED_APART:g} points: {'met' if met else 'MISSED'}")
    return lines


def run(out: Path, each: int, causes: int, seed: int, jobs: int) -> None:
    crew = local(jobs)
    groups = {trait: diagnosed(nulls(out, trait, each, seed, crew), crew) for trait in TRAITS} if each else {}
    pairs = diagnosed(planted(out, causes, seed, crew), crew) if causes else []
    for line in (null_table(groups) if groups else []) + (pair_table(pairs) if pairs else []):
        print(line)
    rows = {name: [(o.verdict, o.named) for o in group] for name, group in {**groups, "planted": pairs}.items()}
    out.mkdir(parents=True, exist_ok=True)
    (out / "small_scenes.json").write_text(json.dumps(rows, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=20, help="nulls of each trait")
    parser.add_argument("--causes", type=int, default=10, help="planted causes, each at rest and cut")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder of the run, which goes on there (default: a temporary one)")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        run(given.out or Path(folder), given.each, given.causes, given.seed, given.jobs)


if __name__ == "__main__":
    main()
