"""Entry point: gathers the command groups of this folder and turns errors into exit codes.

A file of this folder that has `register(app)` adds its commands; there is no second table. Heavy imports
belong inside the commands, so that `--help` answers at once.
"""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Annotated, NoReturn

import typer
from typer.main import get_command_name

import candata_cli
from candata.errors import CandataError, SetupError, Where
from candata_cli.console import EXIT_STOPPED, StoppedRun
from candata_cli.help_layout import lay_out

#: What a shell sets to ask for completions. Source: click, "Shell Completion": `_PROGRAM_COMPLETE`.
COMPLETION = "_CANDATA_COMPLETE"

_HELP = """Say where a recording and its simulation differ, why, and how far that can be mended."""

_EXAMPLE = """\b
An example session:
  candata demo --out out/demo                              the whole path on built-in data
  candata import table map.yaml --out recordings           your recordings
  candata validate recordings
  candata inspect recordings
  candata diagnose recordings --scene scene.yaml --out out/report
  open out/report/report.html

\b
Exit codes: 0 fine, 1 a negative finding, 2 usage or data, 3 environment or device, 70 a fault of candata,
130 stopped by Ctrl-C.
"""


def build() -> typer.Typer:
    """Return the application with the commands of every file in this folder."""
    app = typer.Typer(
        help=_HELP,
        epilog=_EXAMPLE,
        callback=_root,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    for name in sorted(module.name for module in pkgutil.iter_modules(candata_cli.__path__)):
        register = getattr(importlib.import_module(f"candata_cli.{name}"), "register", None)
        if register is not None:
            register(app)
    lay_out(app)
    return app


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one command and exit with its code; `arguments` default to the process's own."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    _draw_in_children()
    interrupts: list[int] = []
    try:
        with _noting_interrupts(interrupts), _plain_plugin_warnings():
            app = build()
            if COMPLETION not in os.environ:
                _leave_unread(app, words)
            app(args=words, prog_name="candata")
        code: int | str | None = 0
    except StoppedRun as stop:
        code = _report_stop(stop, words)
    except KeyboardInterrupt:
        code = _report_stop(StoppedRun(), words)
    except CandataError as error:
        print(error, file=sys.stderr)
        code = error.exit_code
    except OSError as error:
        system_error = _system_error(error)
        print(system_error, file=sys.stderr)
        code = system_error.exit_code
    except SystemExit as error:
        # typer makes 1 of a reader that has gone (`candata ... | head`), which is no finding.
        reader_gone = isinstance(error.__context__, BrokenPipeError)
        # typer makes this code of a Ctrl-C that no command has put into words.
        code = _report_stop(StoppedRun(), words) if error.code == EXIT_STOPPED else 0 if reader_gone else error.code
    except Exception as error:
        # Compiled code that is being imported turns a Ctrl-C into an error of its own.
        code = _report_stop(StoppedRun(), words) if interrupts else _report_failure(error, words)
    _flush()
    sys.exit(code)


def _report_failure(error: Exception, words: Sequence[str]) -> int:
    """Print what candata did not expect and return the exit code."""
    from candata_cli.failures import EXIT_UNEXPECTED, expected_as, report

    expected_error = expected_as(error)
    print(expected_error or report(error, words), file=sys.stderr)
    return expected_error.exit_code if expected_error else EXIT_UNEXPECTED


@contextmanager
def _noting_interrupts(interrupts: list[int]) -> Iterator[None]:
    """Note in `interrupts` that Ctrl-C came, beside what it does; where it is ignored (a shell's job) it stays so."""

    def note(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        signal.default_int_handler(number, frame)

    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is note:
            signal.signal(signal.SIGINT, handler)


@contextmanager
def _plain_plugin_warnings() -> Iterator[None]:
    """Print what is wrong with another package's plug-in as its text alone; other warnings as ever."""
    usual_format = warnings.formatwarning

    def plain(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
    ) -> str:
        # By its name: importing its class would cost every command.
        if category.__name__ == "PluginWarning":
            return f"{message}\n"
        return usual_format(message, category, filename, lineno, line)

    warnings.formatwarning = plain
    try:
        yield
    finally:
        warnings.formatwarning = usual_format


def _report_stop(stop: StoppedRun, words: Sequence[str]) -> int:
    """Print what is kept and which command to type, and return the exit code; from now on Ctrl-C is not heard."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Python remembers a Ctrl-C that came while text was executed (a named tuple in an import, say), caught or not, and
    # would kill itself by the signal in the end; it forgets that when more text is executed.
    exec("")
    print(f"stopped: {stop.kept}" if stop.kept else "stopped", file=sys.stderr)
    verb = "go on" if stop.goes_on or stop.other else "begin again"
    print(f"  to {verb}: {shlex.join(['candata', *(stop.other or words)])}", file=sys.stderr)
    return EXIT_STOPPED


def _draw_in_children() -> None:
    """Keep the user's GL library for the processes that draw, and let MuJoCo load none here.

    Importing it fails where the library is not there, and where none is named it asks for one in a process of its own,
    which answers Ctrl-C with a traceback.
    """
    gl_library = os.environ.get("MUJOCO_GL", "")
    if gl_library != "off" or "CANDATA_GL" not in os.environ:
        os.environ["CANDATA_GL"] = gl_library
    os.environ["MUJOCO_GL"] = "off"


def _leave_unread(app: typer.Typer, words: Sequence[str]) -> None:
    """Take the options off the commands that the command line does not name: a list of commands shows none of them.

    Reading the options of all commands costs as much as loading them.
    """
    for info in app.registered_commands:
        if info.callback is not None and (name := info.name or get_command_name(info.callback.__name__)) not in words:
            info.name, info.help, info.callback = name, info.help or inspect.getdoc(info.callback), _placeholder
    for group in app.registered_groups:
        if group.typer_instance is not None:
            _leave_unread(group.typer_instance, words)


def _placeholder() -> None:
    """Stand for a command that is listed, not run."""


def _system_error(error: OSError) -> SetupError:
    """Return what the system said against a file, so that a user can act on it."""
    return SetupError(
        "the system refused",
        found=error.strerror or str(error) or type(error).__name__,
        where=Where(path=str(error.filename)) if error.filename is not None else None,
        fix="free space, or ask for the right to read or write there",
    )


def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Print the version, or the help where no command was given."""
    if version:
        from candata import __version__

        typer.echo(f"candata {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
    else:
        return
    raise typer.Exit


def _flush() -> None:
    """Flush stdout; a reader that has gone (`candata ... | head`) is no error."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
