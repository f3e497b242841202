"""Help shows an example before anything else, cuts no description, and a shell can complete what is typed."""

from __future__ import annotations

import subprocess
import sys

import pytest
import typer

from candata_cli.main import build, main


def help_text(words, capsys, monkeypatch):
    """Return what a command prints as its help at 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    return capsys.readouterr().out


def summaries(command):
    """Yield the first sentence or paragraph of the help of each command of a group."""
    for child in command.commands.values():
        yield " ".join(child.help.split("\n\n")[0].split())


@pytest.mark.parametrize("words", [(), ("gap",), ("registry", "remotes")])
def test_a_list_of_commands_cuts_no_description(words, capsys, monkeypatch):
    group = typer.main.get_command(build())
    for word in words:
        group = group.commands[word]
    text = help_text(words, capsys, monkeypatch)
    # A long word may be parted at its hyphen.
    listed = "".join(text.split())
    assert [summary for summary in summaries(group) if "".join(summary.split()) not in listed] == []


@pytest.mark.parametrize("words", [("diagnose",), ("gap", "bench"), ("registry", "filter")])
def test_help_opens_with_an_example(words, capsys, monkeypatch):
    text = help_text(words, capsys, monkeypatch)
    example = text.index(f"candata {' '.join(words)}", text.index("Example"))
    assert example < text.index("Options:")
    assert text[: text.index("Example")].count("\n") <= 3


@pytest.mark.parametrize(("line", "completions"), [("candata gap be", "bench"), ("candata diagnose --sce", "--scene")])
def test_a_shell_completes_commands_and_options(line, completions):
    asked = {"_CANDATA_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    command = [sys.executable, "-m", "candata_cli.main"]
    done = subprocess.run(command, env=asked, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [completions]
    assert done.stderr == ""
