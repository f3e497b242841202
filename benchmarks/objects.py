"""Objects of the YCB set made from their meshes: time, mass centre and inertia beside the published table.

    python benchmarks/objects.py --from FOLDER

Each object of the prepared folder becomes an object of candata, as `candata fetch ycb` makes it. Printed are its CPU
time, and the largest differences from `objects.csv` (which was computed from the meshes by another program): mass
centre [mm], principal moments of inertia [%]. Without a folder nothing is measured.
"""

from __future__ import annotations

import argparse
import csv
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from candata.fetch import ycb
from candata.scenes.model_file import compile_model
from candata.scenes.object_body import plane_scene
from candata.scenes.object_making import ObjectSource, make_object

#: Targets: CPU time of an object [s], difference of the mass centre [mm] and of the moments from the table.
MOST_CPU_S, MOST_MM, MOST_SHARE = 5.0, 0.02, 1e-3
SHARED = Path(os.environ.get("CANDATA_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def differences(row: dict[str, str], folder: Path, out: Path) -> tuple[float, float, float]:
    """Return the CPU time of an object [s], and how far its mass centre [mm] and its moments are from a row."""
    begin_s = time.process_time()
    made = make_object(ObjectSource(folder, row["object"], float(row["mass_kg"])), out)
    cpu_s = time.process_time() - begin_s
    model = compile_model(plane_scene(made.scene_object), row["object"])
    centre = np.array([float(row[f"com_{axis}_m"]) for axis in "xyz"])
    xx, yy, zz, xy, xz, yz = (float(row[f"i{axes}"]) for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    off_mm = 1e3 * float(np.abs(model.body_ipos[1] - centre).max())
    return cpu_s, off_mm, float(np.abs(np.sort(model.body_inertia[1]) / moments - 1).max())


def main() -> int:
    """Run, and return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="folder", type=Path, default=SHARED / "ycb")
    folder = parser.parse_args().folder
    if not (folder / ycb.TABLE).is_file():
        print(f"no objects in {folder}: nothing measured")
        return 0
    with (folder / ycb.TABLE).open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["object"] not in ycb.LOOSE]
    with tempfile.TemporaryDirectory() as made:
        found = [differences(row, folder / row["object"], Path(made) / row["object"]) for row in rows]
    cpu_s, off_mm, off_share = (list(column) for column in zip(*found, strict=True))
    print(f"{len(found)} objects, CPU time {statistics.median(cpu_s):.2f} s each, slowest {max(cpu_s):.2f} s")
    print(f"mass centre off by at most {max(off_mm):.3f} mm, moments by at most {max(off_share):.2%}")
    return int(max(cpu_s) > MOST_CPU_S or max(off_mm) > MOST_MM or max(off_share) > MOST_SHARE)


if __name__ == "__main__":
    sys.exit(main())
