"""What an experiment found: `table.json`; lengths in SI, scores as shares from 0 to 1."""

from __future__ import annotations

from typing import Literal

from candata.schema.record import ResultRecord

Answer = Literal["nothing", "repair", "model", "both"]


class Value(ResultRecord):
    """A score with its 95 % interval over resampled episodes and seeds; null where there is none."""

    value: float | None
    low: float | None = None
    high: float | None = None


class PaperFigures(ResultRecord):
    """What arXiv 2601.12796 prints for a cell: ADD-S AUC, success and MSE (no unit); null where it prints none."""

    adds_auc: float | None = None
    success: float | None = None
    mse: float | None = None


#: Regimes from the one that answers for a model rather to the last.
PREFERRED_REGIMES = ("real-finetune", "real", "sim")


class Row(ResultRecord):
    """One row of the table: what forecasts, and how well on the test episodes of a column.

    Attributes
    ----------
    column, label : str
        Column, and name for people.
    model, regime, origin : str or None
        What was trained, how, and on which simulation; null for a row that is not trained.
    real_count : int or None
        Real training episodes it used; null for all.
    answer : str or None
        Which of the four answers it is: nothing (nominal simulator), repair, model, or both.
    seeds : int
        Runs averaged.
    adds_auc, success : Value
        Closed-loop ADD-S AUC at 0.1 m, and share of episodes that end within 5 cm; means over episodes and seeds.
    mse : Value
        Mean squared error of the six numbers of a pose increment (m, rad; units mixed, as the paper gives none).
    closed : Value
        Share of the gap that it closes: (AUC - AUC of the nominal simulator) / (AUC of the floor - the same).
    excess : float or None
        Closed-loop error over that of the floor, as in a diagnosis: the mean over position and rotation; 1 is the
        floor. Null without a floor.
    paper : PaperFigures or None
        What the paper has there.
    failed : str or None
        Why there are no scores.
    """

    column: str
    label: str
    model: str | None = None
    regime: str | None = None
    origin: str | None = None
    real_count: int | None = None
    answer: Answer | None = None
    seeds: int = 1
    adds_auc: Value = Value(value=None)
    success: Value = Value(value=None)
    mse: Value = Value(value=None)
    closed: Value = Value(value=None)
    excess: float | None = None
    paper: PaperFigures | None = None
    failed: str | None = None

    @property
    def regime_rank(self) -> int:
        """Place of its regime among those that answer for a model, the first one rather; 0 for what is not trained."""
        return PREFERRED_REGIMES.index(self.regime) if self.regime in PREFERRED_REGIMES else 0


class ColumnFacts(ResultRecord):
    """What a column was tested on.

    Attributes
    ----------
    real : str
        The real set in words: sealed, or public.
    test_episodes : int
        How many; fewer than 30 give no intervals.
    floor : str
        What the floor is, in words.
    floor_auc : float or None
        Its ADD-S AUC; 1 where no simulator of the true world is known.
    opened : tuple of str
        What the seal held, opened once the table was written.
    """

    real: str
    test_episodes: int
    floor: str
    floor_auc: float | None = None
    opened: tuple[str, ...] = ()


class RepairFacts(ResultRecord):
    """What a diagnosis of real training episodes said; `closed` is by its own measure, on its own held-out episodes."""

    name: str
    real_count: int | None
    verdict: str
    effects: tuple[str, ...]
    closed: float | None


class ExperimentTable(ResultRecord):
    """The table of an experiment.

    Attributes
    ----------
    title, headline : str
        Of the file; and what came out, in a sentence.
    scale : float
        Share of the file's episodes and steps that was used.
    findings, notes : tuple of str
        More of what came out; what a reader must know.
    columns : dict of str to ColumnFacts
        By name.
    rows : tuple of Row
        In the order of the file.
    repairs : tuple of RepairFacts
        One a diagnosis.
    failed : dict of str to str
        Cells that failed, with the reason.
    revision : str
        Version of candata.
    """

    format: str = "candata-experiment-1"
    title: str
    headline: str
    scale: float
    findings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    columns: dict[str, ColumnFacts]
    rows: tuple[Row, ...]
    repairs: tuple[RepairFacts, ...] = ()
    failed: dict[str, str]
    revision: str
