"""The command that makes pictures of an episode: render."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.datasets import Dataset
    from candata.reports.png import Image
    from candata.reports.render import RenderedFrames

_EXAMPLE = """\b
Examples:
  candata render sim --episode gripper_tabletop-s1-000000 --out grasp.gif
  candata render recordings --episode grasp-003 --scene scene.yaml --over sim --over-episode sim-3 --out both.mp4
"""
#: Pictures of a filmstrip, and width and height of a picture in a film and in a filmstrip [pixels]. Chosen.
STRIP_FRAMES, FILM_SIZE, STRIP_SIZE = 6, (480, 360), (320, 240)
#: Least and largest width and height of a picture [pixels].
LEAST_PX, MOST_PX = 16, 4096


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("render", epilog=_EXAMPLE)(render)


@console.stoppable()
def render(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="A .gif or .mp4, or a .png: a filmstrip.")],
    episode: Annotated[
        str | None, typer.Option("--episode", metavar="ID", help="Episode; the first by id by default.")
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="Name, SCENE+OBJECT or scene.yaml; else the episode's."),
    ] = None,
    over: Annotated[
        str | None, typer.Option("--over", metavar="DATASET", help="Show the object of another dataset as a ghost.")
    ] = None,
    over_episode: Annotated[
        str | None, typer.Option("--over-episode", metavar="ID", help="Its episode; by default that of the same id.")
    ] = None,
    camera: Annotated[
        str | None, typer.Option("--camera", metavar="NAME", help="Camera of the model; else one that shows it all.")
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", metavar="WxH", help="Pixels of a picture [480x360; .png: 320x240].")
    ] = None,
    fps: Annotated[float, typer.Option("--fps", min=1, max=240, help="Pictures a second.")] = 20.0,
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=1, max=10_000, metavar="N", help="Pictures in all [.png: 6; else as --fps says]."),
    ] = None,
    version: Annotated[str | None, typer.Option(help="Version: its number, the start of its digest, or a tag.")] = None,
) -> None:
    """Make pictures of an episode in its scene: the recorded state, fingertips in contact marked, the time.

    A mark grows and reddens with the force. `--over` shows the object of another recording in pink at the same times.
    Without a GL library the pictures are drawn. A .gif or .mp4 needs the extra `film`.
    """
    check_output(out, "file")
    from candata.reports.film import Moments, footage, pictures
    from candata.reports.film_file import check_film, write_film

    check_film(out)
    is_strip = out.suffix.lower() == ".png"
    width, height = _size(size) if size else STRIP_SIZE if is_strip else FILM_SIZE
    data = console.open_named(dataset, version)
    episode_id = episode or data.ids[0]
    ghost = _ghost(over, over_episode, episode_id)
    moments = Moments(frames or (STRIP_FRAMES if is_strip else None), fps)
    shown = footage(data, episode_id, moments, scene, ghost)
    for line in shown.notes:
        console.note(line)
    with console.progress("pictures", len(shown.qpos)) as advance:
        write_film(out, _told(pictures(shown, width, height, camera), advance), fps)
    console.note(f"{episode_id}: {out}, {len(shown.qpos)} pictures, {out.stat().st_size / 1e6:.2f} MB")


def _told(chunks: Iterable[RenderedFrames], advance: Callable[[int], None]) -> Iterator[Image]:
    """Yield the pictures one by one, and say once how they were made where no GL library made them."""
    said_notes = {""}
    for chunk in chunks:
        if chunk.note not in said_notes:
            console.note(chunk.note)
            said_notes.add(chunk.note)
        for frame in chunk.frames:
            yield frame
            advance(1)


def _ghost(over: str | None, over_episode: str | None, episode_id: str) -> tuple[Dataset, str] | None:
    """Return dataset and id of the episode that is shown as a ghost."""
    from candata.errors import UsageError

    if over is None:
        if over_episode is not None:
            raise UsageError("--over-episode without --over", fix="give its dataset: --over DATASET")
        return None
    return console.open_named(over), over_episode or episode_id


def _size(text: str) -> tuple[int, int]:
    """Return width and height of `WxH`."""
    from candata.errors import UsageError

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    sides = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(LEAST_PX <= side <= MOST_PX for side in sides):
        raise UsageError(
            f"--size {text} is no size",
            expected=f"WIDTHxHEIGHT, each of {LEAST_PX} to {MOST_PX} pixels, such as 480x360",
            found=text,
        )
    return sides
