"""Records of `labels.yaml`, the labels of real recordings, and of what a diagnosis said of two settings."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from candata.schema.record import Record, ResultRecord
from candata.schema.report import Report


class SizeLabel(Record):
    """The parameter whose size a label tells: its value in B over that in A is the ratio of the labels."""

    effect: str
    parameter: str


class LabelCause(Record):
    """What a label changes in the library's words: any of `effects` is right; `size` where the label has a size.

    Without effects the label changes nothing that can be measured: settings that differ in it alone are nulls.
    """

    effects: tuple[str, ...]
    size: SizeLabel | None = None


class LabelledSetFile(Record):
    """`labels.yaml`: a scene, a dataset, the table of settings, and what each of its labels changes.

    `dataset` may be left out where the command names it. `effects` is a file of effects that the scene holds already.
    `settings` is a CSV file with a row for each episode: `episode`, and a column for each label. Without it the labels
    are those that the episodes keep. Episodes whose labels are the same are one setting. Settings with the same text in
    the column `same` cannot be told apart by any measurement. `cut_s` cuts long runs into episodes of that length [s].
    """

    scene: str
    effects: str | None = None
    dataset: str | None = None
    settings: str | None = None
    causes: dict[str, LabelCause]
    same: str | None = None
    cut_s: Annotated[float, Field(gt=0)] | None = None


class PairResult(ResultRecord):
    """One line of `pairs.jsonl`: what the diagnosis of B against A said.

    `label` is what was changed, null for a null: two halves of one setting, or settings that cannot be told apart.
    `ratio` is the label's value in B over that in A, null where it is no number.
    """

    a: str
    b: str
    label: str | None
    ratio: float | None = None
    cpu_s: float
    report: Report | None = None
    error: str | None = None
