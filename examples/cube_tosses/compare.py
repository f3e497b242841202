"""Print diagnoses of the cube tosses beside the published rows of Acosta, Yang, Posa 2022 (arXiv 2110.00541).

    python examples/cube_tosses/compare.py out/cube_report/report.json
    python examples/cube_tosses/compare.py --dataset out/cube_tosses --out out/cube_splits --splits 5

The second form runs the diagnosis once a split: each seed draws other tosses for the search, and what the others show
is counted. A report that stands in --out is not made again, so a run that was cut goes on where it was.

The error is the study's: per toss the mean over frames of the position error in per cent of the cube's width and of
the rotation angle in degrees, then mean and standard deviation over tosses. Each rollout starts three frames before the
cube first comes within reach of the table. The study fitted its parameters on all 550 tosses; here the tosses that are
counted took no part in any fit.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from pathlib import Path

WIDTH_M = 0.1048
SCENE = Path(__file__).with_name("scene.yaml")
PUBLISHED = (
    ("Drake (published)", (13.5, 8.2, 16.5, 20.0)),
    ("Bullet (published)", (14.9, 8.9, 16.5, 20.2)),
    ("MuJoCo (published)", (25.1, 10.8, 21.7, 21.4)),
)
#: What the diagnosis is to reach, mean over splits: position in per cent of the width, rotation in degrees.
TARGET = (13.0, 18.5)

Row = tuple[float, float, float, float]


def row(report: dict, label: str) -> Row:
    """Return mean and spread of position [% of width] and rotation [deg]; `label` is before or after."""
    position, rotation = (report["measures"][k] for k in ("object_position_m", "object_rotation_deg"))
    share = 100 / WIDTH_M
    return share * position[label], share * position[f"{label}_sd"], rotation[label], rotation[f"{label}_sd"]


def named(report: dict) -> str:
    """Return the verdict and the named effects with their values."""
    effects = [
        f"{e['name']} {', '.join(v if isinstance(v, str) else f'{v:.4g}' for v in values(e))}"
        for e in report["effects"]
    ]
    return f"{report['verdict']}: {'; '.join(effects) or 'nothing named'}"


def values(effect: dict) -> list:
    """Return the values of an effect's parameters, vectors number by number."""
    found = [p["value"] for p in effect["parameters"].values()]
    return [x for v in found for x in (v if isinstance(v, list) else [v])]


def mean_row(rows: list[Row]) -> Row:
    """Return the mean of the rows, number by number."""
    return tuple(statistics.fmean(column) for column in zip(*rows, strict=True))  # type: ignore[return-value]


def table(reports: dict[str, dict]) -> list[str]:
    """Return the lines of the table: each report, their mean, the published rows, the targets."""
    before, after = ([row(r, label) for r in reports.values()] for label in ("before", "after"))
    lines = [f"{name:12}{named(r)}" for name, r in reports.items()]
    held = sorted({r["data"]["episodes"]["held_out"] for r in reports.values()})
    lines += ["", f"{', '.join(map(str, held))} held-out tosses a split", ""]
    lines += [f"{'':34}{'position, % of width':>22}{'rotation, deg':>18}"]
    rows = [("MuJoCo, nominal", mean_row(before)), ("MuJoCo, with the named effects", mean_row(after))]
    unnamed = [name for name, r in reports.items() if not r["effects"]]
    labels = [f"  {name}{' (names nothing)' if name in unnamed else ''}" for name in reports]
    each = list(zip(labels, after, strict=True)) if len(after) > 1 else []
    for name, (p, p_sd, r, r_sd) in (*rows, *each, *PUBLISHED):
        lines.append(f"{name:34}{p:>14.1f} +- {p_sd:4.1f}{r:>10.1f} +- {r_sd:4.1f}")
    lines.append(f"{'target':34}{TARGET[0]:>14.1f}{'':8}{TARGET[1]:>10.1f}")
    p, _, r, _ = mean_row(after)
    words = ["reached" if ok else "missed" for ok in (p <= TARGET[0], r <= TARGET[1])]
    lines += ["", f"position {words[0]}, rotation {words[1]}"]
    if unnamed:
        lines.append(f"{', '.join(unnamed)}: the errors are those of the best candidates; no repair is offered")
    return lines


def run_splits(dataset: Path, out: Path, count: int, jobs: int) -> dict[str, dict]:
    """Return the reports of `count` diagnoses, seeds 0 to count - 1; those that stand in `out` are read."""
    from candata.datasets import open_dataset
    from candata.gap import diagnose
    from candata.scenes import load_scene

    data, scene, reports = open_dataset(dataset), load_scene(SCENE), {}
    out.mkdir(parents=True, exist_ok=True)
    for seed in range(count):
        path = out / f"split-{seed}.json"
        if not path.exists():
            found = diagnose(data, scene, jobs=jobs, seed=seed, progress=lambda s, n=seed: note(f"split {n}: {s}"))
            path.write_text(found.report.model_dump_json(indent=1, by_alias=True))
        reports[path.stem] = json.loads(path.read_text())
    return reports


def called(path: Path) -> str:
    """Return what a report is called: by its folder where the file is a plain `report.json`."""
    return path.parent.name if path.name == "report.json" else path.stem


def note(text: str) -> None:
    """Print progress to stderr."""
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    """Read or make reports and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="*", type=Path, help="report.json of a diagnosis")
    parser.add_argument("--dataset", type=Path, help="run the diagnosis on these tosses")
    parser.add_argument("--out", type=Path, default=Path("out/cube_splits"), help="where its reports go")
    parser.add_argument("--splits", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1, help="threads; results do not depend on it")
    given = parser.parse_args()
    if bool(given.reports) == bool(given.dataset):
        parser.error("give either report files or --dataset")
    if given.splits < 1:
        parser.error("--splits must be 1 or more")
    if given.dataset:
        reports = run_splits(given.dataset, given.out, given.splits, given.jobs)
    else:
        reports = {called(path): json.loads(path.read_text()) for path in given.reports}
    for name, report in reports.items():
        if "object_position_m" not in report.get("measures", {}):
            parser.error(f"{name} measures no object: {report['verdict']}")
    print("\n".join(table(reports)))


if __name__ == "__main__":
    main()
