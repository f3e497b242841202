"""Options of `import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Replace = Annotated[
    bool,
    typer.Option("--replace", help="log: with --append, a new version in which episodes take the place of old ones."),
]
#: Options of `import`. Those marked `log:` are for `import log` alone.
FormatName = Annotated[
    str, typer.Argument(metavar="FORMAT", help="Kind of source: `log`, or a format; an unknown one lists them.")
]
Sources = Annotated[
    list[Path],
    typer.Argument(
        metavar="SOURCE...",
        help="For `table`: a map.yaml; for `log`: logs; else a file or folder; lerobot: or hf:ORG/NAME[@REVISION].",
    ),
]
AllowGaps = Annotated[bool, typer.Option("--allow-gaps", help="Not log: mark values that are not finite as invalid.")]
MapFile = Annotated[
    Path | None, typer.Option("--map", metavar="FILE", help="What becomes which channel; not for table and log.")
]
Origin = Annotated[
    str | None, typer.Option("--source", metavar="sim|real", help="Not table or log: what the file holds [real].")
]
Companions = Annotated[
    list[Path] | None,
    typer.Option("--with", metavar="FILE", help="log: map.yaml, table or MCAP with poses, joints, commands; repeat."),
]
SceneName = Annotated[
    str | None,
    typer.Option(
        "--scene", metavar="SCENE", help="The scene; for log its name or scene.yaml: rate and order of joints."
    ),
]
RateHz = Annotated[float | None, typer.Option("--rate", metavar="HZ", help="log: rate without --scene [the device's].")]
NewtonPerCount = Annotated[
    float | None, typer.Option("--newton-per-count", metavar="N", help="log: scale of the forces [the log's].")
]
Threshold = Annotated[
    float | None, typer.Option("--threshold", metavar="N", help="log: contact above |Fx|+|Fy|+|Fz| [0.3].")
]
Release = Annotated[
    float | None, typer.Option("--release", metavar="N", help="log: contact ends below it [the threshold].")
]
MaxGap = Annotated[
    float | None, typer.Option("--max-gap", metavar="PERIODS", help="log: readings further apart end a gap [1.5].")
]
Align = Annotated[
    str | None,
    typer.Option(
        "--align", metavar="device|clocks|stamps", help="log: clocks beside the hand [device]; `clocks`: by motion too."
    ),
]
AllowUncalibrated = Annotated[
    bool, typer.Option("--uncalibrated", help="log: take one without calibration; forces keep their offset.")
]
ObjectName = Annotated[str | None, typer.Option("--object", metavar="NAME", help="The object.")]
TaskName = Annotated[str | None, typer.Option("--task", metavar="NAME", help="What is done.")]
EpisodeId = Annotated[
    str | None, typer.Option("--episode", metavar="ID", help="log: id of the episode [the file's name].")
]
Outcome = Annotated[
    str | None,
    typer.Option("--outcome", metavar="NAME", help="log: how it ended, where no mark of a session says so."),
]
Labels = Annotated[
    list[str] | None, typer.Option("--label", metavar="NAME=VALUE", help="log: what else is known; may be repeated.")
]
