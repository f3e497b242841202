"""Commands around real hardware: `record-real` writes a log, `recover` salvages a torn one."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.record.addresses import StreamSource
    from candata.record.recorder_values import RecorderView

_SHOW_S = 1.0
#: Option of a stream to its device.
_STREAM_DEVICES = {"arm": "xarm", "pose": "pose_lines", "wrench": "ft300"}

_RECORD_EXAMPLE = """\b
Example:
  candata record-real --port /dev/ttyUSB0 --out session.mcap
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
    port: Annotated[str, typer.Option("--port", metavar="PORT", help="Serial port to listen to; never written to.")],
    out: Annotated[Path, typer.Option("--out", metavar="LOG", help="Log to write (MCAP).")],
    device: Annotated[
        str, typer.Option("--device", metavar="NAME", help="Hand on the port; `replay`: a log is played.")
    ] = "xhand",
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", help="Seconds after the calibration; else until Ctrl-C."),
    ] = None,
    no_calibrate: Annotated[bool, typer.Option("--no-calibrate", help="Do not measure a resting hand first.")] = False,
    calibrate_s: Annotated[
        float, typer.Option("--calibrate-s", metavar="S", min=0.5, help="Length of the calibration.")
    ] = 3.0,
    newton_per_count: Annotated[
        float | None, typer.Option("--newton-per-count", metavar="X", help="Scale of the forces; else the device's.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Nominal rate, to find gaps; else the device's.")
    ] = None,
    baud: Annotated[int | None, typer.Option("--baud", min=1, help="Baud rate; else the device's.")] = None,
    reconnect: Annotated[
        float, typer.Option("--reconnect", metavar="S", min=0.0, help="How long to wait for an unplugged port.")
    ] = 10.0,
    reserve_mb: Annotated[
        int, typer.Option("--reserve-mb", metavar="MB", min=0, help="Free space at which the recording ends.")
    ] = 200,
    arm: Annotated[
        str | None, typer.Option("--arm", metavar="HOST[:PORT]", help="Arm to record too: arm=xarm@HOST.")
    ] = None,
    pose: Annotated[
        str | None, typer.Option("--pose", metavar="udp://HOST:PORT", help="Lines of poses, or tcp://HOST:PORT.")
    ] = None,
    wrench: Annotated[str | None, typer.Option("--wrench", metavar="PORT", help="Wrist sensor, an FT300.")] = None,
    stream: Annotated[
        list[str] | None,
        typer.Option("--stream", metavar="NAME=DEVICE@ADDRESS", help="Another stream; may be repeated."),
    ] = None,
    poll: Annotated[
        str | None,
        typer.Option("--poll", metavar="FILE|J1,J2,...", help="WRITES: ask the hand to hold this set-point [rad]."),
    ] = None,
    plain_text: Annotated[bool, typer.Option("--plain", help="A line a second instead of the panel.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the final report as JSON, and no panel.")] = False,
) -> None:
    """Record a real hand and what is beside it: listen, calibrate, log every byte and what it says, until Ctrl-C."""
    from candata.record.poll import read_posture
    from candata.record.recorder import record
    from candata.record.recorder_values import RecorderSettings
    from candata.record.replay import hand_source

    check_output(out, "new")
    sources = _sources({"arm": arm, "pose": pose, "wrench": wrench}, stream or [])
    hand = hand_source(device, port)
    if duration is not None:
        _positive("duration", duration)
    stated_settings = {"newton_per_count": newton_per_count, "rate_hz": rate, "baud": baud}
    overrides = {name: _positive(name, value) for name, value in stated_settings.items() if value is not None}
    settings = RecorderSettings(
        duration_s=duration,
        calibrate_s=0.0 if no_calibrate else calibrate_s,
        reconnect_s=reconnect,
        reserve_bytes=reserve_mb * 1_000_000,
        poll_rad=None if poll is None else read_posture(poll, hand.device),
    )
    with (
        console.stoppable(partial(_kept_text, out)),
        _until_signal() as stop,
        _live_view(f"candata record-real {port}", plain_text, as_json) as (show, say),
    ):
        report = record(
            hand.device,
            hand.port,
            out,
            name=hand.name,
            settings=settings,
            overrides={**hand.settings, **overrides},
            streams=[*hand.streams, *sources],
            stop=stop,
            show=show,
            say=say,
        )
    if as_json:
        console.out_json(report.facts)
    else:
        _print_report(report.facts)
    if report.failure is not None:
        raise report.failure
    if duration is not None and report.facts["ended"] == "stopped":
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
    if as_json:
        console.out_json(vars(report))
        return
    state = "torn" if report.torn else "whole"
    damage_text = f", {report.damaged_chunks} damaged chunks left out" if report.damaged_chunks else ""
    console.out(f"{report.log} is {state}: {report.read_bytes} of {report.total_bytes} bytes read{damage_text}")
    console.out(f"{report.out}: {sum(report.messages.values())} messages over {report.duration_s:.2f} s")
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
        raise UsageError(f"--{name.removesuffix('_hz').replace('_', '-')} must be above zero", found=str(value))
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
        signal.signal(number, handlers[number])

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
        ("ended", facts["problem"] or facts["ended"]),
        ("sha256", facts["sha256"]),
        ("next", shlex.join(["candata", *_next_command(Path(facts["log"]))])),
    )
    for name, value in rows:
        console.out(f"{name:<11}{value}")
