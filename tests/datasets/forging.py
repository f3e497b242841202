"""A dataset changed by somebody who makes every hash agree again: only contents can tell."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from candata.datasets.parts import part_id_of
from candata.datasets.versions import digest_of


def forge(root: Path, change: Callable[[Path, dict], None], position: int = 0) -> None:
    """Change the files (and the manifest) of a part of the newest version; sizes, hashes and ids are made to agree."""
    path = sorted((root / "versions").glob("*.json"))[-1]
    version = json.loads(path.read_text())
    entry = version["parts"][position]
    folder = root / "parts" / entry["id"]
    manifest = json.loads((folder / "part.json").read_text())
    change(folder, manifest)
    for file in manifest["files"]:
        data = (folder / file["path"]).read_bytes()
        file |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest["id"] = part_id_of([tuple(pair) for pair in manifest["episodes"]])
    data = json.dumps(manifest).encode()
    (folder / "part.json").write_bytes(data)
    folder.rename(folder.with_name(manifest["id"]))
    entry |= {
        "id": manifest["id"],
        "sha256": hashlib.sha256(data).hexdigest(),
        "rows": manifest["rows"],
        "episodes": len(manifest["episodes"]),
    }
    members = {}
    for part in version["parts"]:
        listed = json.loads((root / "parts" / part["id"] / "part.json").read_text())
        members |= {episode: digest for episode, digest in listed["episodes"] if episode not in version["exclusions"]}
    version["digest"] = digest_of(members)
    path.write_text(json.dumps(version))
    for tag in (root / "tags").glob("*.json"):
        tag.unlink()  # they name the digest that was


def rewrite(path: Path, column: str, change: Callable[[list], list]) -> None:
    """Change a column of a Parquet file; everything else stays as it is."""
    table = pq.read_table(path, partitioning=None)
    index = table.schema.get_field_index(column)
    values = pa.array(change(table[column].to_pylist()), table.schema.field(index).type)
    pq.write_table(table.set_column(index, table.schema.field(index), values), path)


def nudged(values: list) -> list:
    """The same numbers, the first a little larger."""
    array = np.array(values)
    array.flat[0] += 1
    return array.tolist()


def lay(root: Path, remote: Path, name: str) -> None:
    """Write the newest version of a dataset to a folder as a push would that looks at nothing."""
    objects = remote / name / "objects"
    objects.mkdir(parents=True)
    for path in (path for path in (root / "parts").rglob("*") if path.is_file()):
        data = path.read_bytes()
        (objects / hashlib.sha256(data).hexdigest()).write_bytes(data)
    (remote / name / "dataset.json").write_bytes((root / "dataset.json").read_bytes())
    path = sorted((root / "versions").glob("*.json"))[-1]
    (remote / name / "versions").mkdir()
    (remote / name / "versions" / path.name).write_text(json.dumps({"version": json.loads(path.read_text())}))
