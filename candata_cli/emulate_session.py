"""The part of `emulate` that stands in for a whole session: hand, arm, tracker, wrist sensor, fingertip and board."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from candata_cli import console

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from candata.record.emulate import Transmission
    from candata.record.emulate_faults import Faults
    from candata.record.emulate_script import Script
    from candata.record.emulate_session import SentStream
    from candata.schema.episode import Episode

#: The word in place of a device's name, the hand of a session, and the scene in which it hangs on an arm.
SESSION, HAND, SCENE = "session", "xhand", "xarm7_xhand"
#: The scene of a hand alone.
HAND_SCENE = "xhand_tabletop"


@dataclass(frozen=True)
class Beside:
    """What the streams beside a hand have sent: as arrays, and counts by name."""

    arrays: Mapping[str, NDArray] = field(default_factory=dict)
    reports: Mapping[str, dict[str, Any]] = field(default_factory=dict)


def place(
    device_name: str, scene: str | None, link: Path | None, *, hold: bool, streams: str, ports: int
) -> tuple[str, str, Path | None]:
    """Return the hand, its scene, and the folder of the ports, None where a hand is emulated alone.

    Raises
    ------
    UsageError, SetupError
        When an option means nothing, the device is no hand, or the folder cannot be made.
    """
    from candata.errors import UsageError
    from candata.record.devices import StreamDevice, device

    if device_name == SESSION:
        return HAND, scene or SCENE, _folder(link, hold, ports)
    if streams or ports:
        raise UsageError("--streams and --ports are options of a session", fix="emulate session, or leave them out")
    if isinstance(device(device_name), StreamDevice):
        raise UsageError(f"{device_name} is emulated beside a hand", fix="candata emulate session --link DIR")
    return device_name, scene or HAND_SCENE, None


def _folder(link: Path | None, hold: bool, ports: int) -> Path:
    """Return the folder of the ports, made where it was not.

    Raises
    ------
    UsageError
        When there is none, it is something else, or an option means nothing for a session.
    SetupError
        When it cannot be made.
    """
    from candata.errors import SetupError, UsageError, Where

    if link is None:
        raise UsageError("a session has several ports", fix="give a folder for their names: --link DIR")
    if hold:
        raise UsageError("the streams of a session cannot hold their last row", fix="use --loop 0: until stopped")
    if ports and not 1024 <= ports <= 65534:
        raise UsageError("--ports is out of range", expected="1024 to 65534, or 0 for free ones", found=str(ports))
    if link.is_symlink() or (link.exists() and not link.is_dir()):
        raise UsageError("--link of a session is a folder", where=Where(path=str(link)), fix="choose another place")
    try:
        link.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError("the folder cannot be made", found=error.strerror, where=Where(path=str(link))) from None
    return link


def session_streams(script: Script, episode: Episode, names: str) -> tuple[SentStream, ...]:
    """Return the streams beside the hand, of those names or all.

    Raises
    ------
    UsageError, UnknownNameError
        As `candata.record.emulate_session.write_session`.
    """
    from candata.record.emulate_session import write_session
    from candata.scenes import load_scene

    chosen = tuple(filter(None, (name.strip() for name in names.split(","))))
    return write_session(script, episode, load_scene(episode.meta.scene or SCENE), chosen)


def play_session(
    script: Script,
    streams: Sequence[SentStream],
    folder: Path,
    stop: Callable[[], bool],
    *,
    ports: int,
    wait: bool,
    as_json: bool,
    seed: int,
    faults: Faults,
    passes: int,
) -> tuple[Transmission, Beside]:
    """Return what the hand and the streams beside it sent; the line that records them is printed first.

    Raises
    ------
    SetupError
        When a port is taken.
    """
    import numpy as np

    from candata.record.emulate import play
    from candata.record.emulate_line import Line
    from candata.record.emulate_streams import (
        Outlet,
        open_outlet,
        play_streams,
        record_line,
        stream_truth,
        wait_for_all,
    )

    # Of the seed's streams 0 and 1 made the episode, 2 the hand's faults.
    hand_rng, rng = (np.random.default_rng([seed, 0, number]) for number in (2, 3))
    with ExitStack() as opened:
        hand_line = Line(folder / "hand")
        opened.callback(hand_line.close)
        outlets: list[Outlet] = []
        for number, sent in enumerate(streams):
            outlets.append(open_outlet(sent, folder, ports + number if ports else 0))
            opened.callback(outlets[-1].close)
        line = record_line(streams, outlets, folder / "hand")
        addresses = {sent.name: outlet.address for sent, outlet in zip(streams, outlets, strict=True)}
        console.out(json.dumps({"record": line, "streams": addresses, "rows": len(script)}) if as_json else line)
        if wait:
            console.note("waiting until a program has opened each of them (udp: cannot be known)")
            wait_for_all([hand_line, *outlets], stop)
        with ThreadPoolExecutor(1) as beside:
            others = beside.submit(play_streams, streams, outlets, rng, faults=faults, passes=passes, stop=stop)
            transmission = play(script, hand_line, hand_rng, stop=stop, faults=faults, passes=passes)
            tallies = others.result()
    reports = {sent.name: tally.report() for sent, tally in zip(streams, tallies, strict=True)}
    return transmission, Beside(stream_truth(streams, tallies), reports)


def say_streams(reports: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a line for each stream."""
    for name, report in reports.items():
        faults = ", ".join(f"{fault} {count}" for fault, count in report["faults"].items()) or "none"
        console.out(
            f"{name:9} {report['whole']} of {report['frames']} frames whole, {report['dropped']} not taken, "
            f"faults {faults}, late {report['late_s'] * 1e3:.1f} ms at most"
        )
