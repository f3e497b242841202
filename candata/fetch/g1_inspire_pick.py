"""20 teleoperated picks of a bottle by a Unitree G1 with Inspire hands: joints and commands, 30 Hz, MIT.

Repository YifanTian07/G1-policy-train; likely a copy of a release by the maker, whose own terms are not known. The
files are LeRobot 2.1: `observation.state` and `action`, 26 float32 each. Arms are in rad, hands in strokes of 0 to 1.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from candata.errors import DataError, Where
from candata.fetch import FetchedEpisodes, PublicDataset
from candata.fetch._files import download, require_sha256
from candata.schema.episode import Episode, EpisodeMeta

REVISION = "d1d3bb45f16a99eb3220c88b4f84f6c92d306f88"
RAW = f"https://raw.githubusercontent.com/YifanTian07/G1-policy-train/{REVISION}"
DATA = "data/chunk-000"
EPISODES = 20
#: sha256 of the licence, and over the sha256 of the episodes' files in their order, one hexadecimal line each.
LICENCE_SHA256 = "e0d6772c54c60a507f6aa5051bb45e1432aad5cc187d322859b5575f7a7bd2d0"
DATA_SHA256 = "d3f083690cbc3895b19d1b65b186a1df491308236b5a2ba50eb31267c4643d6c"
RATE_HZ = 30.0
#: Names in `meta/info.json` without their leading k: arms in rad, hands in strokes.
_ARM = ("ShoulderPitch", "ShoulderRoll", "ShoulderYaw", "Elbow", "WristRoll", "WristPitch", "WristYaw")
_HAND = ("HandPinky", "HandRing", "HandMiddle", "HandIndex", "HandThumbBend", "HandThumbRotation")
JOINTS = tuple(f"{side}{part}" for parts in (_ARM, _HAND) for side in ("Left", "Right") for part in parts)


def from_folder(folder: Path) -> FetchedEpisodes:
    """Return the episodes in a folder laid out as the repository: `data/chunk-000/` and the licence, hashes checked.

    Raises
    ------
    DataError
        When a file is missing or is not the published one.
    """
    folder = Path(folder)
    licence = next((p for p in (folder / "LICENSE.txt", folder / "LICENSE") if p.is_file()), folder / "LICENSE")
    require_sha256(licence, LICENCE_SHA256, f"put the LICENSE of {SOURCE.origin} beside the data")
    files = [folder / DATA / _file(index) for index in range(EPISODES)]
    _require_data(files)
    return FetchedEpisodes(_episodes(files), DATA_SHA256, licence.read_text(encoding="utf-8"))


def fetch(cache: Path, say: Callable[[str], None], raw: str = RAW) -> FetchedEpisodes:
    """Return the episodes from their public repository; files that are in the cache are not asked for again.

    Raises
    ------
    SetupError
        When the repository cannot be reached.
    DataError
        When what came is not the published data.
    """
    folder = Path(cache) / f"g1_inspire_pick-{REVISION[:12]}"
    for name in ("LICENSE", *(f"{DATA}/{_file(index)}" for index in range(EPISODES))):
        if not (folder / name).is_file():
            download(f"{raw}/{name}", folder / name, say)
    return from_folder(folder)


def _file(index: int) -> str:
    """Return the file name of an episode."""
    return f"episode_{index:06d}.parquet"


def _require_data(files: list[Path]) -> None:
    """Raise unless the files are the published ones."""
    lines = []
    for path in files:
        if not path.is_file():
            raise DataError(
                f"{path.name} is missing", where=Where(path=str(path)), fix=f"all {EPISODES} episodes are needed"
            )
        lines.append(f"{hashlib.sha256(path.read_bytes()).hexdigest()}\n")
    digest = hashlib.sha256("".join(lines).encode()).hexdigest()
    if digest != DATA_SHA256:
        raise DataError(
            "the episodes are not the published files",
            expected=f"sha256 {DATA_SHA256}",
            found=f"sha256 {digest}",
            where=Where(path=str(files[0].parent)),
            fix="delete the folder and fetch again",
        )


def _episodes(files: list[Path]) -> Iterator[Episode]:
    """Yield the episodes of checked files."""
    for index, path in enumerate(files):
        table = pq.read_table(path, columns=["observation.state", "action"])
        yield Episode(
            EpisodeMeta(
                id=f"pick-{index}",
                source="real",
                rate_hz=RATE_HZ,
                object="bottle",
                task="pick",
                joint_names=JOINTS,
                actuator_names=JOINTS,
            ),
            {
                # Stamps of the file are frame / 30 in float32.
                "time_ns": np.round(np.arange(table.num_rows) * 1e9 / RATE_HZ).astype(np.int64),
                "joint_position": _matrix(table, "observation.state"),
                "action": _matrix(table, "action"),
            },
        )


def _matrix(table: pa.Table, column: str) -> np.ndarray:
    """Return `(T, 26) float64` of a column of lists."""
    values = table.column(column).combine_chunks().flatten()
    return values.to_numpy(zero_copy_only=False).astype(float).reshape(table.num_rows, len(JOINTS))


SOURCE = PublicDataset(
    name="g1_inspire_pick",
    summary="20 real picks of a bottle by a Unitree G1 with Inspire hands, joints and commands, 30 Hz",
    origin=f"github.com/YifanTian07/G1-policy-train at {REVISION[:8]}",
    licence="MIT",
    from_folder=from_folder,
    download=fetch,
)
