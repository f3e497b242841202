"""Lineage as a tree: what a version was made from, and what that was made from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from candata import __version__
from candata.datasets.dataset import Dataset
from candata.schema.manifest import Lineage


@dataclass(frozen=True)
class Origin:
    """A version in the tree.

    Attributes
    ----------
    dataset : str
        `name@digest`.
    steps : tuple of Step
        How it came to be, the first operation first.
    known : bool
        False where its lineage stands elsewhere in the tree, or was never recorded.
    """

    dataset: str
    steps: tuple[LineageStep, ...]
    known: bool = True


@dataclass(frozen=True)
class LineageStep:
    """One operation and the versions it took; `record` is its lineage without them."""

    record: Lineage
    parents: tuple[Origin, ...]


def label_of(dataset: Dataset) -> str:
    """Return `name@digest`, by which a lineage names a version."""
    return f"{dataset.name}@{dataset.digest}"


def derived_lineage(operation: str, parents: Sequence[Dataset], details: Mapping[str, Any]) -> Lineage:
    """Return the lineage of what an operation makes of versions, theirs included.

    Parameters
    ----------
    operation : str
        `filter`, `merge`, `relabel`.
    parents : sequence of Dataset
        What it takes; one given twice counts once.
    details : mapping
        What decides the result, as plain data.
    """
    seen_keys: set[str] = set()
    ancestry: dict[str, tuple[Lineage, ...]] = {}
    for parent in parents:
        if label_of(parent) not in ancestry:
            ancestry[label_of(parent)] = _untold(parent.lineage, seen_keys)
    return Lineage(
        operation=operation,
        parents=tuple(ancestry),
        tools={"candata": __version__},
        details=dict(details),
        ancestry=ancestry,
    )


def _untold(lineage: Sequence[Lineage], seen_keys: set[str]) -> tuple[Lineage, ...]:
    """Return a lineage without what `seen_keys` holds; `seen_keys` grows. Else a tree would double with each merge."""
    return tuple(step.model_copy(update={"ancestry": _new_ancestry(step.ancestry, seen_keys)}) for step in lineage)


def _new_ancestry(ancestry: Mapping[str, tuple[Lineage, ...]], seen_keys: set[str]) -> dict[str, tuple[Lineage, ...]]:
    """Return the ancestors that were not told."""
    new_ancestry = {}
    for label, lineage in ancestry.items():
        text = "\n".join([label, *(step.model_dump_json() for step in lineage)])
        key = hashlib.sha256(text.encode()).hexdigest()
        if key not in seen_keys:
            seen_keys.add(key)
            new_ancestry[label] = _untold(lineage, seen_keys)
    return new_ancestry


def tree(dataset: Dataset) -> Origin:
    """Return where a version comes from, as a tree."""
    return _origin(label_of(dataset), dataset.lineage)


def _origin(label: str, lineage: Sequence[Lineage] | None) -> Origin:
    """Return a version with its steps."""
    if lineage is None:
        return Origin(label, (), known=False)
    steps = [
        LineageStep(
            step.model_copy(update={"ancestry": {}}), tuple(_origin(p, step.ancestry.get(p)) for p in step.parents)
        )
        for step in lineage
    ]
    return Origin(label, tuple(steps))


def as_json(origin: Origin) -> dict[str, Any]:
    """Return the tree as plain data: `dataset`, `known`, and `steps` with their `parents`."""
    steps = [
        {
            **step.record.model_dump(mode="json", exclude={"parents", "ancestry"}),
            "parents": [as_json(parent) for parent in step.parents],
        }
        for step in origin.steps
    ]
    return {"dataset": origin.dataset, "known": origin.known, "steps": steps}


def lines(origin: Origin) -> Iterator[str]:
    """Yield the tree as text, a version or an operation a line."""
    name, _, digest = origin.dataset.rpartition("@")
    yield f"{name}@{digest[:12]}" + ("" if origin.known else "  (told elsewhere in this tree, or not recorded)")
    for number, step in enumerate(origin.steps):
        is_last = number == len(origin.steps) - 1
        yield f"{'└─' if is_last else '├─'} {_words(step.record)}"
        stem = "   " if is_last else "│  "
        for place, parent in enumerate(step.parents):
            final = place == len(step.parents) - 1
            inner = lines(parent)
            yield f"{stem}{'└─' if final else '├─'} from {next(inner)}"
            yield from (f"{stem}{'   ' if final else '│  '}{line}" for line in inner)


#: Longest text of one fact in a line; `--json` has all of it.
_FACT_LIMIT = 80


def _words(step: Lineage) -> str:
    """Return an operation and the facts of it that fit a line."""
    logs = [entry.get("log") for entry in step.details.get("logs", [])]
    facts = {name: value for name, value in step.details.items() if name != "logs"} | ({"log": logs[0]} if logs else {})
    more_logs = len(logs) - 1
    parts = [f"{name} {_short_text(value)}" for name, value in facts.items() if value not in (None, [], {}, "")]
    parts += [f"and {more_logs} more"] if more_logs > 0 else []
    parts += [f"seeds {', '.join(map(str, step.seeds))}"] if step.seeds else []
    parts += [f"config {step.config_digest[:12]}"] if step.config_digest else []
    parts += [f"revision {step.revision}"] if step.revision else []
    parts += [f"sealed {step.sealed[:12]}"] if step.sealed else []
    parts += [f"{tool} {version}" for tool, version in sorted(step.tools.items())]
    return "; ".join([step.operation, *parts])


def _short_text(value: object) -> str:
    """Return a value in a few words."""
    if isinstance(value, list) and all(isinstance(setting, dict) and "name" in setting for setting in value):
        value = ", ".join(_effect(setting) for setting in value)
    text = " ".join(str(value).split())
    return text if len(text) <= _FACT_LIMIT else text[: _FACT_LIMIT - 3] + "..."


def _effect(setting: Mapping[str, Any]) -> str:
    """Return an effect as `name[element](parameter value)`."""
    element = f"[{setting['element']}]" if setting.get("element") else ""
    values = ", ".join(f"{name} {value}" for name, value in (setting.get("parameters") or {}).items())
    return f"{setting['name']}{element}({values})"
