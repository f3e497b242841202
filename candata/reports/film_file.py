"""Files of moving pictures: a filmstrip (png), gif and mp4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from candata.datasets.writing import replacing
from candata.errors import MissingExtraError, UsageError
from candata.reports import png
from candata.reports.png import Image

#: Endings of the files that can be written.
SUFFIXES = (".gif", ".mp4", ".png")
#: Extra that brings what writes gif and mp4.
EXTRA = "film"
#: Pictures side by side in a filmstrip, and the white between them [pixels].
COLUMNS, GAP_PX = 6, 4
#: Frames a second of a gif at most: viewers slow down what lasts less than 20 ms. Source: browsers' common practice.
MOST_GIF_FPS = 50.0


def check_film(path: Path) -> None:
    """Refuse a film that could not be written, before anything is rendered.

    Raises
    ------
    UsageError
        When the ending is not one of `SUFFIXES`.
    MissingExtraError
        When the package that writes it is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"the ending of {path.name} does not say which pictures to write",
            expected=f"one of {', '.join(SUFFIXES)}",
            found=suffix or "none",
            fix=f"--out {path.stem}.gif",
        )
    if suffix == ".gif":
        _pillow()
    if suffix == ".mp4":
        _ffmpeg()


def write_film(path: Path, frames: Iterable[Image], fps: float) -> None:
    """Write pictures (H, W, 3) uint8 of one size to `path`, whole or not at all; its ending says how.

    Parameters
    ----------
    path : Path
        `.png`: a filmstrip, six pictures a row; `.gif` and `.mp4`: a film.
    frames : iterable of ndarray
        At least one; taken one by one.
    fps : float
        Pictures a second; a filmstrip has none.

    Raises
    ------
    UsageError
        When the ending is unknown.
    MissingExtraError
        When the package that writes it is not installed.
    SetupError
        When the file cannot be written.
    """
    check_film(path)
    with replacing(path, "film") as draft:
        {".png": _write_strip, ".gif": _write_gif, ".mp4": _write_mp4}[path.suffix.lower()](draft, iter(frames), fps)


def strip(frames: Iterable[Image]) -> Image:
    """Return pictures of one size in rows of `COLUMNS`, white between them."""
    padded_frames = [np.pad(frame, ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255) for frame in frames]
    blank = np.full_like(padded_frames[0], 255)
    columns = min(COLUMNS, len(padded_frames))
    padded_frames += [blank] * (-len(padded_frames) % columns)
    rows = [np.concatenate(padded_frames[i : i + columns], axis=1) for i in range(0, len(padded_frames), columns)]
    return np.concatenate(rows)[:-GAP_PX, :-GAP_PX]


def _write_strip(path: Path, frames: Iterator[Image], fps: float) -> None:
    """Write a filmstrip."""
    path.write_bytes(png.encode(strip(frames)))


def _write_gif(path: Path, frames: Iterator[Image], fps: float) -> None:
    """Write a gif that begins again at its end."""
    pillow = _pillow()
    images = (pillow.fromarray(frame).quantize() for frame in frames)
    duration_ms = round(1000 / min(fps, MOST_GIF_FPS))
    next(images).save(path, "GIF", save_all=True, append_images=images, duration=duration_ms, loop=0)


def _write_mp4(path: Path, frames: Iterator[Image], fps: float) -> None:
    """Write an mp4 (H.264); a picture of odd size gets one more row or column, as the codec takes even ones."""
    even_frames = (np.pad(f, ((0, f.shape[0] % 2), (0, f.shape[1] % 2), (0, 0)), mode="edge") for f in frames)
    first = next(even_frames)
    height, width = first.shape[:2]
    writer = _ffmpeg().write_frames(str(path), (width, height), fps=fps, macro_block_size=2)
    writer.send(None)
    try:
        writer.send(first.tobytes())
        for frame in even_frames:
            writer.send(np.ascontiguousarray(frame).tobytes())
    finally:
        writer.close()


def _pillow() -> Any:
    """Return Pillow's module of images."""
    try:
        from PIL import Image as pillow_images
    except ImportError:
        raise MissingExtraError("pillow", EXTRA) from None
    return pillow_images


def _ffmpeg() -> Any:
    """Return the module that runs ffmpeg."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MissingExtraError("imageio-ffmpeg", EXTRA) from None
    return imageio_ffmpeg
