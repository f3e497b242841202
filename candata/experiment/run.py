"""Running an experiment: what stands is taken as it is, and a cell that fails takes only its own rows along."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from candata.datasets.durable import ensure_folder, exclusive_lock
from candata.datasets.writing import refused, write_text
from candata.errors import CandataError
from candata.experiment import sources
from candata.experiment.cells import Cell, CellRecord, cell_folder, digests, read_cell
from candata.experiment.plan import Entry, Plan
from candata.experiment.results import ExperimentTable, RepairFacts
from candata.experiment.table import Outcome, make_table
from candata.experiment.work import SEALS, Bench, Failure, WriteDiagnosis, dataset_of, make_set, run_cell, threads_of
from candata.schema.effect import EffectSetting
from candata.simulate.cluster import crew_of
from candata.simulate.crew import Crew

TABLE = "table.json"
#: Kinds that are made one after another, each with all processes; the others are made side by side.
_ALONE = ("data", "part", "diagnosis")


@dataclass
class _Run:
    """Which cells stand, and which failed."""

    bench: Bench
    crew: Crew
    threads: int
    records: dict[str, CellRecord] = field(default_factory=dict)
    folders: dict[str, Path] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def make(self, cells: Mapping[str, Cell]) -> None:
        """Make all cells that can be made."""
        names = digests(cells)
        pending = [name for name in cells if name not in self.records and name not in self.failed]
        while pending:
            for name in [n for n in pending if any(i in self.failed for i in cells[n].inputs.values())]:
                cause = next(i for i in cells[name].inputs.values() if i in self.failed)
                self.keep(cells[name], names[name], Failure(name, self.failed[cause]))
                pending.remove(name)
            ready = [n for n in pending if all(i in self.records for i in cells[n].inputs.values())]
            batch = [n for n in ready if cells[n].kind in _ALONE][:1] or ready
            if not batch:
                break
            for result in self._made([cells[name] for name in batch], names):
                self.keep(cells[result.name], names[result.name], result)
            pending = [name for name in pending if name not in batch]

    def _made(self, batch: list[Cell], names: Mapping[str, str]) -> list[CellRecord | Failure]:
        """Return what became of cells that need nothing of one another."""
        inputs = {c.name: {role: self.folders[n] for role, n in c.inputs.items()} for c in batch}
        if batch[0].kind in _ALONE:
            return [
                replace_name(make_set(cell, names[cell.name], inputs[cell.name], self.bench), cell.name)
                for cell in batch
            ]
        results: list[CellRecord | Failure] = []
        missing = []
        for cell in batch:
            folder = cell_folder(self.bench.out, cell, names[cell.name])
            standing = read_cell(folder, names[cell.name], inputs[cell.name])
            results += [replace_name(standing, cell.name)] if standing else []
            missing += [] if standing else [cell]
        # Two cells of one digest are one piece of work.
        first = {names[cell.name]: cell for cell in reversed(missing)}
        tasks = [
            (str(self.bench.out), c, names[c.name], {k: str(v) for k, v in inputs[c.name].items()}, self.threads)
            for c in reversed(first.values())
        ]
        if tasks:
            self.bench.stage(f"{len(tasks)} cells: {', '.join(task[1].name for task in tasks[:3])}")
        with closing(self.crew(run_cell, tasks)) as stream:
            for done in stream:
                same = [c for c in missing if names[c.name] == names[done.name]]
                results += [replace_name(done, c.name) for c in same]
                self.bench.stage(f"{done.name}: {'failed' if isinstance(done, Failure) else f'{done.seconds:.0f} s'}")
        return results

    def keep(self, cell: Cell, digest: str, result: CellRecord | Failure) -> None:
        """Keep what became of a cell."""
        if isinstance(result, Failure):
            self.failed[cell.name] = result.reason
            return
        self.records[cell.name] = result
        self.folders[cell.name] = cell_folder(self.bench.out, cell, digest)

    def outcome(self, **more: object) -> Outcome:
        """Return what the table is made of."""
        repairs = [
            RepairFacts(
                name=name,
                real_count=None if name.endswith("all") else int(name.rpartition("-")[2]),
                **{key: record.result[key] for key in ("verdict", "effects", "closed")},
            )
            for name, record in self.records.items()
            if record.kind == "diagnosis"
        ]
        return Outcome(self.folders, self.failed, tuple(repairs), **more)  # type: ignore[arg-type]


def replace_name(result: CellRecord | Failure, name: str) -> CellRecord | Failure:
    """Return the result under the name of a cell of the same digest."""
    return replace(result, name=name) if isinstance(result, Failure) else result.model_copy(update={"name": name})


def run_experiment(
    plan: Plan,
    out: Path,
    write_diagnosis: WriteDiagnosis,
    *,
    scale: float = 1.0,
    jobs: int = 1,
    ray: str | None = None,
    cache: Path | None = None,
    stage: Callable[[str], None] = lambda _words: None,
) -> ExperimentTable:
    """Return the table of an experiment after making its cells; written as `table.json` of `out`.

    Cells that stand are taken as they are. A set, a run or a diagnosis that was stopped goes on by its own means. The
    seals of worlds are opened once the table stands; it is then written again, with the floor.

    Parameters
    ----------
    plan : Plan
        Cells and entries.
    out : Path
        Folder of the experiment; made when missing.
    write_diagnosis : callable
        Writes `effects.yaml` and the report of a diagnosis into a folder; `candata.reports.write_diagnosis`.
    scale : float
        Share of the file's episodes and steps that the plan has; told in the table.
    jobs : int
        Processes.
    ray : str, optional
        Address of a Ray cluster for sets, runs and evaluations; `out` must be seen by all its machines.
    cache : Path, optional
        Where diagnoses keep what they simulated.
    stage : callable
        Hears what is being done.

    Raises
    ------
    UsageError
        When another process works on the same experiment.
    SetupError
        When `out` cannot be written, or the cluster cannot do the work.
    """
    with refused(out, "experiment"):
        ensure_folder(out)
    with exclusive_lock(out, "another process works on this experiment"), crew_of(jobs, ray, out) as crew:
        run = _Run(Bench(out, jobs, ray, write_diagnosis, stage, cache), crew, threads_of(jobs))
        run.make(plan.cells)
        written = _write(make_table(plan, run.outcome(), scale), out)
        floors, opened = _floors(plan, run)
        return _write(make_table(plan, run.outcome(floors=floors, opened=opened), scale), out) if opened else written


def _write(written: ExperimentTable, out: Path) -> ExperimentTable:
    """Return a table after writing it."""
    write_text(out / TABLE, written.model_dump_json(indent=1) + "\n", "table")
    return written


def _floors(plan: Plan, run: _Run) -> tuple[dict[str, Path], dict[str, tuple[str, ...]]]:
    """Return the evaluations of simulators with what the seals of the columns held, and that in words; opens them."""
    floors, opened, cells = {}, {}, dict(plan.cells)
    for entry in plan.entries:
        source_name = plan.file.columns[entry.column].real
        world = plan.file.data[source_name].sealed
        whole = f"data/{source_name}"
        if world is None or entry.model is not None or entry.cell not in run.records or entry.column in opened:
            continue
        seal = run.bench.out / SEALS / f"{plan.cells[whole].places['seal']}.json"
        try:
            effects = sources.opened_effects(seal, dataset_of(run.records[whole], run.folders[whole]))
        except CandataError as error:
            run.failed[f"seal of {entry.column}"] = str(error)
            continue
        opened[entry.column] = _in_words(effects, world.outside)
        if effects is not None and "simulator" in plan.file.rows:
            floors[entry.column] = _floor_cell(plan.cells[entry.cell], entry, effects)
    cells |= {cell.name: cell for cell in floors.values()}
    run.make(cells)
    return {title: run.folders[c.name] for title, c in floors.items() if c.name in run.folders}, opened


def _floor_cell(rows: Cell, entry: Entry, effects: tuple[EffectSetting, ...]) -> Cell:
    """Return the cell that evaluates the simulator with what a seal held."""
    truth = [effect.model_dump(mode="json") for effect in effects]
    settings = {**rows.settings, "rows": ["repaired simulator"], "truth": truth}
    inputs = {role: name for role, name in rows.inputs.items() if role != "effects"}
    return Cell("evaluation", f"evaluation/{entry.column}/floor", settings, inputs, rows.places)


def _in_words(effects: tuple[EffectSetting, ...] | None, outside: str | None) -> tuple[str, ...]:
    """Return what a seal held, in words."""
    if effects is None:
        return (f"{outside}, which is in no library",)
    return tuple(
        f"{effect.name}{f' of {effect.element}' if effect.element else ''} "
        + ", ".join(f"{name} {value}" for name, value in effect.parameters.items())
        for effect in effects
    )
