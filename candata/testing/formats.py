"""What every format keeps: it reads what it writes, repeats, leaves its source alone, and refuses damage in words."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from candata.datasets.encode import content_hash
from candata.errors import CandataError
from candata.formats import FORMATS, Format, Reading, Writing
from candata.schema.episode import Episode, EpisodeMeta
from candata.testing._claims import refusal_of, registered_name, require, require_words

#: Files of a source that are damaged, at most, and how often a bit of each is flipped.
MOST_DAMAGED, FLIPS = 12, 2


class FormatConformance:
    """Conformance of one format.

    Attributes
    ----------
    format : Format
        The constant of the plug-in.
    exact : bool
        Whether what it wrote comes back bit for bit, record and all; else the channels that come back are close.
    tolerance : float
        Relative error of a number that is close.
    """

    format: ClassVar[Format]
    exact: ClassVar[bool] = True
    tolerance: ClassVar[float] = 1e-6

    def source(self, folder: Path) -> tuple[Path, Path | None]:
        """Return a source in `folder`, and its map where one is needed; to be replaced for what is only read."""
        if self.format.write is None:
            _skip("the format writes nothing: give the suite a `source` to read")
        self._write(made_up_episodes(), folder)
        return folder, None

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is."""
        require_words(FORMATS, self.format)
        name = registered_name(FORMATS, self.format)
        require(self.format.name == name, f"`name` is {self.format.name!r}, and it is registered as {name!r}")
        require(self.format.read or self.format.write, "it neither reads nor writes")

    def test_what_it_writes_it_reads(self, tmp_path: Path) -> None:
        """In every variant: ids, channels and numbers come back."""
        if self.format.write is None or self.format.read is None:
            _skip("the format does not both read and write")
        episodes = made_up_episodes()
        for variant in (None, *self.format.variants):
            folder = self._write(episodes, tmp_path / (variant or "usual"), variant)
            read_back = self._read(folder, None)
            ids = [episode.meta.id for episode in read_back]
            require(
                len(read_back) == len(episodes), f"{len(episodes)} episodes were written, {len(read_back)} come back"
            )
            if self.exact:
                require(ids == [episode.meta.id for episode in episodes], f"other ids come back: {ids}")
            for written, read_episode in zip(episodes, read_back, strict=True):
                self._require_same(written, read_episode)

    def test_it_reads_the_same_twice_and_leaves_the_source_alone(self, tmp_path: Path) -> None:
        """An import may be repeated."""
        source, mapping = self._source(tmp_path)
        bytes_before = _bytes_of(source)
        first_reading, second_reading = (self._read(source, mapping) for _ in range(2))
        require(first_reading, "the source holds no episodes")
        require(
            [content_hash(e) for e in first_reading] == [content_hash(e) for e in second_reading],
            "a second reading differs",
        )
        require(_bytes_of(source) == bytes_before, "reading changes the source")

    def test_what_is_no_source_is_refused(self, tmp_path: Path) -> None:
        """Nothing there, an empty folder, a file of other text."""
        if self.format.read is None:
            _skip("the format reads nothing")
        mapping = self._source(tmp_path / "sound")[1] if self.format.takes_map else None
        (tmp_path / "empty").mkdir()
        (tmp_path / "other.txt").write_text("this is not a recording\n")
        for source in (tmp_path / "nothing", tmp_path / "empty", tmp_path / "other.txt"):
            refusal_of(partial(self._read, source, mapping), source.name)

    def test_damage_is_refused_or_harmless(self, tmp_path: Path) -> None:
        """Each file cut, emptied, removed or with bits changed: candata's error, or whole episodes."""
        source, mapping = self._source(tmp_path / "sound")
        intact = {e.meta.id: content_hash(e) for e in self._read(source, mapping)}
        for damage, damaged_source in _damages(source, tmp_path / "damaged"):
            try:
                episodes = self._read(damaged_source, mapping)
            except CandataError:
                continue
            except Exception as error:
                raise AssertionError(f"{damage}: {type(error).__name__}, not an error of candata: {error}") from error
            changed_ids = [e.meta.id for e in episodes if content_hash(e) != intact.get(e.meta.id, content_hash(e))]
            require(not (self.exact and changed_ids), f"{damage}: {changed_ids} come back with other content")

    def _source(self, folder: Path) -> tuple[Path, Path | None]:
        """Return a source and its map, in a folder that stands."""
        if self.format.read is None:
            _skip("the format reads nothing")
        folder.mkdir(exist_ok=True, parents=True)
        return self.source(folder / "source")

    def _write(self, episodes: Sequence[Episode], folder: Path, variant: str | None = None) -> Path:
        """Return the folder, with the episodes written into it."""
        if self.format.write is None:
            _skip("the format writes nothing")
        folder.mkdir(parents=True)
        self.format.write(episodes, folder, Writing("made_up", "0" * 64, variant=variant))  # type: ignore[misc]
        return folder

    def _read(self, source: Path, mapping: Path | None) -> list[Episode]:
        """Return the episodes of a source."""
        return list(self.format.read(source, Reading(mapping=mapping)))  # type: ignore[misc]

    def _require_same(self, written: Episode, read_back: Episode) -> None:
        """Claim that an episode came back."""
        if self.exact:
            require(read_back.meta == written.meta, f"{written.meta.id}: another record comes back: {read_back.meta}")
            require(content_hash(read_back) == content_hash(written), f"{written.meta.id}: other numbers come back")
            return
        require(len(set(read_back.arrays) - {"time_ns"}) > 0, f"{written.meta.id}: no channel comes back")
        for channel in set(read_back.arrays) & set(written.arrays):
            written_values, read_values = np.asarray(written[channel], float), np.asarray(read_back[channel], float)
            is_near = written_values.shape == read_values.shape and np.allclose(
                written_values, read_values, rtol=self.tolerance, atol=self.tolerance
            )
            require(is_near, f"{written.meta.id}: {channel} comes back as something else")


def made_up_episodes(count: int = 3, rows: int = 40) -> list[Episode]:
    """Return small episodes of two joints, two fingertips and an object, with random numbers."""
    return [_episode(f"episode_{k}", np.random.default_rng(k), rows) for k in range(count)]


def _episode(name: str, rng: np.random.Generator, rows: int) -> Episode:
    """Return one episode."""
    turn = rng.normal(size=(rows, 4))
    arrays: dict[str, NDArray] = {
        "time_ns": np.arange(rows) * 12_500_000,
        "object_pose": np.c_[rng.normal(size=(rows, 3)), turn / np.linalg.norm(turn, axis=1, keepdims=True)],
        "joint_position": rng.normal(size=(rows, 2)),
        "action": rng.normal(size=(rows, 2)),
        "fingertip_force": rng.normal(size=(rows, 2, 3)),
        "contact": np.arange(rows) >= rows // 2,
    }
    meta = EpisodeMeta(
        id=name,
        source="sim",
        rate_hz=80.0,
        scene="made_up",
        object="box",
        task="push",
        joint_names=("left", "right"),
        actuator_names=("left", "right"),
        fingertip_names=("left_tip", "right_tip"),
    )
    return Episode(meta, arrays)


def _damages(source: Path, target: Path) -> Iterator[tuple[str, Path]]:
    """Yield damaged copies of a source and what lies beside it, one after the other, with what was done."""
    root = source if source.is_dir() else source.parent
    files = sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file())
    rng = np.random.default_rng(0)
    for file in files[:: -(-len(files) // MOST_DAMAGED)]:
        data = (root / file).read_bytes()
        changes: dict[str, bytes | None] = {"cut": data[: len(data) // 2], "emptied": b"", "removed": None}
        for number in range(FLIPS if data else 0):
            data_flipped = bytearray(data)
            data_flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            changes[f"with bit flip {number}"] = bytes(data_flipped)
        for damage, data_changed in changes.items():
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(root, target)
            (target / file).unlink()
            if data_changed is not None:
                (target / file).write_bytes(data_changed)
            yield f"{file} {damage}", target / source.relative_to(root)


def _bytes_of(source: Path) -> str:
    """Return sha256 over a file, or all files of a folder."""
    files = sorted(p for p in source.rglob("*") if p.is_file()) if source.is_dir() else [source]
    return hashlib.sha256(b"".join(str(p).encode() + p.read_bytes() for p in files)).hexdigest()


def _skip(reason: str) -> None:
    """Skip the test that is running."""
    import pytest

    pytest.skip(reason)
