"""Print a diagnosis of the cube tosses beside the published rows of Acosta, Yang, Posa 2022 (arXiv 2110.00541).

    python examples/cube_tosses/compare.py out/cube_report/report.json

The error is the study's: per toss the mean over frames of the position error in per cent of the cube's width and of
the rotation angle in degrees, then mean and standard deviation over tosses. Each rollout starts three frames before the
cube first comes within reach of the table. The study fitted its parameters on all 550 tosses; here the tosses that are
counted took no part in any fit.
"""

import json
import sys
from pathlib import Path

WIDTH_M = 0.1048
PUBLISHED = (
    ("Drake (published)", 13.5, 8.2, 16.5, 20.0),
    ("Bullet (published)", 14.9, 8.9, 16.5, 20.2),
    ("MuJoCo (published)", 25.1, 10.8, 21.7, 21.4),
)


def main(path: Path) -> None:
    """Print the table."""
    report = json.loads(path.read_text())
    position, rotation = (report["measures"][k] for k in ("object_position_m", "object_rotation_deg"))
    rows = [
        (
            f"MuJoCo, {name}",
            100 * position[label] / WIDTH_M,
            100 * position[f"{label}_sd"] / WIDTH_M,
            rotation[label],
            rotation[f"{label}_sd"],
        )
        for name, label in (("nominal", "before"), ("with the named effects", "after"))
    ]
    effects = ", ".join(f"{e['name']} {[p['value'] for p in e['parameters'].values()]}" for e in report["effects"])
    print(f"{report['verdict']}: {effects or 'nothing named'}")
    print(f"{report['data']['episodes']['held_out']} held-out tosses\n")
    print(f"{'':34}{'position, % of width':>22}{'rotation, deg':>18}")
    for name, p, p_sd, r, r_sd in (*rows, *PUBLISHED):
        print(f"{name:34}{p:>14.1f} +- {p_sd:4.1f}{r:>10.1f} +- {r_sd:4.1f}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/cube_report/report.json"))
