"""The card of a data set on the Hub: what its columns mean, in which unit, where it comes from, its licence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import yaml

from candata.datasets.elements import UNSCALED
from candata.hub.address import HubAddress
from candata.schema.exchange import ExportFile
from candata.schema.manifest import Lineage


def dataset_card(address: HubAddress, export: ExportFile, info: Mapping[str, Any], licence: str) -> str:
    """Return the text of `README.md`: what the Hub reads, then what people read.

    Parameters
    ----------
    address : HubAddress
        Where the set will be.
    export : ExportFile
        The sidecar of the export: columns with unit and frame, lineage.
    info : mapping
        `meta/info.json` of the export.
    licence : str
        Its licence, an SPDX name.
    """
    head = {
        "license": licence.lower(),
        "task_categories": ["robotics"],
        "tags": ["LeRobot", "candata"],
        "configs": [{"config_name": "default", "data_files": "data/*/*.parquet"}],
    }
    unscaled = {channel for episode in export.episodes for channel in episode.meta.unscaled}
    columns = [
        (column.key, UNSCALED if column.column in unscaled else column.unit, column.frame, column.meaning)
        for column in export.columns
    ]
    features = [
        (key, value["dtype"], "x".join(map(str, value["shape"])), ", ".join(value["names"] or ()))
        for key, value in info["features"].items()
    ]
    steps = [_step(lineage) for lineage in export.lineage]
    return f"""---
{yaml.safe_dump(head, sort_keys=False).rstrip()}
---
# {address.name}

{info["total_episodes"]:,} episodes, {info["total_frames"]:,} rows at {info["fps"]:g} Hz, exported by candata from
`{export.dataset}@{export.digest[:12]}` as a LeRobot set of version {info["codebase_version"]}. Licence: {licence}.

## Columns

SI units; quaternions w x y z; forces are what acts on the fingertip. `joint` stands for rad or m, as each joint
turns or slides. `observation.state` repeats columns in float32, for policies that read one vector.

{_table(("key", "unit", "frame", "meaning"), columns)}

## Features

{_table(("feature", "type", "shape", "names"), features)}

## Where it comes from

{chr(10).join(f"- {step}" for step in steps) or "- not stated"}

## Read it

```
candata import lerobot hf:{address.repository} --out {address.name}
```

restores the episodes exactly, by `meta/candata.json`. LeRobot's own loader reads the same files.
"""


def stated_licences(lineage: Iterable[Lineage]) -> set[str]:
    """Return the licences that a lineage states, its parents' too."""
    return {
        licence
        for step in lineage
        for licence in (
            *([str(step.details["licence"])] if step.details.get("licence") else []),
            *stated_licences(parent for parents in step.ancestry.values() for parent in parents),
        )
    }


def _step(lineage: Lineage) -> str:
    """Return one step of a lineage in a line."""
    return _plain(", ".join(_step_facts(lineage)))


def _step_facts(lineage: Lineage) -> Iterator[str]:
    """Yield what a step was."""
    yield lineage.operation
    if lineage.parents:
        yield f"from {' and '.join(lineage.parents)}"
    for name in ("source", "origin", "scene"):
        if isinstance(lineage.details.get(name), str):
            yield f"{name} {lineage.details[name]}"
    if lineage.revision:
        yield f"revision {lineage.revision}"
    yield from (f"{name} {version}" for name, version in sorted(lineage.tools.items()))


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    names = list(head)
    lines = [names, ["---"] * len(names), *([_plain(str(cell)) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _plain(text: str) -> str:
    """Return a text that stays in its cell and makes no markup."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("`", "'")
