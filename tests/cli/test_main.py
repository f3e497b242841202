"""The entry point: discovery of commands, help, version, errors as exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
import types
from concurrent.futures.process import BrokenProcessPool

import pytest
import typer

from candata import __version__
from candata.errors import SetupError, UnknownNameError, Where
from candata_cli import main as entry


def exit_code(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        entry.main(arguments)
    return stop.value.code or 0


@pytest.fixture
def with_command(monkeypatch):
    """Put one more command group, made of a function, beside those of the folder."""

    def add(action) -> None:
        group = types.ModuleType("candata_cli.planted")
        group.register = lambda app: app.command("planted")(action)
        monkeypatch.setitem(sys.modules, "candata_cli.planted", group)
        listed = [types.SimpleNamespace(name="planted")]
        monkeypatch.setattr(entry.pkgutil, "iter_modules", lambda _path: listed)

    return add


def test_version_is_the_package_s(capsys):
    assert exit_code("--version") == 0
    assert capsys.readouterr().out == f"candata {__version__}\n"


def test_no_command_prints_help_with_an_example_session(capsys):
    assert exit_code() == 0
    text = capsys.readouterr().out
    assert "candata diagnose recordings --scene scene.yaml" in text
    assert "Exit codes: 0 fine" in text


def test_policies_are_evaluated_before_their_chunks_are_filtered_and_refined():
    policy = typer.main.get_command(entry.build()).commands["policy"]
    assert list(policy.commands) == ["evaluate", "filter", "refine"]


def test_every_command_shows_an_example_of_itself():
    def leaves(command, path=("candata",)):
        for name, one in getattr(command, "commands", {}).items():
            yield from leaves(one, (*path, name)) if hasattr(one, "commands") else [(" ".join((*path, name)), one)]

    told = dict(leaves(typer.main.get_command(entry.build())))
    assert len(told) > 30
    assert [words for words, one in told.items() if words not in (one.epilog or "")] == []


def test_a_file_with_register_is_a_command(with_command, capsys):
    with_command(lambda: typer.echo("here"))
    assert exit_code("planted") == 0
    assert capsys.readouterr().out == "here\n"


def test_an_error_is_its_text_on_stderr_and_its_exit_code(with_command, capsys):
    def fail() -> None:
        raise UnknownNameError("scene", "cube_tos", ["cube_toss"], Where(path="scene.yaml"))

    with_command(fail)
    assert exit_code("planted") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == (
        "unknown scene 'cube_tos'\n"
        "  expected: one of cube_toss\n"
        "  found: 'cube_tos'\n"
        "  where: scene.yaml\n"
        "  do: did you mean 'cube_toss'?\n"
    )


def test_a_missing_thing_of_the_machine_exits_3(with_command):
    def fail() -> None:
        raise SetupError("no space left")

    with_command(fail)
    assert exit_code("planted") == 3


def test_what_the_system_refuses_is_no_traceback(with_command, tmp_path, capsys):
    """A folder where a file should be: the error names it, and what the system said."""

    def write() -> None:
        (tmp_path / "taken").mkdir()
        (tmp_path / "taken").write_bytes(b"")

    with_command(write)
    assert exit_code("planted") == 3
    printed = capsys.readouterr().err
    assert printed.startswith("the system refused\n  found: Is a directory\n  where: ")
    assert str(tmp_path / "taken") in printed


def test_an_interrupt_exits_130(with_command):
    def interrupt() -> None:
        raise KeyboardInterrupt

    with_command(interrupt)
    assert exit_code("planted") == 130


def test_a_negative_finding_keeps_its_code(with_command):
    def negative() -> None:
        raise typer.Exit(1)

    with_command(negative)
    assert exit_code("planted") == 1


def test_a_fault_of_candata_is_a_short_text_a_file_and_a_code_of_its_own(with_command, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def broken() -> None:
        raise ZeroDivisionError("a secret place")

    with_command(broken)
    assert exit_code("planted") == 70
    printed = capsys.readouterr().err
    (kept,) = tmp_path.glob("candata-failure-*.txt")
    assert printed == (
        f"candata failed: ZeroDivisionError: a secret place\n  where: {kept}\n"
        "  do: report it with that file; it is a fault of candata, not of your data\n"
    )
    text = kept.read_text()
    assert text.startswith(f"candata {__version__}, Python 3")
    assert "candata planted\n" in text
    assert 'raise ZeroDivisionError("a secret place")' in text


def test_a_fault_where_nothing_can_be_written_is_told_whole(with_command, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))

    def broken() -> None:
        raise ZeroDivisionError

    with_command(broken)
    assert exit_code("planted") == 70
    assert "Traceback (most recent call last)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (MemoryError("Unable to allocate 9 TiB"), "out of memory\n  found: Unable to allocate 9 TiB\n"),
        (BrokenProcessPool(), "a worker process ended before its work\n"),
    ],
)
def test_what_the_machine_lacks_exits_3(with_command, capsys, error, text):
    def fail() -> None:
        raise error

    with_command(fail)
    assert exit_code("planted") == 3
    assert capsys.readouterr().err.startswith(text)


def test_an_unknown_command_is_a_usage_error(capsys):
    assert exit_code("no-such-command") == 2
    assert "no-such-command" in capsys.readouterr().err


def test_a_reader_that_leaves_is_no_error():
    code = "from candata_cli.main import main; main([])"
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, check=False)
    finally:
        os.close(write)
    assert done.stderr == b""
    assert done.returncode == 0


@pytest.mark.parametrize("words", [(), ("gap",)])
def test_help_lists_every_command_as_the_whole_application_does(words, capsys, monkeypatch):
    assert exit_code(*words, "--help") == 0
    listed = capsys.readouterr().out
    monkeypatch.setattr(entry, "_leave_unread", lambda _app, _words: None)
    assert exit_code(*words, "--help") == 0
    assert listed == capsys.readouterr().out


def test_help_reads_the_options_of_no_command_and_a_command_reads_its_own(capsys, monkeypatch):
    read = []
    options = typer.main.get_params_from_function
    monkeypatch.setattr(
        typer.main, "get_params_from_function", lambda func: read.append(func.__name__) or options(func)
    )
    of_all = {"install_callback", "show_callback", "_root"}  # completion and --version
    assert exit_code("--help") == 0
    assert {name for name in read if not name.startswith("_")} <= of_all
    read.clear()
    assert exit_code("gap", "bench", "--help") == 0
    assert {name for name in read if not name.startswith("_")} - of_all == {"bench"}
    assert "--counts" in capsys.readouterr().out


def test_help_loads_no_heavy_package():
    heavy = ("numpy", "scipy", "mujoco", "pyarrow", "pydantic", "jinja2", "zarr", "rich")
    code = (
        "import sys\nfrom candata_cli.main import main\n"
        "try: main(['--help'])\n"
        f"except SystemExit: print([name for name in {heavy!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


def test_a_gl_library_that_is_not_there_stops_no_command():
    """Importing MuJoCo fails then; only the processes that draw need it, and are told which was asked for."""
    code = (
        "import os, sys\nfrom candata_cli.main import main\n"
        "try: main(['doctor', '--json'])\n"
        "except SystemExit: import mujoco\n"
        "from candata.reports import render\nprint(render._libraries()[0], file=sys.stderr)"
    )
    env = {**os.environ, "MUJOCO_GL": "no-such-library"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env)
    assert done.stderr == "no-such-library\n"
