"""What a run is trained on: one dataset, or several in a mixture, each with its split."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from candata.datasets import Dataset
from candata.errors import UnknownNameError, UsageError
from candata.loaders import MixedWindows, Mixture, Split, Windows, find_split, mix, split_digest, windows
from candata.schema.json_text import parse_json
from candata.schema.record import Record
from candata.training import runs
from candata.training.settings import TrainingSource


@dataclass(frozen=True)
class TrainingData:
    """Datasets by name, one without a mixture, each with its split."""

    datasets: Mapping[str, Dataset]
    splits: Mapping[str, Split]
    mixture: Mixture | None

    def names_with_group(self, group: str) -> tuple[str, ...]:
        """Return the names of the datasets whose split fills a group."""
        return tuple(name for name in self.datasets if self.splits[name].ids(group))

    def feed(
        self, names: Sequence[str], group: str, reads: tuple[str, ...], window_options: Mapping[str, Any]
    ) -> Windows | MixedWindows:
        """Return the windows of a group, of the datasets named, mixed where there is a mixture.

        Raises
        ------
        CandataError
            As `windows` and `mix`.
        """
        channels = channels_for(reads, *self.datasets.values())
        feeds = {
            name: _windows(self.datasets[name], self.splits[name], channels, group, window_options) for name in names
        }
        if self.mixture is None:
            return next(iter(feeds.values()))
        parts = dict(zip(self.mixture.names, self.mixture.parts, strict=True))
        mixture_names = tuple(name for name in self.mixture.names if name in names)
        return mix(feeds, Mixture(names=mixture_names, parts=tuple(parts[name] for name in mixture_names)))

    def facts(self) -> dict[str, Any]:
        """Return the fields of a Run that say what was trained on."""
        shares = self.mixture.shares if self.mixture else dict.fromkeys(self.datasets, 1.0)
        sources = tuple(
            TrainingSource(
                name=name,
                share=share,
                dataset=self.datasets[name].name,
                digest=self.datasets[name].digest,
                version=self.datasets[name].version,
                split_digest=split_digest(self.splits[name]),
            )
            for name, share in shares.items()
        )
        if self.mixture is None:
            return {key: getattr(sources[0], key) for key in ("dataset", "digest", "version", "split_digest")}
        digests = {key: _joint([getattr(source, key) for source in sources]) for key in ("digest", "split_digest")}
        return {"dataset": str(self.mixture), "version": 0, "sources": sources, **digests}

    def split_record(self) -> Record:
        """Return what the run's folder keeps of who trains."""
        if self.mixture is None:
            return next(iter(self.splits.values()))
        return runs.Splits(splits={name: self.splits[name] for name in self.mixture.names})


def find_data(data: Dataset | Mapping[str, Dataset], mixture: Mixture | None, split: str | None) -> TrainingData:
    """Return the datasets with their splits.

    Raises
    ------
    UsageError
        When several datasets come without a mixture, or a mixture with one.
    UnknownNameError
        When the mixture names a dataset that is not given, or there is no such split.
    """
    datasets = {"": data} if isinstance(data, Dataset) else dict(data)
    if (mixture is None) != isinstance(data, Dataset):
        raise UsageError("several datasets need a mixture, and a mixture needs several", found=str(mixture))
    for name in mixture.names if mixture else ():
        if name not in datasets:
            raise UnknownNameError("source of the mixture", name, datasets)
    return TrainingData(datasets, {name: find_split(dataset, split) for name, dataset in datasets.items()}, mixture)


def _windows(
    dataset: Dataset, split: Split, channels: tuple[str, ...], group: str, window_options: Mapping[str, Any]
) -> Windows:
    """Return the windows of a group: presents up to the end of the episode, where the future is partly there."""
    window_options = {"channels": channels, "splits": split, "split": group, **window_options}
    if group == "train":
        windows(dataset, **window_options)  # refuses a horizon that no episode holds
    return windows(dataset, pad="both", **window_options)


def channels_for(channels: tuple[str, ...], *datasets: Dataset) -> tuple[str, ...]:
    """Return the channels to ask windows for: those the model reads, and clouds where all have one."""
    metadata_texts = (text for dataset in datasets for text in dataset.catalog()["meta"].to_pylist())
    return (
        (*channels, "point_cloud") if all(parse_json(text).get("point_cloud") for text in metadata_texts) else channels
    )


def _joint(digests: Sequence[str]) -> str:
    """Return one digest for several."""
    return hashlib.sha256(json.dumps(digests).encode()).hexdigest()
