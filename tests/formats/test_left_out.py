"""Arrays that no map and no name asks for: not opened, not checked, named as left out."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candata.errors import CandataError, DataError
from candata.formats import Reading
from candata.plugins import load
from tests.formats.made_sets import feature, write_buffer, write_demos, write_lerobot, write_map, zipped

h5py = pytest.importorskip("h5py")
PICTURES = (60, 400, 500, 5)  # 60 MB
MOST_BYTES = 20_000_000  # a third of that; the chosen columns take kilobytes


def read(name: str, source: Path, **told):
    return list(load("candata.formats", "FORMAT", name).read(source, Reading(**told)))


@pytest.fixture
def mapped(tmp_path):
    """A map of the state and the action of a buffer."""
    return write_map(tmp_path / "map.yaml", rate_hz=10, channels={"joint_position": "state", "action": "action"})


def spoil_chunks(path: Path) -> None:
    for file in (path / "data/img").rglob("*"):
        if file.name not in (".zarray", ".zattrs", "zarr.json") and file.is_file():
            file.write_bytes(b"no chunk")


def foreign_codec(path: Path, name: str = "img") -> None:
    meta = path / f"data/{name}/.zarray"
    if meta.is_file():
        meta.write_text(json.dumps(json.loads(meta.read_text()) | {"compressor": {"id": "imagecodecs_jpegxl"}}))
    else:
        meta = meta.with_name("zarr.json")
        meta.write_text(json.dumps(json.loads(meta.read_text()) | {"codecs": [{"name": "jpegxl"}]}))


def no_metadata(path: Path) -> None:
    for name in (".zarray", "zarr.json"):
        if (path / "data/img" / name).is_file():
            (path / "data/img" / name).write_text("{")


def shorter(path: Path) -> None:
    import zarr

    zarr.open_group(str(path), mode="a").create_array("data/src_inds", data=np.zeros(2))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("spoil", [spoil_chunks, foreign_codec, no_metadata, shorter])
def test_what_is_wrong_with_an_array_of_a_buffer_that_is_not_asked_for_does_not_matter(
    tmp_path, mapped, version, spoil
):
    path = write_buffer(tmp_path / "b.zarr", version)
    spoil(path)
    notes: list[str] = []
    first, second = read("diffusion_policy", path, mapping=mapped, note=notes.append)
    assert (len(first), len(second)) == (3, 2)
    assert second["joint_position"].tolist() == [[6, 7], [8, 9]]
    assert notes == ["left out: img, src_inds" if spoil is shorter else "left out: img"]


@pytest.mark.parametrize("version", [2, 3])
def test_a_codec_that_is_not_there_is_named_where_its_array_is_asked_for(tmp_path, mapped, version):
    path = write_buffer(tmp_path / "b.zarr", version)
    foreign_codec(path, "state")
    with pytest.raises(DataError, match="data/state of the buffer cannot be read") as caught:
        read("diffusion_policy", path, mapping=mapped)
    assert "jpegxl" in caught.value.found
    assert caught.value.fix == "leave the array out of the map, or write it again with a codec that zarr brings"


def pack_by(key: str):
    """Make a dataset that was packed by a filter which nobody has."""

    def edit(file):
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_chunk((5, 7))
        plan.set_filter(32015, h5py.h5z.FLAG_OPTIONAL)
        for name in ("demo_0", "demo_1"):
            group = file[f"data/{name}"]
            if key in group:
                del group[key]
            space = h5py.h5s.create_simple((5, 7))
            made = h5py.h5d.create(group.id, key.encode(), h5py.h5t.NATIVE_DOUBLE, space, plan)
            made.write_direct_chunk((0, 0), b"packed")

    return edit


def odd_datasets(file):
    for name in ("demo_0", "demo_1"):
        demo = file[f"data/{name}"]
        demo["src_demo_inds"] = np.zeros(2, int)
        demo["words"] = np.array([b"a", b"b"])
        demo["one"] = 3.0
        demo["nothing"] = h5py.Empty("f8")
        demo["elsewhere"] = h5py.ExternalLink("other.h5", "/x")
        demo["nowhere"] = h5py.SoftLink("/none")
        demo["obs/deep/x"] = np.zeros(3)


@pytest.mark.parametrize(
    ("edit", "names"),
    [
        (odd_datasets, "elsewhere, nothing, nowhere, obs/deep, one, src_demo_inds, words"),
        (pack_by("pictures"), "pictures"),
    ],
)
def test_datasets_of_a_demonstration_that_are_not_asked_for_may_be_anything(tmp_path, edit, names):
    notes: list[str] = []
    first, second = read("robomimic", write_demos(tmp_path / "d.hdf5", edit), note=notes.append)
    assert (len(first), second["joint_position"][0, 0]) == (5, 1)
    assert notes[0] == f"left out: {names}"


def test_a_filter_that_is_not_there_is_named_where_its_dataset_is_asked_for(tmp_path):
    with pytest.raises(DataError, match="/data/demo_0/actions is packed by a filter that is not installed") as caught:
        read("robomimic", write_demos(tmp_path / "d.hdf5", pack_by("actions")))
    assert "32015" in caught.value.found


def test_a_dataset_without_numbers_that_is_asked_for_is_refused(tmp_path):
    path = write_map(tmp_path / "map.yaml", channels={"joint_position": "obs/robot0_joint_pos", "action": "words"})
    with pytest.raises(DataError, match="words does not hold rows of numbers"):
        read("robomimic", write_demos(tmp_path / "d.hdf5", odd_datasets), mapping=path)


def test_what_leads_nowhere_is_refused_where_it_is_asked_for(tmp_path):
    path = write_map(tmp_path / "map.yaml", channels={"joint_position": "obs/robot0_joint_pos", "action": "nowhere"})
    with pytest.raises(CandataError, match="nowhere"):
        read("robomimic", write_demos(tmp_path / "d.hdf5", odd_datasets), mapping=path)


def pictures() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, PICTURES, np.uint8)


def big_buffer(tmp_path: Path) -> tuple[str, Path]:
    values = pictures()
    arrays = {"img": values, "state": np.ones((60, 2)), "action": np.ones((60, 2))}
    path = write_buffer(tmp_path / "b.zarr", ends=(40, 60), **arrays)
    return "diffusion_policy", path


def big_demos(tmp_path: Path) -> tuple[str, Path]:
    def edit(file):
        file["data/demo_0/obs/camera"] = pictures()

    return "robomimic", write_demos(tmp_path / "d.hdf5", edit, rows=60)


def big_lerobot(tmp_path: Path) -> tuple[str, Path]:
    root = write_lerobot(tmp_path / "set", {"observation.image": feature("image", 3)}, rows=(60,))
    path = root / "data/chunk-000/file-000.parquet"
    column = pa.array([one.tobytes() for one in pictures()])
    pq.write_table(pq.read_table(path).append_column("observation.image", column), path)
    return "lerobot", root


@pytest.mark.parametrize("make", [big_buffer, big_demos, big_lerobot])
def test_pictures_that_are_not_asked_for_take_no_memory(tmp_path, mapped, make):
    name, source = make(tmp_path)
    assert sum(p.stat().st_size for p in [source, *source.rglob("*")] if p.is_file()) > 55_000_000
    pool = pa.default_memory_pool()
    tracemalloc.start()
    before = pool.bytes_allocated()
    episodes = read(name, source, mapping=mapped if name == "diffusion_policy" else None)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sum(map(len, episodes)) >= 60
    assert peak < MOST_BYTES
    assert pool.bytes_allocated() - before < MOST_BYTES


def test_pictures_of_a_zip_file_that_are_not_asked_for_are_not_read(tmp_path, mapped):
    path = zipped(write_buffer(tmp_path / "b.zarr"))
    data = bytearray(path.read_bytes())
    start = data.index(b"data/img/0.0.0.0") + len("data/img/0.0.0.0")
    data[start : start + 4] = b"\xff" * 4
    path.write_bytes(data)
    assert len(read("diffusion_policy", path, mapping=mapped)) == 2


def test_a_dataset_of_10_tb_that_is_not_asked_for_does_not_matter(tmp_path):
    def edit(file):
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        space = h5py.h5s.create_simple((10**13,))
        h5py.h5d.create(file["data/demo_0"].id, b"pictures", h5py.h5t.NATIVE_UINT8, space, plan)

    assert len(read("robomimic", write_demos(tmp_path / "d.hdf5", edit))) == 2


def test_pictures_of_a_lerobot_set_that_are_damaged_and_not_asked_for_do_not_matter(tmp_path):
    root = write_lerobot(tmp_path / "set", {"observation.image": feature("image", 3)})
    path = root / "data/chunk-000/file-000.parquet"
    column = pa.array([b"a picture" * 100] * 7)
    pq.write_table(pq.read_table(path).append_column("observation.image", column), path, write_page_checksum=True)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"a picturea", b"no pictur!"))
    assert path.read_bytes() != data
    notes: list[str] = []
    assert len(read("lerobot", root, note=notes.append)) == 2
    assert notes[0] == "left out, videos and images: observation.image"
