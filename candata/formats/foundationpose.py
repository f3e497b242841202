"""FoundationPose results: a folder a sequence, `ob_in_cam/` with one 4 x 4 matrix a frame, object to camera.

A small map says what the folder does not:

    rate_hz: 30
    object: mustard
    camera_pose:            # camera to world; without it poses stay in the camera's frame
      - [0, -1, 0, 0.5]
      - [0, 0, -1, 0.2]
      - [1, 0, 0, 0]
      - [0, 0, 0, 1]

Frames are numbered by the digits that end their names; a number that is missing, or a picture in `rgb/` without a pose,
is a gap. With `stamps: ns` the names are times, as in YCBInEOAT.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from candata import align
from candata.errors import DataError, UsageError, Where
from candata.formats import Format, Reading
from candata.formats._assemble import checked_episode
from candata.formats._map_file import read_map_file
from candata.formats._stamps import require_rate
from candata.lfs import refuse_pointer
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Alignment, Episode, EpisodeMeta
from candata.schema.topics import FramesMap
from candata.units import TO_SI

POSES, PICTURES = "ob_in_cam", "rgb"
#: Largest entry of R^T R - 1, and of the last row's difference from 0 0 0 1; text of float32 matrices stays below 1e-5.
RIGID_TOLERANCE = 1e-3
#: Rows an episode may have; a frame with a number far off would otherwise ask for more than any memory.
MOST_ROWS = 10_000_000
#: Times of file names are a camera's own, and come at its rate within this factor.
_NAMES_FACTOR = 2.0
#: Bytes of a frame that are read: 16 numbers of text take hundreds.
_LARGEST_FRAME_BYTES = 1 << 16
_EXAMPLE = "rate_hz: 30\nobject: NAME\n# stamps: ns        # where the file names are times\n"


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of a sequence.

    Attributes
    ----------
    numbers : (T,) int64
        Numbers that end the file names, increasing.
    matrices : (T, 4, 4) float64
        Object to camera; NaN where there is none.
    """

    numbers: NDArray[np.int64]
    matrices: NDArray[np.float64]


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield an episode a sequence.

    Raises
    ------
    UsageError
        When there is no map (its text holds one to start from), or it is wrong.
    DataError
        When a frame holds no rigid matrix, or (without gaps allowed) one is missing; names it.
    """
    mapping = _mapping(reading)
    for folder in sequences(Path(source)):
        yield _episode(folder, mapping, reading)


def sequences(source: Path) -> list[Path]:
    """Return the sequences in a folder: itself, or those of its folders that hold poses.

    Raises
    ------
    DataError
        When there is none.
    """
    if (source / POSES).is_dir():
        return [source]
    folders = sorted(path.parent for path in source.glob(f"*/{POSES}") if path.is_dir())
    if not folders:
        raise DataError(
            "the folder holds no poses of FoundationPose",
            expected=f"{POSES}/ with a .txt file a frame, in it or in its folders",
            found="no such folder" if not source.is_dir() else "none",
            where=Where(path=str(source)),
        )
    return folders


def _mapping(reading: Reading) -> FramesMap:
    """Return the map, the camera's pose checked."""
    if reading.mapping is None:
        raise UsageError(
            "a map is needed that says at what rate the frames were taken",
            expected="--map frames.yaml",
            fix=f"save this as frames.yaml, mend it, and give --map frames.yaml\n\n{_EXAMPLE}".rstrip(),
        )
    mapping = read_map_file(FramesMap, reading.mapping)
    if mapping.camera_pose is not None:
        _require_rigid(np.array(mapping.camera_pose), "camera_pose", UsageError, Where(path=str(reading.mapping)))
    return mapping


def _episode(folder: Path, mapping: FramesMap, reading: Reading) -> Episode:
    """Return the episode of one sequence."""
    identity = folder.resolve().name
    frames = _frames(folder)
    time_ns, rows = _row_times(folder, frames, mapping)
    is_missing = np.isnan(rows[:, 0, 0])
    _tell_gaps(folder, time_ns, is_missing, mapping, reading)
    poses = _poses(rows, is_missing, mapping)
    arrays: dict[str, NDArray] = {"time_ns": time_ns, "object_pose": poses}
    invalid = {"object_pose": int(is_missing.sum())} if is_missing.any() else {}
    if invalid:
        arrays["object_pose" + VALID_SUFFIX] = ~is_missing
    if mapping.camera_pose is None:
        reading.note(f"{identity}: the map has no camera_pose; the world of these poses is the camera's frame")
    stamps = f"file names in {mapping.stamps}" if mapping.stamps else f"frame numbers at {mapping.rate_hz:g} Hz"
    meta = EpisodeMeta(
        id=identity,
        source=mapping.source or reading.source,
        rate_hz=mapping.rate_hz,
        scene=mapping.scene or reading.scene,
        object=mapping.object or reading.object,
        task=mapping.task or reading.task,
        alignment=Alignment(method=f"FoundationPose, object in {_frame_words(mapping)}; time from {stamps}"),
        invalid_counts=invalid,
    )
    return checked_episode(meta, arrays, folder)


def _frame_words(mapping: FramesMap) -> str:
    """Return the frame that the poses are given in."""
    return "the camera's frame" if mapping.camera_pose is None else "the world by camera_pose"


def _frames(folder: Path) -> Frames:
    """Return the frames of a sequence; those of which only the picture is there hold NaN."""
    files = {_number(path): path for path in sorted((folder / POSES).glob("*.txt"))}
    location = Where(path=str(folder / POSES))
    if not files:
        raise DataError("the folder holds no poses", expected="a .txt file a frame", found="none", where=location)
    if len(files) < len(list((folder / POSES).glob("*.txt"))):
        raise DataError("two frames bear one number", expected="each number once", where=location)
    pictures = {_number(path) for path in (folder / PICTURES).glob("*") if path.is_file()}
    numbers = sorted(pictures | set(files))
    no_matrix = np.full((4, 4), np.nan)
    matrices = [_matrix(files[number]) if number in files else no_matrix for number in numbers]
    return Frames(np.array(numbers, np.int64), np.stack(matrices))


def _number(path: Path) -> int:
    """Return the number that ends a file's name."""
    digits = re.search(r"([0-9]{1,19})$", path.stem)
    if digits is None or int(digits.group(1)) > np.iinfo(np.int64).max:
        raise DataError(
            "a frame's name does not end in its number",
            expected="such as 0000123.txt",
            found=path.name,
            where=Where(path=str(path)),
        )
    return int(digits.group(1))


def _bytes(path: Path) -> bytes:
    """Return a file's bytes, as many as a matrix can have."""
    refuse_pointer(path)
    try:
        if path.exists() and not path.is_file():  # a device may never end
            raise OSError(0, "no regular file")
        with path.open("rb") as file:
            return file.read(_LARGEST_FRAME_BYTES)
    except OSError as error:
        raise DataError("the frame cannot be read", found=error.strerror, where=Where(path=str(path))) from None


def _matrix(path: Path) -> NDArray[np.float64]:
    """Return the matrix of a frame `(4, 4)`; NaN where it holds one."""
    location = Where(path=str(path))
    try:
        values = [float(word) for word in _bytes(path).decode().split()]
    except ValueError:
        raise DataError(
            f"frame {path.stem} holds no matrix", expected="16 numbers", found="other text", where=location
        ) from None
    if len(values) != 16:
        raise DataError(
            f"frame {path.stem} holds no 4 x 4 matrix", expected="16 numbers", found=str(len(values)), where=location
        )
    matrix = np.array(values).reshape(4, 4)
    if not np.isfinite(matrix).all():
        return np.full((4, 4), np.nan)
    _require_rigid(matrix, f"frame {path.stem}", DataError, location)
    return matrix


def _require_rigid(
    matrix: NDArray[np.float64], name: str, kind: type[DataError] | type[UsageError], location: Where
) -> None:
    """Refuse a matrix that is no motion of a rigid body."""
    turn = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        rotation_error = np.abs(turn.T @ turn - np.eye(3)).max()
    rest = np.abs(matrix[3] - (0, 0, 0, 1)).max()
    is_far = np.abs(matrix[:3, 3]).max() > np.finfo(np.float32).max
    if rotation_error <= RIGID_TOLERANCE and rest <= RIGID_TOLERANCE and np.linalg.det(turn) > 0 and not is_far:
        return
    if not rotation_error <= RIGID_TOLERANCE:
        problem = f"a rotation that is off by {rotation_error:.2g}"
    elif not rest <= RIGID_TOLERANCE:
        problem = f"a last row of {' '.join(f'{value:g}' for value in matrix[3])}"
    else:
        problem = "a position beyond float32" if is_far else "a mirror image (determinant -1)"
    raise kind(
        f"{name} is no rigid motion",
        expected=f"a rotation and a position in m, within {RIGID_TOLERANCE:g}; last row 0 0 0 1",
        found=problem,
        where=location,
    )


def _row_times(folder: Path, frames: Frames, mapping: FramesMap) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the time of each row [ns] and its matrix; rows of missing numbers hold NaN."""
    location, numbers = Where(path=str(folder)), frames.numbers
    if mapping.stamps is not None:
        factor = round(TO_SI[mapping.stamps] * 1e9)
        last_number = int(numbers[-1])
        if last_number * factor > np.iinfo(np.int64).max:
            raise DataError(
                "the file names are no times",
                expected=f"times in {mapping.stamps}",
                found=str(last_number),
                where=location,
                fix="correct `stamps` in the map",
            )
        time_ns = numbers * factor
        names = Where(path=f"{folder}, file names")
        require_rate(time_ns * 1e-9, mapping.rate_hz, names, lambda unit: f"`stamps: {unit}`", _NAMES_FACTOR)
        return time_ns, frames.matrices
    count = int(numbers[-1] - numbers[0]) + 1
    if count > MOST_ROWS:
        raise DataError(
            "the frames' numbers lie too far apart",
            expected=f"at most {MOST_ROWS} frames",
            found=str(count),
            where=location,
            fix="where the names are times, say `stamps: ns` in the map",
        )
    rows = np.full((count, 4, 4), np.nan)
    rows[numbers - numbers[0]] = frames.matrices
    return np.round(np.arange(count) * (1e9 / mapping.rate_hz)).astype(np.int64), rows


def _tell_gaps(
    folder: Path, time_ns: NDArray[np.int64], is_missing: NDArray[np.bool_], mapping: FramesMap, reading: Reading
) -> None:
    """Refuse frames without a pose, and jumps of the stamps, unless gaps are allowed; then tell of them."""
    steps = np.diff(time_ns)
    jumps = np.flatnonzero(steps > align.MAX_GAP_PERIODS * align.period_ns(time_ns))
    if is_missing.all():
        raise DataError(
            "no frame holds a pose",
            expected="finite matrices",
            found=f"{len(is_missing)} frames without",
            where=Where(path=str(folder / POSES)),
        )
    if not is_missing.any() and not len(jumps):
        return
    words = [f"{int(is_missing.sum())} of {len(is_missing)} frames without a pose"] if is_missing.any() else []
    words += [f"{len(jumps)} jumps of time, by up to {steps.max() * 1e-9:.3f} s"] if len(jumps) else []
    if reading.allow_gaps:
        reading.note(f"{folder.resolve().name}: {'; '.join(words)}")
        return
    row = int(np.argmax(is_missing)) if is_missing.any() else int(jumps[0]) + 1
    raise DataError(
        "frames are missing",
        expected="a pose in every frame",
        found="; ".join(words),
        where=Where(path=str(folder), channel="object_pose", index=row),
        fix="import with --allow-gaps: such rows are kept and marked invalid",
    )


def _poses(rows: NDArray[np.float64], is_missing: NDArray[np.bool_], mapping: FramesMap) -> NDArray[np.float64]:
    """Return `(T, 7)`: position [m] and quaternion w x y z of the rows, NaN where there is none."""
    poses = np.full((len(rows), 7), np.nan)
    camera = np.eye(4) if mapping.camera_pose is None else np.array(mapping.camera_pose)
    world = camera @ rows[~is_missing]
    quaternion = Rotation.from_matrix(world[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    # Both signs are one rotation; neighbours take the same, so that nothing jumps.
    flips = np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    quaternion[1:] *= flips[:, None]
    poses[~is_missing] = np.c_[world[:, :3, 3], quaternion]
    return poses


FORMAT = Format(
    name="foundationpose",
    summary="FoundationPose results: ob_in_cam/ with a 4 x 4 matrix a frame, by a frames.yaml",
    read=read,
    takes_map=True,
)
