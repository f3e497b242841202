"""Commands around real hardware: `record-real` writes a log, `recover` salvages a torn one."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console, session_options
from candata_cli import record_options as options
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.record.addresses import StreamSource
    from candata.record.recorder_values import RecorderView, RecordingReport

_SHOW_S = 1.0
#: Option of a stream to its device.
_STREAM_DEVICES = {"arm": "xarm", "pose": "pose_lines", "wrench": "ft300"}

_RECORD_EXAMPLE = """\b
Examples:
  candata record-real --port /dev/ttyUSB0 --out hand.mcap
  candata record-real --port /dev/ttyUSB0 --session monday
"""
_RECOVER_EXAMPLE = """\b
Example:
  candata recover session.mcap
"""


def register(app: typer.Typer) -> None:
    """Add `record-real` and `recover`."""
    app.command("record-real", epilog=_RECORD_EXAMPLE)(record_real)
    app.command("recover", epilog=_RECOVER_EXAMPLE)(recover)


@console.stoppable("nothing was recorded")
def record_real(
    port: options.Port,
    out: options.Out = None,
    device: options.DeviceName = "xhand",
    duration: options.Duration = None,
    no_calibrate: options.NoCalibrate = False,
    calibrate_s: options.CalibrateS = 3.0,
    newton_per_count: options.NewtonPerCount = None,
    rate: options.Rate = None,
    baud: options.Baud = None,
    reconnect: options.Reconnect = 10.0,
    silence: options.Silence = None,
    reserve_mb: options.ReserveMb = 200,
    arm: options.Arm = None,
    pose: options.Pose = None,
    wrench: options.Wrench = None,
    stream: options.Stream = None,
    poll: options.Poll = None,
    session: options.SessionFolder = None,
    episodes: options.Episodes = None,
    gap: options.Gap = None,
    start_on_contact: options.StartOnContact = False,
    threshold: options.Threshold = 0.3,
    release: options.Release = None,
    plain_text: options.PlainText = False,
    as_json: options.AsJson = False,
) -> None:
    """Record a real hand and what is beside it: listen, calibrate, log every byte and what it says, until Ctrl-C."""
    from candata.record.poll import read_posture
    from candata.record.recorder import record
    from candata.record.recorder_values import SILENCE_S, RecorderSettings
    from candata.record.replay import hand_source

    out = session_options.check_session(out, session, episodes, gap, start_on_contact, silence)
    hand = hand_source(device, port)
    sources = [*hand.streams, *_sources({"arm": arm, "pose": pose, "wrench": wrench}, stream or [])]
    if duration is not None:
        _positive("duration", duration)
    _positive("calibrate_s", calibrate_s)
    plan, whole_s = session_options.session_plan(episodes, gap, start_on_contact, duration)
    overrides = _overrides({"newton_per_count": newton_per_count, "rate_hz": rate, "baud": baud}, session)
    settings = RecorderSettings(
        duration_s=whole_s,
        contact=session_options.contact_rule(threshold, release),
        calibrate_s=0.0 if no_calibrate else calibrate_s,
        reconnect_s=reconnect,
        silence_s=silence or SILENCE_S,
        reserve_bytes=reserve_mb * 1_000_000,
        poll_rad=None if poll is None else read_posture(poll, hand.device),
    )
    with (
        console.stoppable(partial(_kept_text, out)),
        _until_signal() as stop,
        _live_view(f"candata record-real {port}", plain_text, as_json) as (show, say),
        session_options.running_session(session, plan, not (plain_text or as_json), say) as marks,
    ):
        rest: dict[str, Any] = {"settings": settings, "session": marks, "streams": sources}
        rest["overrides"] = {**hand.settings, **overrides}
        report = record(hand.device, hand.port, out, name=hand.name, stop=stop, show=show, say=say, **rest)
    _tell(report, as_json, whole_s)


def _overrides(stated_settings: dict[str, float | None], session: Path | None) -> dict[str, Any]:
    """Return the values of the log's metadata that replace the device's own."""
    overrides: dict[str, Any] = {
        name: _positive(name, value) for name, value in stated_settings.items() if value is not None
    }
    return overrides | ({} if session is None else {"session": session.resolve().name})


def _tell(report: RecordingReport, as_json: bool, duration_s: float | None) -> None:
    """Print a report; raise what ended the recording before its time."""
    if as_json:
        console.out_json(report.facts)
    else:
        _print_report(report.facts)
    if report.failure is not None:
        raise report.failure
    if duration_s is not None and report.facts["ended"] == "stopped":
        raise _cut_short(report.facts)


def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log without an end, such as that of a killed recorder.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="New file; else NAME.recovered.mcap beside the log.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was saved as JSON.")] = False,
) -> None:
    """Write what can be read of a torn log as a whole new file; the original is left as it is."""
    from candata.record.recover import recover as salvage

    if out is not None:
        check_output(out, "new")
    report = salvage(log, out)
    session_file = session_options.restored_session(report)
    if as_json:
        console.out_json(vars(report))
        return
    state = "torn" if report.torn else "whole"
    damage_text = f", {report.damaged_chunks} damaged chunks left out" if report.damaged_chunks else ""
    console.out(f"{report.log} is {state}: {report.read_bytes} of {report.total_bytes} bytes read{damage_text}")
    console.out(f"{report.out}: {sum(report.messages.values())} messages over {report.duration_s:.2f} s")
    if session_file is not None:
        console.out(f"{session_file}: the marks and episodes of the session")
    console.out_table(("topic", "messages"), sorted(report.messages.items()))


def _sources(by_option: dict[str, str | None], texts: list[str]) -> list[StreamSource]:
    """Return the streams that the options name."""
    from candata.record.addresses import parse_stream, stream_source

    named = [
        stream_source(name, _STREAM_DEVICES[name], place) for name, place in by_option.items() if place is not None
    ]
    return named + [parse_stream(text) for text in texts]


def _cut_short(facts: dict[str, Any]) -> console.StoppedRun:
    """Return what is kept of a recording that was to last longer."""
    log = Path(facts["log"])
    states = f"{facts['rows']} states over {facts['duration_s']:.1f} s are kept in {log}, whole"
    return console.StoppedRun(states, next_command=_next_command(log))


def _next_command(out: Path) -> tuple[str, ...]:
    """Return the words of the command that goes on with a log."""
    return "import", "log", str(out), "--out", "DATASET"


def _kept_text(out: Path) -> str:
    """Return what a recorder leaves that was not allowed to end its log, as a clause."""
    return f"{out} holds what was flushed; candata recover makes it whole" if out.exists() else "nothing was recorded"


def _positive(name: str, value: float) -> float:
    """Return a setting that must be above zero."""
    from candata.errors import UsageError

    if not 0 < value < float("inf"):
        option = f"--{name.removesuffix('_hz').replace('_', '-')}"
        raise UsageError(f"{option} must be above zero", expected="a finite number", found=str(value))
    return value


@contextmanager
def _until_signal() -> Iterator[Callable[[], bool]]:
    """Yield `stop()`, true once SIGINT, SIGTERM or SIGHUP came; a second one ends the program as ever.

    A SIGHUP that is ignored stays so: under nohup a recording outlives its terminal.
    """
    import signal

    came: list[int] = []
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    handlers = {int(number): signal.getsignal(number) for number in numbers}

    def note(number: int, _frame: Any) -> None:
        came.append(number)
        # A signal that ends the process at once would leave the terminal without its echo.
        signal.signal(number, signal.default_int_handler if handlers[number] == signal.SIG_DFL else handlers[number])

    for number in numbers:
        signal.signal(number, note)
    try:
        yield lambda: bool(came)
    finally:
        for signal_number, handler in handlers.items():
            signal.signal(signal_number, handler)


@contextmanager
def _live_view(
    title: str, plain_text: bool, notes_only: bool
) -> Iterator[tuple[Callable[[RecorderView], None], Callable[[str], None]]]:
    """Yield `show(view)` and `say(text)`: a panel on a terminal, a line a second elsewhere; only notes when quiet."""
    import sys
    from contextlib import suppress

    say = _while_seen(console.note)
    if notes_only:
        yield (lambda view: None), say
    elif plain_text or not sys.stderr.isatty():
        yield _while_seen(_each_second()), say
    else:
        from rich.console import Console
        from rich.live import Live

        from candata.record.panel import panel

        notes: list[str] = []
        live_panel = Live(console=Console(stderr=True), auto_refresh=False)
        with suppress(OSError):
            live_panel.start()
        try:
            yield _while_seen(lambda view: live_panel.update(panel(view, title, notes), refresh=True)), notes.append
        finally:
            with suppress(OSError):
                live_panel.stop()
        for text in notes:
            say(text)


def _while_seen(tell: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return `tell` as long as it can be seen: a recording goes on when its terminal or pipe is closed."""
    closed_streams: list[bool] = []

    def tell_safely(value: Any) -> None:
        try:
            if not closed_streams:
                tell(value)
        except OSError:
            closed_streams.append(True)

    return tell_safely


def _each_second() -> Callable[[RecorderView], None]:
    """Return a `show` that prints a line a second to stderr."""
    from candata.record.panel import line

    due = [_SHOW_S]

    def show(view: RecorderView) -> None:
        if view.elapsed_s >= due[0]:
            due[0] = view.elapsed_s // _SHOW_S * _SHOW_S + _SHOW_S
            console.note(line(view))

    return show


def _stream_text(facts: dict[str, Any]) -> str:
    """Return what a report says of a stream."""
    losses = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in facts["losses"].items() if count)
    return (
        f"{facts['device']}: {facts['frames']} frames, {facts['rate_hz']:.2f} Hz, {facts['gaps']} gaps, the longest "
        f"{facts['longest_gap_s'] * 1e3:.0f} ms, lost: {losses or 'nothing'}"
    )


def _print_report(facts: dict[str, Any]) -> None:
    """Print the report for people."""
    from candata.record.bursts import WORDS

    losses = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in facts["losses"].items() if count)
    saturation = facts["saturated"]
    rows = (
        ("log", f"{facts['log']} ({facts['bytes'] / 1e6:.2f} MB)"),
        ("states", f"{facts['rows']} in {facts['duration_s']:.2f} s, {facts['rate_hz']:.2f} Hz"),
        ("commands", facts["commands"]),
        ("gaps", f"{facts['gaps']}, the longest {facts['longest_gap_s'] * 1e3:.0f} ms"),
        *([("bursts", f"bytes {WORDS}; do: {facts['bursts']}")] if facts["bursts"] else []),
        ("lost", losses or "nothing"),
        ("unplugged", f"{len(facts['unplugs'])} times"),
        ("saturated", f"{saturation['forces']} forces, {saturation['taxels']} taxels"),
        *((name, _stream_text(stream)) for name, stream in facts["streams"].items()),
        ("calibrated", "yes" if facts["calibrated"] else "no"),
        *session_options.report_rows(facts),
        ("ended", facts["problem"] or facts["ended"]),
        ("sha256", facts["sha256"]),
        ("next", shlex.join(["candata", *_next_command(Path(facts["log"]))])),
    )
    for name, value in rows:
        console.out(f"{name:<11}{value}")
