"""The command that stands in for a hand: emulate."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console
from candata_cli import emulate_session as session
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.record.emulate import Transmission
    from candata.record.emulate_faults import Faults
    from candata.record.emulate_script import Script
    from candata.schema.episode import Episode

_EXAMPLE = """\b
An example, in two terminals:
  candata emulate xhand --link /tmp/hand --with-table poses/poses.parquet
  candata record-real --port /tmp/hand --out hand.mcap

\b
With an arm, a tracker, a wrist sensor, a fingertip and a board beside it; it prints the line that records all:
  candata emulate session --link /tmp/ports
"""

DeviceName = Annotated[
    str, typer.Argument(metavar="DEVICE", help="Hand to stand in for, such as xhand; session: it and all beside it.")
]
SceneName = Annotated[
    str | None,
    typer.Option(
        "--scene", metavar="SCENE", help="Scene that is simulated; by default xhand_tabletop, of a session xarm7_xhand."
    ),
]
PolicyName = Annotated[
    str | None, typer.Option("--policy", metavar="NAME", help="Its motion; the scene's first by default.")
]
Seed = Annotated[int, typer.Option("--seed", metavar="K", help="Seed of the episode and of the faults.")]
Duration = Annotated[float, typer.Option("--duration-s", metavar="S", help="Length of the episode.")]
DatasetPath = Annotated[
    Path | None, typer.Option("--dataset", metavar="DATASET", help="Play an episode of it instead.")
]
EpisodeId = Annotated[str | None, typer.Option("--episode", metavar="ID", help="Which, where it has several.")]
Gap = Annotated[
    float | None,
    typer.Option("--gap", metavar="S", help="All of its episodes in turn, with so long a rest after each."),
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Rows a second; the episode's own by default.")
]
RestSeconds = Annotated[
    float, typer.Option("--still", metavar="S", help="First row held before, untouched: for calibration.")
]
Scale = Annotated[float | None, typer.Option("--newton-per-count", metavar="N", help="Scale; the device's by default.")]
Link = Annotated[
    Path | None,
    typer.Option(
        "--link", metavar="PATH", help="Symbolic link to the port: a fixed name. Of a session, a folder of them."
    ),
]
StreamNames = Annotated[
    str, typer.Option("--streams", metavar="LIST", help="Of a session: some of arm,pose,wrench,finger,board.")
]
Ports = Annotated[
    int, typer.Option("--ports", metavar="N", help="Of a session: first of its network ports; 0: free ones.")
]
Wait = Annotated[bool, typer.Option("--wait/--no-wait", help="Begin when a program opens the port, or at once.")]
Loop = Annotated[int, typer.Option("--loop", metavar="N", help="Play it N times; 0: until stopped.")]
Hold = Annotated[bool, typer.Option("--hold", help="Go on sending the last row until stopped.")]
Table = Annotated[
    Path | None,
    typer.Option("--with-table", metavar="PARQUET", help="Write what the wire lacks, and map.yaml beside it."),
]
Truth = Annotated[Path | None, typer.Option("--truth", metavar="NPZ", help="Write the values sent.")]
FaultList = Annotated[
    str,
    typer.Option(
        "--faults",
        metavar="LIST",
        help="bitflip:P, truncate:P, head:P, garbage:P (shares of the frames), stall:S@T, unplug[:S]@T, burst:S (a USB "
        "adapter's latency timer, 0.016).",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Two lines of JSON: the port, then the report.")]


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("emulate", epilog=_EXAMPLE)(emulate)


def emulate(
    device_name: DeviceName,
    scene: SceneName = None,
    policy: PolicyName = None,
    seed: Seed = 1,
    duration_s: Duration = 3.2,
    dataset: DatasetPath = None,
    episode: EpisodeId = None,
    gap: Gap = None,
    rate: Rate = None,
    rest_s: RestSeconds = 3.5,
    newton_per_count: Scale = None,
    link: Link = None,
    wait: Wait = True,
    loop: Loop = 1,
    hold: Hold = False,
    with_table: Table = None,
    truth: Truth = None,
    faults: FaultList = "",
    streams: StreamNames = "",
    ports: Ports = 0,
    as_json: AsJson = False,
) -> None:
    """Stand in for a hand: send an episode's frames on a pseudo-terminal, whose path is printed first.

    Requests and replies come as a listener on the pair of wires sees them. Where the reader is so late that 64 KiB
    wait, whole frames are lost, as on a real port, and counted. Ctrl-C ends it with a report.
    """
    from candata.record import emulate_files as files
    from candata.record.devices import hand
    from candata.record.emulate_faults import parse_faults
    from candata.record.emulate_script import encoder_of, write_script

    for option, path in {"--with-table": with_table, "--truth": truth}.items():
        if path:
            check_output(path, "new", option)
    _check_choice(dataset, episode, gap)
    hand_name, scene_name, folder = session.place(device_name, scene, link, hold=hold, streams=streams, ports=ports)
    model, fault_plan = hand(hand_name), parse_faults(faults)
    encoder_of(hand_name, model)
    _check(loop, seed, fault_plan, link)
    episode_played = (
        _stored_episode(dataset, episode, gap) if dataset else _simulated_episode(scene_name, policy, seed, duration_s)
    )
    script = write_script(
        episode_played, hand_name, model, rate_hz=rate, still_s=rest_s, newton_per_count=newton_per_count
    )
    if with_table:
        files.check_table(with_table, script)
    if truth:
        files.prepare(truth)
    options: dict[str, Any] = {"wait": wait, "as_json": as_json, "seed": seed, "faults": fault_plan, "passes": loop}
    beside = session.Beside()
    if folder is None:
        transmission = _play(script, link, hold=hold, **options)
    else:
        others = session.session_streams(script, episode_played, streams)
        with _stop_on_signal() as stop:
            transmission, beside = session.play_session(script, others, folder, stop, ports=ports, **options)
    if with_table:
        files.write_table(with_table, transmission)
    if truth:
        files.write_truth(truth, transmission, beside.arrays)
    _say_report({**transmission.report(), "streams": beside.reports}, as_json)


def _check_choice(dataset: Path | None, episode: str | None, gap_s: float | None) -> None:
    """Refuse a choice among the episodes of no dataset, or two choices."""
    from candata.errors import UsageError

    if episode is not None and dataset is None:
        raise UsageError("--episode names an episode of a dataset", fix="give --dataset")
    if gap_s is not None and (dataset is None or episode is not None):
        raise UsageError("--gap plays all episodes of a dataset", fix="give --dataset, and no --episode")


def _check(loop: int, seed: int, faults: Faults, link: Path | None) -> None:
    """Refuse options that mean nothing."""
    from candata.errors import UsageError

    if loop < 0 or seed < 0:
        raise UsageError("--loop and --seed count from 0", found=f"--loop {loop}, --seed {seed}")
    if faults.unplug and faults.unplug[1] is not None and link is None:
        raise UsageError("a port that comes back has another name", fix="give a --link: it will lead to the new one")


def _stored_episode(dataset: Path, name: str | None, gap_s: float | None) -> Episode:
    """Return the episode `name` of a dataset, or its only one; with a gap all of them, one after the other."""
    from candata.datasets import open_dataset
    from candata.errors import UsageError, Where
    from candata.record.emulate_script import joined

    data = open_dataset(dataset)
    if gap_s is not None and len(data):
        return joined(list(data.episodes()), gap_s)
    if name is None and len(data) != 1:
        raise UsageError(
            "which episode?",
            expected="--episode ID, or --gap S for all in turn",
            found=f"{len(data)}: {', '.join(data.ids[:5])}, ...",
            where=Where(path=str(dataset)),
        )
    return data.episode(name or data.ids[0])


def _simulated_episode(scene_name: str, policy: str | None, seed: int, duration_s: float) -> Episode:
    """Return a simulated episode with the scene's sensor noise."""
    from candata.scenes import load_scene
    from candata.simulate.episodes import make_episodes
    from candata.simulate.jobs import GenerationRecipe, check, job, possible_policies

    scene = load_scene(scene_name)
    policies = (policy,) if policy else possible_policies(scene)[:1]
    recipe = GenerationRecipe(scene=scene_name, seed=seed, policies=policies, duration_s=duration_s, noise=True)
    check(recipe, scene)
    return make_episodes(scene, [job(recipe, 0, scene)], duration_s=duration_s, noise=scene.file.noise)[0]


def _play(script: Script, link: Path | None, *, wait: bool, as_json: bool, seed: int, **options: Any) -> Transmission:
    """Return what was sent on a fresh port, which is printed first."""
    import numpy as np

    from candata.record.emulate import play, wait_for_reader
    from candata.record.emulate_line import Line

    with _stop_on_signal() as stop, Line(link) as line:
        head = {"port": line.port, "link": str(link) if link else None, "rate_hz": script.rate_hz, "rows": len(script)}
        console.out(json.dumps(head) if as_json else line.port)
        if wait:
            console.note(
                f"{len(script)} rows at {script.rate_hz:g} Hz; waiting for a program to open {link or line.port}"
            )
            wait_for_reader(line, stop)
        plugged_text = "plugged in again: {}".format
        # Of the seed's streams 0 and 1 made the episode.
        rng = np.random.default_rng([seed, 0, 2])
        return play(script, line, rng, stop=stop, on_port=lambda port: console.note(plugged_text(port)), **options)


@contextmanager
def _stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether SIGINT or SIGTERM came; a shell's background job ignores SIGINT unless asked."""
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in handlers:
        signal.signal(number, lambda came_now, _frame: came.append(came_now))
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _say_report(report: dict[str, Any], as_json: bool) -> None:
    """Print the report: a line of JSON, or lines for people."""
    if as_json:
        console.out(json.dumps(report, allow_nan=False))
        return
    faults = ", ".join(f"{name} {count}" for name, count in report["faults"].items()) or "none"
    clip_counts = report["clipped"]
    console.out(
        f"{report['rows']} rows in {report['seconds']:g} s: {report['whole_commands']} requests and "
        f"{report['whole_states']} replies whole\n"
        f"dropped   {report['dropped_frames']} frames, {report['dropped_bytes']} bytes not taken in time\n"
        f"clipped   {clip_counts['force_counts']} force counts, "
        f"{clip_counts['taxel_counts']} taxel counts out of range\n"
        f"faults    {faults}\n"
        f"received  {report['received_bytes']} bytes from the reader\n"
        f"late      {report['late_s'] * 1e3:.1f} ms at most"
    )
    session.say_streams(report["streams"])
