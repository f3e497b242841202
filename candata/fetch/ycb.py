"""Objects of the YCB set: simplified closed meshes with convex pieces and published masses, CC BY 4.0.

Calli, Singh, Walsman, Srinivasa, Abbeel, Dollar, "The YCB object and model set", ICAR 2015. Google 16k scans, masses
and CoACD pieces come by way of github.com/elpis-lab/YCB_Dataset.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

from candata.errors import DataError, SetupError, Where
from candata.fetch import FetchedObject, FetchedObjects, PublicDataset
from candata.fetch._files import git_tree_hash, require_sha256
from candata.fetch._ycb_trees import TREES

ORIGIN = "ycbbenchmarks.com, by way of github.com/elpis-lab/YCB_Dataset at b7d8884a"
#: Table of masses, and its hash.
TABLE, TABLE_SHA256 = "objects.csv", "c854d5d52acc71948961893490afa8ee8090b81c94464d56bb13c2749875d1af"
#: Scans of several loose pieces with the mass of one: 5 to 46 kg/m^3. They are no rigid bodies.
LOOSE = frozenset({"a_colored_wood_blocks", "a_marbles", "b_marbles"})
NOTICE = """\
Objects of the YCB Object and Model Set: B. Calli, A. Singh, A. Walsman, S. Srinivasa, P. Abbeel, A. M. Dollar, "The YCB
object and model set: Towards common benchmarks for manipulation research", ICAR 2015; https://www.ycbbenchmarks.com

Licence: Creative Commons Attribution 4.0 International, https://creativecommons.org/licenses/by/4.0/

Changes: the meshes were reduced to about 4000 triangles, closed, and cut into convex pieces (CoACD); candata wrote the
poses in which they rest.
"""


def from_folder(folder: Path) -> FetchedObjects:
    """Return the objects that lie in a prepared folder, each checked against its hash when it is taken.

    Raises
    ------
    DataError
        When the table of masses is missing or another one, or none of the objects is there.
    """
    folder = Path(folder)
    table = folder / TABLE
    require_sha256(table, TABLE_SHA256, f"get the folder with {TABLE} again")
    with table.open(newline="", encoding="utf-8") as file:
        masses_kg = {row["object"]: float(row["mass_kg"]) for row in csv.DictReader(file)}
    names = tuple(name for name in sorted(TREES) if name not in LOOSE and (folder / name).is_dir())
    if not names:
        raise DataError("the folder holds no object", expected="mug, banana, ...", where=Where(path=str(folder)))
    checked_objects = _checked(folder, {name: masses_kg[name] for name in names})
    return FetchedObjects(checked_objects, len(names), NOTICE)


def _checked(folder: Path, masses_kg: dict[str, float]) -> Iterator[FetchedObject]:
    """Yield the objects, each once its files are those that were prepared."""
    for name, mass_kg in masses_kg.items():
        files = {path.name: path.read_bytes() for path in (folder / name).iterdir() if path.is_file()}
        if (tree := git_tree_hash(files)) != TREES[name]:
            raise DataError(
                f"{name} is not the prepared object",
                expected=f"git tree {TREES[name]}",
                found=f"git tree {tree}, {len(files)} files",
                where=Where(path=str(folder / name)),
                fix="get the folder again",
            )
        yield FetchedObject(name, folder / name, mass_kg)


def download(cache: Path, say: Callable[[str], None]) -> FetchedObjects:
    """Raise: the published meshes are not the simplified ones.

    Raises
    ------
    SetupError
        Always; says what is needed instead.
    """
    raise SetupError(
        "this set cannot be downloaded",
        expected=f"a prepared folder: {TABLE}, and visual.obj and convex_0.stl, ... for each object",
        found=f"{ORIGIN}, holds scans, which are neither light nor closed",
        fix="read a prepared folder: --from FOLDER",
    )


SOURCE = PublicDataset(
    name="ycb",
    summary="75 objects of the YCB set as closed meshes with convex pieces and masses",
    origin=ORIGIN,
    licence="CC-BY-4.0",
    from_folder=from_folder,
    download=download,
)
