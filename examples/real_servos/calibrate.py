"""Write the effects that bring a scene nearest to recordings: the joint fit that a comparison with them begins with.

python examples/real_servos/calibrate.py --dataset out/half --scene SCENE --out out/calibration.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path

from candata.datasets import open_dataset
from candata.datasets.writing import write_text
from candata.gap.diagnosis import near_reference
from candata.gap.verdict.findings import simulator
from candata.scenes import load_scene


def main() -> None:
    """Fit, write the file and print what was fitted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    near = near_reference(open_dataset(asked.dataset), load_scene(asked.scene), seed=asked.seed)
    fitted = simulator(near, ())
    write_text(asked.out, fitted.model_dump_json(indent=1) + "\n", "calibration")
    for setting in fitted.effects:
        print(setting.name, setting.element or "", setting.parameters)


if __name__ == "__main__":
    main()
