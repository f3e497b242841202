"""A finding: something in a recording that is no physics, with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass

from candata.errors import DataError, Where


@dataclass(frozen=True)
class RecordingMismatch:
    """What does not match between a recording and its scene.

    Attributes
    ----------
    kind : str
        Short name: `swapped_commands`, `command_unit`, `dead_joint`, ...
    definite : bool
        Whether no effect of the library could look like it: then nothing is diagnosed. Others are notes.
    problem, expected, found, fix : str
        The facts, as an error writes them.
    channel : str
        Where it shows.
    elements : tuple of str
        Joints, actuators or fingertips concerned; empty for all.
    """

    kind: str
    definite: bool
    problem: str
    expected: str
    found: str
    fix: str
    channel: str
    elements: tuple[str, ...] = ()

    def error(self) -> DataError:
        """Return the error that refuses the recordings."""
        return DataError(
            self.problem, expected=self.expected, found=self.found, where=Where(channel=self.channel), fix=self.fix
        )

    def note(self) -> str:
        """Return the finding as one sentence for the report."""
        return f"{self.problem}: {self.found}; {self.fix}"


@dataclass(frozen=True)
class Comparison:
    """What recordings say beside their scene.

    Attributes
    ----------
    findings : tuple of Finding
        What is no physics; definite ones first.
    undecidable : tuple of str
        Mistakes that they could hold and that nothing in them contradicts.
    """

    findings: tuple[RecordingMismatch, ...]
    undecidable: tuple[str, ...] = ()
