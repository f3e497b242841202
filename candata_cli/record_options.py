"""Options of `record-real`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Port = Annotated[str, typer.Option("--port", metavar="PORT", help="Serial port to listen to; never written to.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="LOG", help="Log to write (MCAP).")]
DeviceName = Annotated[
    str, typer.Option("--device", metavar="NAME", help="Hand on the port; `replay`: a log is played.")
]
Duration = Annotated[
    float | None,
    typer.Option("--duration", metavar="S", help="Seconds after the calibration, or of each of --episodes."),
]
NoCalibrate = Annotated[bool, typer.Option("--no-calibrate", help="Do not measure a resting hand first.")]
CalibrateS = Annotated[float, typer.Option("--calibrate-s", metavar="S", min=0.5, help="Length of the calibration.")]
NewtonPerCount = Annotated[
    float | None, typer.Option("--newton-per-count", metavar="X", help="Scale of the forces; else the device's.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Nominal rate, to find gaps; else the device's.")
]
Baud = Annotated[int | None, typer.Option("--baud", min=1, help="Baud rate; else the device's.")]
Reconnect = Annotated[
    float, typer.Option("--reconnect", metavar="S", min=0.0, help="How long to wait for an unplugged port.")
]
Silence = Annotated[
    float | None,
    typer.Option(
        "--silence", metavar="S", min=1.0, help="Session: it ends after so long without a state; 60 by default."
    ),
]
ReserveMb = Annotated[
    int, typer.Option("--reserve-mb", metavar="MB", min=0, help="Free space at which the recording ends.")
]
Arm = Annotated[str | None, typer.Option("--arm", metavar="HOST[:PORT]", help="Arm to record too: arm=xarm@HOST.")]
Pose = Annotated[
    str | None, typer.Option("--pose", metavar="udp://HOST:PORT", help="Lines of poses, or tcp://HOST:PORT.")
]
Wrench = Annotated[str | None, typer.Option("--wrench", metavar="PORT", help="Wrist sensor, an FT300.")]
Stream = Annotated[
    list[str] | None,
    typer.Option("--stream", metavar="NAME=DEVICE@ADDRESS", help="Another stream; may be repeated."),
]
Poll = Annotated[
    str | None,
    typer.Option("--poll", metavar="FILE|J1,J2,...", help="WRITES: ask the hand to hold this set-point [rad]."),
]
PlainText = Annotated[bool, typer.Option("--plain", help="A line a second instead of the panel.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the final report as JSON, and no panel.")]
#: Options that mark episodes, and when a fingertip touches.
SessionFolder = Annotated[
    Path | None,
    typer.Option(
        "--session", metavar="DIR", help="Instead of --out: a new folder for a log of many episodes; by keys."
    ),
]
Episodes = Annotated[
    int | None,
    typer.Option("--episodes", metavar="N", min=1, help="Session: end after N episodes; each lasts --duration."),
]
Gap = Annotated[
    float | None,
    typer.Option(
        "--gap", metavar="S", min=0.0, help="Session: rest before each episode; free time that ends one by contact [1]."
    ),
]
StartOnContact = Annotated[
    bool, typer.Option("--start-on-contact", help="Session: an episode begins when a fingertip touches something.")
]
Threshold = Annotated[
    float, typer.Option("--threshold", metavar="N", help="Contact is shown and begins above |Fx|+|Fy|+|Fz|.")
]
Release = Annotated[float | None, typer.Option("--release", metavar="N", help="Contact ends below it [the threshold].")]
