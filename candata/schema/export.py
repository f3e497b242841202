"""JSON Schemas of the records, generated: `python -m candata.schema.export schemas`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Literal

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from candata.schema.bench import BenchFile, CaseFile, Label, LabelsFile
from candata.schema.channels import CHANNELS, Channel
from candata.schema.effect import EffectsFile
from candata.schema.episode import EpisodeMeta
from candata.schema.exchange import ExportFile, FeatureMap
from candata.schema.manifest import DatasetFile, PartFile, TagFile, VersionFile
from candata.schema.object import ObjectFile, ObjectList
from candata.schema.policy_card import PolicyCard
from candata.schema.quarantine import QuarantineFile
from candata.schema.randomisation import RandomisationFile
from candata.schema.record import Record
from candata.schema.registry import RegistryFile, RemoteVersion
from candata.schema.report import Report
from candata.schema.scene import SceneFile, TableMap
from candata.schema.session import SessionFile
from candata.schema.topics import FramesMap, TopicMap

DIALECT = "https://json-schema.org/draft/2020-12/schema"

#: Files that people write, where defaults may be left out.
_READ_RECORDS: dict[str, type[Record]] = {
    "case": CaseFile,
    "effects": EffectsFile,
    "feature-map": FeatureMap,
    "frames": FramesMap,
    "label": Label,
    "labels": LabelsFile,
    "map": TableMap,
    "object": ObjectFile,
    "objects": ObjectList,
    "policy-card": PolicyCard,
    "randomisation": RandomisationFile,
    "scene": SceneFile,
    "topics": TopicMap,
}

#: Files that candata writes, where every key is present.
_WRITTEN_RECORDS: dict[str, type[Record]] = {
    "bench": BenchFile,
    "channel": Channel,
    "dataset": DatasetFile,
    "episode": EpisodeMeta,
    "export": ExportFile,
    "part": PartFile,
    "quarantine": QuarantineFile,
    "registry": RegistryFile,
    "remote-version": RemoteVersion,
    "report": Report,
    "session": SessionFile,
    "tag": TagFile,
    "version": VersionFile,
}


class _Complete(GenerateJsonSchema):
    """Generator for what candata writes: a key with a default is present too, so it is required."""

    def field_is_required(
        self,
        field: core_schema.ModelField | core_schema.DataclassField | core_schema.TypedDictField,
        total: bool,
    ) -> bool:
        """Return true for every field."""
        return True


def documents() -> dict[str, str]:
    """Return the text of every generated file by its name, the table of channels included."""
    read_schemas = {f"{name}.schema.json": _schema(record, "validation") for name, record in _READ_RECORDS.items()}
    written_schemas = {
        f"{name}.schema.json": _schema(record, "serialization") for name, record in _WRITTEN_RECORDS.items()
    }
    rows = [row.model_dump(mode="json") for row in CHANNELS.values()]
    return {**read_schemas, **written_schemas, "channels.json": _text(rows)}


def write(folder: Path) -> tuple[Path, ...]:
    """Write the generated files into `folder` and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, text in documents().items():
        path = folder / name
        path.write_text(text, encoding="utf-8")
        paths.append(path)
    return tuple(paths)


def _schema(record: type[Record], mode: Literal["validation", "serialization"]) -> str:
    """Return the schema of a record as it is read or as it is written."""
    generator = _Complete if mode == "serialization" else GenerateJsonSchema
    return _text({"$schema": DIALECT, **record.model_json_schema(mode=mode, schema_generator=generator)})


def _text(value: object) -> str:
    """Return JSON text, indented, with a final newline."""
    return json.dumps(value, indent=2) + "\n"


if __name__ == "__main__":
    write(Path(sys.argv[1] if len(sys.argv) > 1 else "schemas"))
