"""The error tree: every message says what was expected, what was found, where, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Where:
    """Place of a problem; only the parts that are known are printed."""

    path: str | None = None
    episode: str | None = None
    channel: str | None = None
    index: int | None = None

    def __str__(self) -> str:
        """Return the known parts as `path, episode E, channel C, index I`."""
        parts = [self.path] if self.path else []
        parts += [
            f"{label} {value}"
            for label, value in (
                ("episode", self.episode),
                ("channel", self.channel),
                ("index", self.index),
            )
            if value is not None
        ]
        return ", ".join(parts)


class CandataError(Exception):
    """A problem the user can act on; `exit_code` is what the command line returns."""

    exit_code = 2

    def __init__(
        self,
        problem: str,
        *,
        expected: str | None = None,
        found: str | None = None,
        where: Where | None = None,
        fix: str | None = None,
    ) -> None:
        """Keep the facts and write the text once.

        Parameters
        ----------
        problem : str
            One sentence that names the problem.
        expected, found : str, optional
            What was expected and what was found instead.
        where : Where, optional
            File, episode, channel and index.
        fix : str, optional
            What the user can do.
        """
        self.problem, self.expected, self.found = problem, expected, found
        self.where, self.fix = where or Where(), fix
        lines = [problem]
        lines += [
            f"  {label}: {text}"
            for label, text in (
                ("expected", expected),
                ("found", found),
                ("where", str(self.where)),
                ("do", fix),
            )
            if text
        ]
        super().__init__("\n".join(lines))


class UsageError(CandataError):
    """A wrong argument or a wrong file of the user's (exit 2)."""


class DataError(CandataError):
    """Data that does not hold what its schema promises (exit 2)."""


class RateError(DataError):
    """Stamps or a rate that are not those of the scene or of each other (exit 2)."""


class SceneError(CandataError):
    """A scene that names what its model lacks, or that does not compile (exit 2)."""


class ReachError(SceneError):
    """A path of the hand that what carries it cannot follow (exit 2)."""


class SetupError(CandataError):
    """The machine lacks something: an extra, space, a device (exit 3)."""

    exit_code = 3


#: Names listed where one is not known; of more, those nearest to it.
MOST_NAMES = 60


class UnknownNameError(UsageError):
    """A name that is not known; lists the known ones, or the nearest of many, and proposes one."""

    def __init__(self, kind: str, name: str, known_names: Iterable[str], where: Where | None = None):
        """Write the message from the kind of thing, the name given and the names known."""
        known_names = sorted(known_names)
        matches = difflib.get_close_matches(name, known_names, n=1)
        names_text = ", ".join(known_names) or "(none)"
        if len(known_names) > MOST_NAMES:
            nearest_names = difflib.get_close_matches(name, known_names, n=5, cutoff=0.0)
            names_text = f"{len(known_names):,}, the nearest {', '.join(nearest_names)}"
        super().__init__(
            f"unknown {kind} {name!r}",
            expected=f"one of {names_text}",
            found=repr(name),
            where=where,
            fix=f"did you mean {matches[0]!r}?" if matches else None,
        )


class MissingExtraError(SetupError):
    """A package of an optional extra is not installed."""

    def __init__(self, package: str, extra_name: str):
        """Write the one-line install hint."""
        super().__init__(f"{package} is not installed", fix=f'pip install "candata[{extra_name}]"')


class PluginError(SetupError):
    """A plug-in that another package brings cannot be used; `name` is the plug-in's."""

    def __init__(self, kind: str, name: str, package: str, *, expected: str, found: str, fix: str):
        """Write the message from the kind of plug-in, its name and the package it comes from."""
        super().__init__(
            f"{kind} {name!r} of package {package} cannot be used", expected=expected, found=found, fix=fix
        )
        self.name = name
