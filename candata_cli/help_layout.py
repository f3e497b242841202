"""How help is laid out: examples before options, and lists of commands whose descriptions are wrapped, never cut."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from typer.core import _click


class ExampleFirst(TyperCommand):
    """A command whose help shows its examples, then what it does, then its options."""

    def format_help(self, ctx: _click.Context, formatter: _click.HelpFormatter) -> None:
        """Write the help."""
        self.format_usage(ctx, formatter)
        self.format_epilog(ctx, formatter)
        self.format_help_text(ctx, formatter)
        self.format_options(ctx, formatter)


class WholeDescriptions(TyperGroup):
    """A group of commands that lists each with the whole first paragraph of its help."""

    def format_commands(self, ctx: _click.Context, formatter: _click.HelpFormatter) -> None:
        """Write the list."""
        rows = [(name, _first_paragraph(command)) for name, command in self.commands.items() if not command.hidden]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


def lay_out(app: typer.Typer) -> None:
    """Give all commands and groups of an application, at any depth, this layout."""
    app.info.cls = WholeDescriptions
    for command in app.registered_commands:
        command.cls = ExampleFirst
    for group in app.registered_groups:
        group.cls = WholeDescriptions
        if group.typer_instance is not None:
            lay_out(group.typer_instance)


def _first_paragraph(command: Any) -> str:
    """Return the first paragraph of a command's help on one line."""
    return " ".join(inspect.cleandoc(command.help or "").split("\n\n")[0].split())
