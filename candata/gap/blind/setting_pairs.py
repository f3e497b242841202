"""Labelled real recordings as a bench: every pair of settings is diagnosed, and the answers are held to the labels."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from math import inf
from pathlib import Path

import numpy as np

from candata.datasets import Dataset, append, create_dataset, open_dataset
from candata.datasets.cutting import pieces
from candata.datasets.drafts import draft_beside, place
from candata.datasets.writing import write_text
from candata.effects import read_effects
from candata.errors import CandataError, UsageError, Where
from candata.gap.blind.labelled_set import LabelledSet, pairs_of
from candata.gap.blind.runs import finished, spread
from candata.gap.diagnosis import diagnose, near_reference
from candata.gap.verdict.findings import simulator
from candata.scenes import Scene, load_scene
from candata.schema.bench import BenchFile, BenchRow, Miss
from candata.schema.episode import Episode
from candata.schema.labelled import LabelledSetFile, PairResult
from candata.schema.manifest import Lineage
from candata.schema.report import NamedEffect, Report
from candata.simulate import with_effects
from candata.simulate.crew import Crew

#: File in the folder of a labelled set, and what a run keeps.
PAIRS, SETTINGS, REQUEST = "pairs.jsonl", "settings", "request.json"
#: Folder of what a run keeps of each reference: the effects that bring the scene nearest to it.
REFERENCES = "references"
#: Targets [%]: nulls that may be named, nulls that are `no_gap`, changes named first or in their class, and coverage
#: of 90 % intervals. Chosen: what a user must be able to trust before changing a machine.
NULLS_NAMED, NULLS_RIGHT, CHANGES_RIGHT, COVERAGE = 0.0, 90.0, 85.0, (80.0, 95.0)
#: Largest median error of a size that counts as met [% of the label's ratio]. Chosen: a kitchen scale is better.
SIZE_ERROR = 20.0


def write_settings(labelled: LabelledSet, out: Path) -> None:
    """Write a dataset for each setting, and for each of its halves, unless it is there.

    The runs of a motion take turns between the halves, so that both hold every motion that was repeated.
    """
    for name, ids in labelled.episodes.items():
        runs = list(labelled.dataset.episodes(ids))
        turn: dict[str, int] = {}
        side = []
        for run in runs:
            turn[run.meta.task or ""] = turn.get(run.meta.task or "", -1) + 1
            side.append(turn[run.meta.task or ""] % 2)
        parts = {name: runs}
        if any(side):
            parts[f"{name}.first"] = [r for r, s in zip(runs, side, strict=True) if s == 0]
            parts[f"{name}.second"] = [r for r, s in zip(runs, side, strict=True) if s == 1]
        for part, members in parts.items():
            folder = out / SETTINGS / part
            if not folder.exists():
                with draft_beside(folder) as draft:
                    made = create_dataset(draft / "dataset", name=part)
                    append(made, list(_cut(members, labelled.file.cut_s)), Lineage(operation="gap real"))
                    place(made, folder)


def _cut(runs: Sequence[Episode], length_s: float | None) -> Iterator[Episode]:
    """Yield runs, or pieces of them that are `length_s` long."""
    for run in runs:
        yield from [run] if length_s is None else pieces(run, length_s)


def run_pairs(
    labelled: LabelledSet,
    out: Path,
    crew: Crew,
    seed: int = 0,
    until: float = inf,
    advance: Callable[[int], None] = lambda count: None,
) -> list[PairResult]:
    """Return the diagnoses of all pairs, those that stand in `out` first; each is written as it comes.

    Raises
    ------
    UsageError
        When what stands in `out` was asked for otherwise.
    """
    _keep_request(labelled, out, seed)
    write_settings(labelled, out)
    pairs = pairs_of(labelled)
    done = {(r.a, r.b): r for r in finished(out / PAIRS, PairResult)}
    advance(len(done))
    tasks = [(str(out), labelled.scene, labelled.effects, *p, seed) for p in pairs if (p.a, p.b) not in done]
    for result in spread(out / PAIRS, diagnose_pair, tasks, crew, until):
        done[result.a, result.b] = result
        advance(1)
    return [done[p.a, p.b] for p in pairs if (p.a, p.b) in done]


def _keep_request(labelled: LabelledSet, out: Path, seed: int) -> None:
    """Write down what is asked for, unless the same is there: answers to another question would be scored with it."""
    scene = _scene(labelled.scene, labelled.effects)
    digests = {"dataset": labelled.dataset.digest, "scene": scene.digest, "seed": seed}
    text = json.dumps({**digests, "labels": labelled.labels, "cut_s": labelled.file.cut_s}, indent=1) + "\n"
    path = out / REQUEST
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise UsageError(
            "the folder holds a run that was asked for something else",
            expected="the dataset, scene, labels and seed of the first command",
            where=Where(path=str(path)),
            fix="repeat the first command, or choose another --out",
        )
    out.mkdir(parents=True, exist_ok=True)
    write_text(path, text, "request")


def diagnose_pair(
    out: str, scene: str, effects: str | None, a: str, b: str, label: str | None, ratio: float | None, seed: int
) -> PairResult:
    """Return what the diagnosis of B against A says; runs in any process."""
    start, folder = time.process_time(), Path(out) / SETTINGS
    report: Report | None = None
    error = None
    try:
        data, reference = open_dataset(folder / b), open_dataset(folder / a)
        world = _world(Path(out) / REFERENCES / f"{a}.json", _scene(scene, effects), reference, seed)
        report = diagnose(data, world, seed=seed, against=reference, calibrate=False).report
    except CandataError as fault:
        error = str(fault)
    cpu_s = time.process_time() - start
    return PairResult(a=a, b=b, label=label, ratio=ratio, cpu_s=cpu_s, report=report, error=error)


def _scene(scene: str, effects: str | None) -> Scene:
    """Return a scene with the effects of a file as part of it."""
    plain = load_scene(scene)
    return plain if effects is None else with_effects(plain, read_effects(Path(effects)).effects)


def _world(kept: Path, scene: Scene, reference: Dataset, seed: int) -> Scene:
    """Return the scene fitted to a reference: fitted once, for all pairs with that reference."""
    if not kept.exists():
        near = near_reference(reference, scene, seed=seed)
        write_text(kept, simulator(near, ()).model_dump_json(indent=1), "reference")
    return with_effects(scene.plain or scene, read_effects(kept).effects)


def is_right(pair: PairResult, file: LabelledSetFile) -> bool:
    """Tell whether a pair's answer is right: its cause first or in the class, or `no_gap` for a null."""
    if pair.report is None:
        return False
    if pair.label is None:
        return pair.report.verdict == "no_gap"
    causes = set(file.causes[pair.label].effects)
    if pair.report.verdict == "ambiguous":
        return any(name.split(" ")[0] in causes for name in pair.report.ambiguous_class)
    return bool(pair.report.effects) and pair.report.effects[0].name in causes


def score_pairs(labelled: LabelledSet, results: Sequence[PairResult]) -> BenchFile:
    """Return the table of a labelled set: nulls, changes, sizes, coverage and cost, and the pairs that went wrong."""
    file = labelled.file
    nulls = [r for r in results if r.label is None]
    changes = [r for r in results if r.label is not None]
    second = [r for r in changes if any(e.name not in file.causes[r.label or ""].effects for e in _effects(r)[1:])]
    sizes = [s for r in changes if (s := _size(r, file)) is not None]
    errors = [100 * abs(value / true - 1) for value, true, _ in sizes]
    rows = (
        _share("nulls with an effect named", [bool(_effects(r)) for r in nulls], high=NULLS_NAMED),
        _share("nulls that are no_gap", [is_right(r, file) for r in nulls], low=NULLS_RIGHT),
        _share("changes named first, or in the class", [is_right(r, file) for r in changes], low=CHANGES_RIGHT),
        _share("changes with a wrong second name", [r in second for r in changes]),
        BenchRow(
            measure="median error of a size against the label",
            value=float(np.median(errors)) if errors else None,
            n=len(errors),
            high=SIZE_ERROR,
        ),
        _share("labels inside the 90 % interval", [inside for *_, inside in sizes], *COVERAGE),
        BenchRow(
            measure="median CPU s of a pair",
            value=float(np.median([r.cpu_s for r in results])) if results else None,
            n=len(results),
            unit="s",
        ),
    )
    order = {False: 0, True: 2, None: 3}
    return BenchFile(
        scene=Path(labelled.scene).name,
        cases=len(pairs_of(labelled)),
        done=len(results),
        rows=tuple(sorted((r for r in rows if r.n), key=lambda r: order[r.is_met])),
        misses=tuple(_miss(r) for r in results if not is_right(r, file)),
        confusion={},
        calibration=(),
    )


def _share(measure: str, hits: Sequence[bool], low: float | None = None, high: float | None = None) -> BenchRow:
    """Return the share of hits in per cent as a row."""
    value = 100 * float(np.mean(hits)) if hits else None
    return BenchRow(measure=measure, value=value, n=len(hits), low=low, high=high)


def _effects(result: PairResult) -> Sequence[NamedEffect]:
    """Return the named effects of a pair."""
    return result.report.effects if result.report else ()


def _size(result: PairResult, file: LabelledSetFile) -> tuple[float, float, bool] | None:
    """Return the found size, the label's ratio, and whether the interval holds it; None without either."""
    wanted = file.causes[result.label or ""].size
    if wanted is None or result.ratio is None:
        return None
    estimate = next((e.parameters.get(wanted.parameter) for e in _effects(result) if e.name == wanted.effect), None)
    if estimate is None or not isinstance(estimate.value, float):
        return None
    low = estimate.low if isinstance(estimate.low, float) else -inf
    high = estimate.high if isinstance(estimate.high, float) else inf
    return estimate.value, result.ratio, low <= result.ratio <= high


def _miss(result: PairResult) -> Miss:
    """Return a wrong answer as a row."""
    report = result.report
    named = ", ".join([e.name for e in _effects(result)] or (report.ambiguous_class if report else ()))
    fault = (result.error or "").partition("\n")[0]
    return Miss(
        case=f"{result.b} against {result.a}",
        kind="null" if result.label is None else "change",
        truth="nothing changed" if result.label is None else f"{result.label} changed",
        verdict=report.verdict if report else "error",
        named=named or "nothing",
        why=fault or ("not no_gap" if result.label is None else "not first"),
        gap=report.gap.before if report and report.gap else None,
    )
